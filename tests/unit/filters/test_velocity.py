import math

import numpy as np
import pytest

from crazychoir.filters.motion import CommandedMotion
from crazychoir.filters.velocity import VelocityFilter
from crazychoir.platforms import PAPER_PLATFORM
from crazychoir.types import Pose


def pose(x, age=0.0):
    return Pose(np.array([x, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]), age)


def test_before_the_first_pose_there_is_no_state():
    assert VelocityFilter().predict(3.0) is None


def test_the_first_sample_gives_no_spike():
    state = VelocityFilter().update(pose(5.0), 100.0)
    np.testing.assert_array_equal(state.v, 0.0)
    np.testing.assert_array_equal(state.w, 0.0)
    np.testing.assert_array_equal(state.p, [5.0, 0.0, 1.0])


def flying(f, until):
    for k in range(until + 1):
        state = f.update(pose(0.01 * k), 0.01 * k)
    return state


def test_without_poses_it_goes_on_at_constant_velocity_and_says_how_old_it_is():
    f = VelocityFilter()
    flying(f, 100)
    state = f.predict(1.2)
    assert state.p[0] == pytest.approx(1.2, abs=1e-6)
    assert state.age == pytest.approx(0.2)


def test_a_prediction_goes_no_further_than_the_horizon():
    f = VelocityFilter(horizon=0.5)
    flying(f, 100)
    assert f.predict(9.0).p[0] == pytest.approx(1.5, abs=1e-6)
    assert f.predict(9.0).age == pytest.approx(8.0)


def test_a_gap_leaves_the_mean_velocity_and_no_spike():
    f = VelocityFilter()
    flying(f, 100)
    assert f.update(pose(1.5), 1.5).v[0] == pytest.approx(1.0, abs=1e-6)


@pytest.mark.parametrize("now", [1.0, 0.9])
def test_a_repeated_or_older_pose_changes_nothing(now):
    f = VelocityFilter()
    before = flying(f, 100)
    again = f.update(pose(0.3, age=1.0 - now), 1.0)
    np.testing.assert_array_equal(again.flat, before.flat)


def test_a_pose_that_is_not_finite_counts_as_missing():
    f = VelocityFilter()
    flying(f, 100)
    state = f.update(pose(np.nan), 1.01)
    assert np.all(np.isfinite(state.flat))
    assert state.age == pytest.approx(0.01)
    assert f.refused == 1
    assert VelocityFilter().update(pose(np.inf), 0.0) is None


def measured(jitter, period):
    """Instants in s by a filter of poses every 10 ms, that seem to be late by what is drawn."""
    draw, motion = np.random.default_rng(2), VelocityFilter(period=period)
    instants = []
    for k in range(2000):
        late = jitter * draw.exponential() if k else 0.0
        motion.update(
            Pose(np.array([0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0])), 1.0 + 0.01 * k + late
        )
        instants.append(motion.measured)
    return np.array(instants)


@pytest.mark.parametrize("jitter", [5e-5, 5e-4])
def test_the_rate_of_the_cameras_tells_when_a_pose_was_measured(jitter):
    assert np.diff(measured(jitter, 0.01)).std() < 0.005 * jitter
    assert np.diff(measured(jitter, 0.0)).std() > 0.5 * jitter, "what it is for"


def test_poses_that_are_missed_are_counted_and_a_clock_that_is_wrong_is_followed():
    motion, fast = VelocityFilter(period=0.01), 1.0001
    for k in (*range(1000), *range(1005, 20_000, 3)):
        motion.update(
            Pose(np.array([0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0])), 1.0 + 0.01 * fast * k
        )
        assert motion.measured == pytest.approx(1.0 + 0.01 * fast * k, abs=2e-3)


def test_a_very_late_pose_is_not_taken_for_two():
    motion = VelocityFilter(period=0.01)
    for k in range(10):
        motion.update(
            Pose(np.array([0.01 * k, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0])),
            1.0 + 0.01 * k + 0.007 * (k == 5),
        )
    assert motion.measured == pytest.approx(1.09, abs=1e-4)


@pytest.mark.parametrize("size", [0.0, 0.49, 2.1, 1e200])
def test_a_pose_with_an_invalid_quaternion_counts_as_missing(size):
    bad = lambda x: Pose(np.array([x, 0.0, 1.0, 0.0, 0.0, 0.0, size]))  # noqa: E731
    f = VelocityFilter()
    assert f.update(bad(0.0), -1.0) is None
    flying(f, 100)
    state = f.update(bad(1.01), 1.01)
    assert np.all(np.isfinite(state.flat))
    assert state.age == pytest.approx(0.01)
    assert f.refused == 2
    assert f.update(pose(1.02), 1.02).age == 0.0


def test_a_returned_state_is_read_only():
    f = VelocityFilter()
    for state in (
        f.update(pose(0.0), 0.0),
        f.update(pose(0.1), 0.01),
        f.predict(0.02),
        f.update(pose(np.nan), 0.03),
    ):
        with pytest.raises(ValueError, match="read-only"):
            state.p[0] = 1.0


def test_the_speed_is_that_of_the_newest_state():
    f = VelocityFilter(motion=CommandedMotion(PAPER_PLATFORM.flat, -math.inf))
    assert f.speed == 0.0
    for k in range(5):
        state = f.update(pose(0.01 * k), 0.01 * k)
        assert f.speed == pytest.approx(np.linalg.norm(state.v))
    f.update(pose(np.nan), 0.05)
    falling = f.predict(0.35)
    assert f.speed == pytest.approx(np.linalg.norm(falling.v))
    assert falling.v[2] < -2.0
