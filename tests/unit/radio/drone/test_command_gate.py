"""Which commands leave, and when; the connection keeps what it is given."""

import numpy as np
import pytest
from radio_drones import LINE, READY, STOP, head, made, tell
from virtual_time import virtual

from crazychoir.firmware.supervision import SUPERVISOR_BITS
from crazychoir.radio.drone.timing import REPEAT_RULES
from crazychoir.types import FPQR, XYZ


@virtual
async def test_set_points_leave_at_their_rate_and_the_newest_counts(clock) -> None:
    drone, kept = made(clock, "fpqr", 50.0)
    for _ in range(100):
        drone.commands.send(FPQR(np.array([0.3, 0.0, 0.0, 0.0])))
        await clock.sleep(0.01)
    assert 49 <= len(kept.sent) <= 52


@virtual
async def test_a_standing_drone_is_sent_a_stop_now_and_then(clock) -> None:
    drone, kept = made(clock)
    for _ in range(100):
        drone.commands.send(STOP)
        await clock.sleep(0.01)
    said = [head("stop"), head("planner_stop"), head("notify_setpoint_stop")]
    assert kept.sent == said * round(1.0 / REPEAT_RULES.stop_period), (
        "an earlier program may have sent set-points"
    )


@virtual
async def test_an_agent_that_has_not_flown_the_drone_does_not_stop_its_motors(
    clock,
) -> None:
    drone, kept = made(clock)
    tell(drone, READY | SUPERVISOR_BITS.flying)
    drone.commands.send(STOP)
    assert kept.sent == []
    drone.commands.send(LINE)
    drone.commands.send(STOP)
    assert kept.sent == [
        head("go_to"),
        head("notify_setpoint_stop"),
        head("planner_stop"),
    ]


@virtual
async def test_a_line_that_begins_far_away_gets_the_time_for_it(clock) -> None:
    drone, _ = made(clock, "xyz")
    tell(drone, READY)
    durations, planned = [], drone.handler.planned
    drone.handler.planned = lambda command: (
        durations.append(float(command.flat[4])) or planned(command)
    )
    for x in (0.3, 3.0):
        drone.commands.send(XYZ("line", np.array([x, 0.0, 0.0, 0.0, 0.2])))
    assert durations[0] == 0.2, "it follows late"
    assert durations[1] == pytest.approx(
        3.0 / (1.8 * drone.setup.config.flight.speed_limit)
    )
