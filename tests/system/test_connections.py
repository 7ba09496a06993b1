"""Eight virtual drones, connected at once through cflib: cold, warm, some of them not there; and closed again."""

import asyncio
import threading

import pytest
from system.hall import Hall, reached

from crazychoir.config.swarm_config import default_swarm
from crazychoir.errors import LinkFailed
from crazychoir.radio.link.connection import Connection
from crazychoir.radio.link.toc_cache import TableOfContents
from crazychoir.runtime.clock import WallClock

pytestmark = [pytest.mark.system, pytest.mark.real_time]
EIGHT = range(8)


async def opened(
    clock: WallClock, config, folder, seconds: float
) -> tuple[list[Connection], dict[int, str], float]:
    """Connections to all, what those say that fail, and the s that all took together."""
    contents, began = TableOfContents(folder), clock.now()
    links = [Connection(clock, config.drone(i).uri, contents) for i in EIGHT]
    answers = await asyncio.gather(
        *(link.open(seconds) for link in links), return_exceptions=True
    )
    failed = {
        i: str(said) for i, said in enumerate(answers) if isinstance(said, LinkFailed)
    }
    assert all(said is None or isinstance(said, LinkFailed) for said in answers), (
        answers
    )
    return links, failed, clock.now() - began


async def test_eight_connect_within_their_deadlines_and_leave_no_thread(
    tmp_path,
) -> None:
    """The deadlines are those of the users of radios: 2 s with nothing known, 1 s with tables of contents."""
    clock = WallClock(asyncio.get_running_loop())
    config = reached(default_swarm(8).replace(control={"sender": "xyz"}), per_dongle=8)
    async with Hall(config, tmp_path, "--capacity", "100000") as hall:
        before = threading.active_count()
        for deadline in (2.0, 1.0):
            links, failed, _ = await opened(
                clock, config, tmp_path / "contents", deadline
            )
            assert failed == {}
            async with asyncio.timeout(1.5):
                await asyncio.gather(*(link.close() for link in links))
        hall.fault(3, off=1)
        hall.fault(5, silent=1)
        links, failed, took = await opened(clock, config, tmp_path / "contents", 1.0)
        assert sorted(failed) == [3, 5]
        assert "no virtual drone is there" in failed[3]
        assert "no answer within 1 s" in failed[5]
        assert took < 2.0, "an absent drone delays no connection beyond the deadline"
        await asyncio.gather(*(link.close() for link in links))
        for _ in range(30):
            if threading.active_count() <= before:
                break
            await asyncio.sleep(0.1)
        assert threading.active_count() <= before, threading.enumerate()
        assert all(said["zeros"] == 0 for said in hall.state().values())
    clock.close()
