"""A connection that has no drone: what it makes of what cflib says."""

import asyncio
from pathlib import Path

import pytest

from crazychoir.errors import LinkFailed
from crazychoir.radio.link.connection import Connection
from crazychoir.radio.link.loop_caller import resolve_waiting
from crazychoir.radio.link.toc_cache import TableOfContents
from crazychoir.runtime.clock import WallClock


async def test_what_is_missing_is_said_before_logs_were_reset() -> None:
    clock = WallClock(asyncio.get_running_loop())
    connection = Connection(
        clock, "udp://127.0.0.1:9", TableOfContents(Path("nowhere"))
    )
    connection._heard_ns, connection.cf.platform._protocolVersion = 1, 12
    assert connection.cf.log.toc is None, "as cflib has it at first"
    assert connection.stage == "its table of log variables is not complete"
    resolve_waiting(connection._opened)
    assert connection.stage == "no word of itself"
    await connection.close()
    clock.close()


async def test_a_refused_connection_names_the_command_that_serves_virtual_drones() -> (
    None
):
    clock = WallClock(asyncio.get_running_loop())
    connection = Connection(
        clock, "udp://127.0.0.1:9", TableOfContents(Path("nowhere"))
    )
    connection._failed(
        "Traceback\nConnectionRefusedError: [Errno 111] Connection refused"
    )
    with pytest.raises(
        LinkFailed, match="no virtual drone is there: start `crazychoir virtual`"
    ):
        await connection._opened
    await connection.close()
    clock.close()


async def test_a_connection_that_is_not_open_begins_no_log() -> None:
    clock = WallClock(asyncio.get_running_loop())
    connection = Connection(
        clock, "udp://127.0.0.1:9", TableOfContents(Path("nowhere"))
    )
    with pytest.raises(LinkFailed, match="log own: its link is not open"):
        await connection.log("own", ["pm.vbat"], 0.1, lambda values, at: None, 1.0)
    await connection.close()
    clock.close()
