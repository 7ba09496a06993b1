"""What is made of the logs of a drone."""

import math

import numpy as np
import pytest
from radio_drones import READY, Kept, made, tell
from virtual_time import virtual

from crazychoir.errors import LinkFailed
from crazychoir.firmware.supervision import SUPERVISOR_BITS
from crazychoir.numerics.math3d import yaw_of
from crazychoir.radio.drone.own_estimate import LOG_NAMES
from crazychoir.radio.drone.timing import CONNECT_ATTEMPTS, SILENCE_LIMITS


@virtual
async def test_its_time_may_wrap(clock) -> None:
    drone, _ = made(clock)
    tell(drone, READY, (1 << 24) - 10)
    tell(drone, READY, 90)
    assert drone.link.why == ""


@virtual
async def test_what_was_overtaken_changes_nothing(clock) -> None:
    drone, _ = made(clock)
    tell(drone, READY, 5000)
    await clock.sleep(0.9)
    tell(drone, READY | SUPERVISOR_BITS.flying, 5900)
    tell(drone, READY, 5020)
    assert (drone.estimate.is_flying, drone.link.why) == (True, "")


class Starts(Kept):
    """A connection that starts the logs and sends no values."""

    uri = "udp://127.0.0.1:19850"

    def __init__(self) -> None:
        super().__init__()
        self.begun: list[tuple[str, float]] = []

    async def log(self, name, variables, period, data, seconds) -> None:
        self.begun.append((name, period))


@virtual
async def test_only_a_drone_without_cameras_logs_the_variance_of_its_position(
    clock,
) -> None:
    for pose, names in (("mocap", ["own"]), ("onboard", ["own", "spread"])):
        drone, _ = made(clock, pose=pose)
        starts = Starts()
        await drone.estimate.begin_logs(starts)
        assert [name for name, _ in starts.begun] == names
        assert starts.begun[0][1] == pytest.approx(1.0 / 50.0)


@virtual
async def test_a_drone_that_sends_no_log_in_time_fails_its_link(clock) -> None:
    drone, _ = made(clock)
    starts = Starts()
    await drone.estimate.begin_logs(starts)
    with pytest.raises(LinkFailed, match=r"sends no status within 1\.5 s"):
        await drone.estimate.wait_for_log(starts)
    assert clock.now() == pytest.approx(CONNECT_ATTEMPTS.reopen_deadline)
    tell(drone, READY)
    await drone.estimate.wait_for_log(starts)


@virtual
async def test_logs_that_stay_away_are_overdue(clock) -> None:
    drone, _ = made(clock)
    tell(drone, READY)
    await clock.sleep(SILENCE_LIMITS.logs_dropped - 0.1)
    assert not drone.estimate.is_overdue
    await clock.sleep(0.2)
    assert drone.estimate.is_overdue


@virtual
async def test_an_estimate_without_cameras_is_turned_and_moved_into_the_world(
    clock,
) -> None:
    drone, _ = made(
        clock, pose="onboard", origin=[1.0, 2.0, 0.5], origin_yaw=math.pi / 2.0
    )
    values = dict.fromkeys(LOG_NAMES.estimate, 0.0) | {
        "stateEstimateZ.x": 1000.0,
        "stateEstimateZ.vx": 500.0,
        "stateEstimateZ.quat": 3 << 30,
        "pm.vbat": 4.0,
        "supervisor.info": float(READY),
    }
    drone.estimate.take_log(values, 1000)
    state = drone.estimate.state
    assert np.allclose(state.p, [1.0, 3.0, 0.5])
    assert np.allclose(state.flat[3:6], [0.0, 0.5, 0.0])
    assert yaw_of(state.flat[6:10]) == pytest.approx(math.pi / 2.0, abs=0.01)
    assert (drone.estimate.battery, drone.estimate.supervisor) == (4.0, READY)
