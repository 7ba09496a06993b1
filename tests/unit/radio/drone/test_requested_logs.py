"""Log variables that users ask for, over each connection."""

import pytest
from radio_drones import Kept, made
from virtual_time import virtual

from crazychoir.bus.port import PORT_ADDRESSES
from crazychoir.bus.topics import DRONE_TOPICS
from crazychoir.errors import ConfigError, LinkFailed
from crazychoir.runtime.mailbox import Call


class Logs(Kept):
    """A connection that starts each log and sends one set of values, or knows no variable."""

    def __init__(self, knows: bool = True) -> None:
        super().__init__()
        self.knows = knows
        self.begun: list[tuple[tuple[str, ...], float]] = []

    async def log(self, name, variables, period, data, seconds) -> None:
        if not self.knows:
            raise LinkFailed("udp", "unknown variable")
        self.begun.append((tuple(variables), period))
        data(dict.fromkeys(variables, 3.5), 1000)


@virtual
async def test_variables_are_logged_at_once_and_over_the_next_connection(clock) -> None:
    drone, _ = made(clock)
    first, second = Logs(), Logs()
    drone.link.connection = first
    told = []
    reader = drone.setup.bus.port(5).address
    drone.setup.bus.subscribe(
        DRONE_TOPICS.telemetry,
        PORT_ADDRESSES.body_offset,
        reader,
        Call(clock, lambda values, age: told.append(values)),
    )
    drone.requested_logs.ask(["pm.vbat"], 0.1)
    await clock.sleep(0.1)
    assert first.begun == [(("pm.vbat",), 0.1)]
    assert told == [{"pm.vbat": [3.5, 0.0]}]
    await drone.requested_logs.begin_all(second)
    assert second.begun == first.begun


@virtual
async def test_without_a_connection_the_variables_wait_for_one(clock) -> None:
    drone, _ = made(clock)
    drone.link.connection, later = None, Logs()
    drone.requested_logs.ask(["pm.vbat"], 0.1)
    await clock.sleep(0.1)
    await drone.requested_logs.begin_all(later)
    assert later.begun == [(("pm.vbat",), 0.1)]


@virtual
async def test_an_unknown_variable_is_reported_and_stops_nothing(clock) -> None:
    drone, _ = made(clock)
    said = []
    drone.setup.warn = lambda topic, text: said.append((topic, text))
    drone.requested_logs.ask(["no.such"], 0.1)
    said.clear()
    await drone.requested_logs.begin_all(Logs(knows=False))
    ((topic, text),) = said
    assert topic == "log"
    assert "unknown variable" in text


@virtual
async def test_a_period_that_the_firmware_does_not_know_is_refused(clock) -> None:
    drone, _ = made(clock)
    with pytest.raises(ConfigError, match="drone 0: log"):
        drone.requested_logs.ask(["pm.vbat"], 0.0)
