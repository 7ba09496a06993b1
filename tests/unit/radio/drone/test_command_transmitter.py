"""Commands that become packets."""

import math

import numpy as np
from radio_drones import LAND, LINE, READY, STOP, made, tell
from virtual_time import virtual

from crazychoir.types import FPQR


@virtual
async def test_only_the_newest_line_waits(clock) -> None:
    drone, kept = made(clock, "xyz")
    tell(drone, READY)
    waits = []
    kept.newest = lambda kind, packet: waits.append(kind)
    drone.commands.send(LINE)
    assert waits == [], "that set-points have ended goes with it"
    drone.commands.send(LINE)
    drone.commands.send(LAND)
    drone.commands.send(STOP)
    assert waits == ["command"]


@virtual
async def test_a_command_that_does_not_fit_into_a_packet_is_counted_and_not_sent(
    clock,
) -> None:
    drone, kept = made(clock, "fpqr")
    drone.commands.send(FPQR(np.array([math.nan, 0.0, 0.0, 0.0])))
    assert kept.sent == []
    assert drone.malformed == 1
