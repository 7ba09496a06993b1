"""Warnings about a drone are throttled by topic."""

import logging

from radio_drones import made
from virtual_time import virtual


def test_a_warning_of_one_topic_is_not_repeated_at_once(caplog) -> None:
    @virtual
    async def check(clock) -> None:
        setup = made(clock)[0].setup
        with caplog.at_level(logging.WARNING):
            for topic in ("log", "log", "arm"):
                setup.warn(topic, f"about {topic}")
        texts = [record.getMessage() for record in caplog.records]
        assert texts == ["drone 0: about log", "drone 0: about arm"]
        await clock.sleep(60.0)
        assert setup.may_log("log")

    check()
