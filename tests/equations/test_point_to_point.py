import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from crazychoir.planning.point_to_point import (
    PEAK_ACCELERATION,
    PEAK_SPEED,
    PointToPoint,
    compute_flight_time,
)
from crazychoir.types import FullState

number = st.floats(-2.0, 2.0)
triple = st.tuples(number, number, number)
states = st.builds(FullState.at, triple, triple, triple, triple, number, number)


@given(states, triple, st.floats(-6.0, 6.0), st.floats(0.5, 10.0))
def test_it_meets_the_start_and_the_goal(start, goal, yaw, duration):
    plan = PointToPoint(start, np.array(goal), yaw, duration)
    np.testing.assert_allclose(plan.sample(0.0).flat, start.flat, atol=1e-12)
    end, held = plan.sample(duration * (1 - 1e-12)).flat, plan.sample(duration).flat
    np.testing.assert_allclose(held[0:3], goal)
    np.testing.assert_allclose(held[3:12], 0.0)
    np.testing.assert_allclose(end[0:6], held[0:6], atol=1e-8)
    np.testing.assert_allclose(end[6:12], held[6:12], atol=1e-5)
    assert math.cos(held[12] - yaw) == pytest.approx(1.0)


@given(states, triple, number, st.floats(1.0, 10.0), st.floats(0.05, 0.95))
def test_velocity_acceleration_and_jerk_are_the_derivatives(
    start, goal, yaw, duration, part
):
    plan, t, h = (
        PointToPoint(start, np.array(goal), yaw, duration),
        part * duration,
        1e-5,
    )
    before, here, after = (
        plan.sample(t - h).flat,
        plan.sample(t).flat,
        plan.sample(t + h).flat,
    )
    slope = (after - before) / (2.0 * h)
    np.testing.assert_allclose(slope[0:9], here[3:12], rtol=1e-5, atol=1e-5)
    assert slope[12] == pytest.approx(here[13], abs=1e-5)


def test_peaks_of_a_flight_from_rest_to_rest():
    plan = PointToPoint(FullState.at((0, 0, 1)), np.array([1.0, 0.0, 1.0]), 0.0, 1.0)
    fine = np.array([plan.sample(t).flat for t in np.linspace(0.0, 1.0, 20001)])
    assert fine[:, 3].max() == pytest.approx(PEAK_SPEED, rel=1e-6)
    assert np.abs(fine[:, 6]).max() == pytest.approx(PEAK_ACCELERATION, rel=1e-6)


@given(triple, triple, st.floats(0.3, 2.0), st.floats(0.5, 4.0))
def test_the_duration_from_rest_keeps_the_limits_and_wastes_nothing(
    p, goal, v_max, a_max
):
    start, goal = FullState.at(p), np.array(goal)
    duration = compute_flight_time(start, goal, 0.0, v_max, a_max)
    speed, acceleration, _ = PointToPoint(start, goal, 0.0, duration).peaks
    assert speed <= 1.0001 * v_max
    assert acceleration <= 1.0001 * a_max
    if duration > 0.11:
        assert speed > 0.99 * v_max or acceleration > 0.97 * a_max


@given(states, triple)
def test_the_duration_under_way_keeps_the_limits_where_any_duration_does(start, goal):
    def excess(duration):
        return max(
            np.array(PointToPoint(start, np.array(goal), 0.0, duration).peaks)
            / [4.0, 20.0, 6.0]
        )

    duration = compute_flight_time(
        start, np.array(goal), 0.0, v_max=4.0, a_max=20.0, yaw_rate_max=6.0
    )
    others = [excess(other) for other in np.geomspace(0.1, 30.0, 60)]
    assert excess(duration) < 1.02 or excess(duration) < 1.02 * min(others)
