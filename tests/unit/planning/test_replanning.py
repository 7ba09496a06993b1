import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from crazychoir.errors import ConfigError
from crazychoir.planning.feasibility import Limits, compute_peaks
from crazychoir.planning.figure import circle
from crazychoir.planning.replanning import join_trajectory
from crazychoir.types import FullState

RUNNING = circle((0, 0, 1), 0.5, 4.0, laps=5, yaw="along")
LIMITS = Limits(v_max=2.0, a_max=4.0, yaw_rate_max=4.0)
number = st.floats(-0.7, 0.7)
triple = st.tuples(number, number, number)
states = st.builds(
    FullState.at, triple, triple, triple, triple, st.floats(-3.0, 3.0), number
)


@given(states, st.floats(0.0, 15.0))
def test_a_join_is_continuous_down_to_the_jerk_and_ends_where_the_trajectory_is(
    start, now
):
    plan = join_trajectory(start, RUNNING, now, LIMITS)
    np.testing.assert_allclose(plan.sample(0.0).flat, start.flat, atol=1e-12)
    met, h = plan.way.duration, 1e-7
    before, after = plan.sample(met - h).flat, plan.sample(met).flat
    np.testing.assert_allclose(before[0:9], after[0:9], atol=1e-4)
    np.testing.assert_allclose(before[9:12], after[9:12], atol=1e-3)
    assert before[12] == pytest.approx(after[12], abs=1e-5)
    for t in (met, met + 1.0):
        there = RUNNING.sample(now + t).flat
        np.testing.assert_allclose(plan.sample(t).flat[0:12], there[0:12], atol=1e-9)
        assert np.cos(plan.sample(t).yaw - there[12]) == pytest.approx(1.0)
    assert abs(plan.sample(met).yaw - start.yaw) <= np.pi + 1e-9
    assert compute_peaks(plan.way)["speed"] <= 2.01


def test_a_join_ends_with_its_trajectory():
    plan = join_trajectory(FullState.at((0, 0, 1)), RUNNING, 3.0, LIMITS)
    assert plan.duration == pytest.approx(RUNNING.duration - 3.0)
    assert plan.done(plan.duration)
    assert not plan.done(plan.duration - 0.1)
    late = join_trajectory(FullState.at((0, 0, 1)), RUNNING, 99.0, LIMITS)
    assert late.duration == late.way.duration
    np.testing.assert_allclose(
        late.sample(late.duration).p, RUNNING.sample(99.0).p, atol=1e-9
    )


def test_a_given_duration_is_kept_or_refused():
    start = FullState.at((0, 0, 1))
    assert (
        join_trajectory(start, RUNNING, 3.0, LIMITS, duration=4.0).way.duration == 4.0
    )
    with pytest.raises(ConfigError, match=r"join: duration.*0\.2 s"):
        join_trajectory(start, RUNNING, 3.0, LIMITS, duration=0.2)
    with pytest.raises(ConfigError, match="duration"):
        join_trajectory(start, RUNNING, 3.0, LIMITS, duration=0.0)


def test_a_trajectory_that_is_too_fast_to_be_met_is_refused():
    far = FullState.at((200, 0, 1))
    with pytest.raises(ConfigError, match="wider limits"):
        join_trajectory(far, RUNNING, 3.0, Limits(v_max=0.5, a_max=1.0))


def test_a_way_through_the_fence_is_refused():
    start = FullState.at((0.7, 0, 1), (0.5, 0, 0))
    way = join_trajectory(start, RUNNING, 3.0, Limits(v_max=2, a_max=2)).way
    assert max(way.sample(t).p[0] for t in np.linspace(0.0, way.duration, 100)) > 0.9
    with pytest.raises(ConfigError, match="wider fence"):
        join_trajectory(start, RUNNING, 3.0, Limits(v_max=2, a_max=2, high=(0.9, 9, 9)))
    join_trajectory(start, RUNNING, 3.0, Limits(v_max=2, a_max=2, high=(0.92, 9, 9)))
    falling = FullState.at((0.5, 0, 0.6), (0, 0, -0.5))
    with pytest.raises(ConfigError, match="wider fence"):
        join_trajectory(
            falling, RUNNING, 3.0, Limits(v_max=2, a_max=2, low=(-9, -9, 0.55))
        )


def test_a_drone_outside_the_fence_may_come_back():
    for sign in (-1.0, 1.0):
        start = FullState.at((sign * 0.9, 0, 1))
        plan = join_trajectory(
            start,
            RUNNING,
            3.0,
            Limits(v_max=2, a_max=4, low=(-0.6, -0.6, 0), high=(0.6, 0.6, 2)),
        )
        np.testing.assert_allclose(
            plan.sample(plan.way.duration).p, RUNNING.sample(3.0 + plan.way.duration).p
        )
