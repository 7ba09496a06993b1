"""Which poses a drone in flight believes."""

import math

import numpy as np
import pytest

from crazychoir.safety.identity.pose_gate import PoseGate
from crazychoir.types import Pose


def pose(x: float, y: float = 0.0, yaw: float = 0.0) -> Pose:
    return Pose(np.array([x, y, 1.0, 0.0, 0.0, math.sin(yaw / 2), math.cos(yaw / 2)]))


@pytest.mark.parametrize("hertz", [10.0, 25.0, 100.0])
@pytest.mark.parametrize("speed", [0.0, 1.0, 3.0])
def test_a_flying_drone_is_believed_at_any_rate(hertz, speed) -> None:
    gate, rng = PoseGate(), np.random.default_rng(1)
    for k in range(200):
        t = k / hertz
        x = speed / 0.8 * (1.0 - math.cos(0.8 * t)) + 0.0005 * rng.standard_normal()
        assert gate.believes(pose(x), t, flying=True), (hertz, speed, t)


@pytest.mark.parametrize("hertz", [10.0, 100.0])
def test_a_drone_first_seen_in_full_flight_is_believed(hertz) -> None:
    gate = PoseGate()
    assert all(gate.believes(pose(2.5 * k / hertz), k / hertz, True) for k in range(30))


@pytest.mark.parametrize("hertz", [10.0, 100.0])
def test_a_jump_is_not_believed_for_as_long_as_it_lasts_and_its_end_is(hertz) -> None:
    gate = PoseGate()
    believed = [
        gate.believes(pose(0.3 if 2.0 <= k / hertz < 2.2 else 0.0), k / hertz, True)
        for k in range(40)
    ]
    jumps = [2.0 <= k / hertz < 2.2 for k in range(40)]
    assert believed == [not jump for jump in jumps]


def test_a_body_that_turns_round_is_another_one() -> None:
    gate = PoseGate()
    for k in range(20):
        assert gate.believes(pose(0.0, yaw=0.05 * k), 0.01 * k, True)
    assert not gate.believes(pose(0.0, yaw=0.95 + math.pi), 0.2, True)


def test_on_the_ground_it_may_be_carried_about() -> None:
    gate = PoseGate()
    assert all(gate.believes(pose(float(k)), 0.01 * k, False) for k in range(10))
    assert gate.believes(pose(9.0), 0.1, True)


def test_no_gap_excuses_half_a_metre() -> None:
    gate = PoseGate()
    gate.believes(pose(0.0), 0.0, True)
    assert gate.believes(pose(0.4), 1.0, True)
    assert not gate.believes(pose(1.0), 3.0, True)


@pytest.mark.parametrize("hertz", [50.0, 100.0])
def test_late_poses_that_come_together_do_not_leave_the_drone_unseen(hertz) -> None:
    """For 0.25 s nothing is read; then all poses at once, as if they were born then."""
    for speed in (0.0, 1.0, 2.0):
        gate, believed = PoseGate(), []
        for k in range(round(3.0 * hertz)):
            t = k / hertz
            born = 1.25 if 1.0 < t <= 1.25 else t
            believed.append(
                gate.believes(pose(speed * t), born + 0.001 * (t - born), True)
            )
        assert all(believed[round(1.4 * hertz) :]), speed


@pytest.mark.parametrize("hertz", [10.0, 50.0, 100.0])
@pytest.mark.parametrize("jump", [0.3, 0.6, 2.0])
def test_another_body_is_never_believed_however_long_it_is_seen(hertz, jump) -> None:
    gate = PoseGate()
    for k in range(round(8.0 * hertz)):
        t = k / hertz
        assert gate.believes(pose(0.2 * math.sin(t) + jump * (t > 2.0)), t, True) is (
            t <= 2.0
        )
