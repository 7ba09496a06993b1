import numpy as np
import pytest

from crazychoir.errors import ConfigError
from crazychoir.planning.point_to_point import (
    STOP_DISTANCE,
    PointToPoint,
    compute_flight_time,
    plan_stop,
)
from crazychoir.types import FullState

START = FullState.at((0, 0, 1))
GOAL = np.array([1.0, 2.0, 1.5])


def test_before_the_start_and_after_the_end_it_holds():
    plan = PointToPoint(START, GOAL, 0.0, 3.0)
    np.testing.assert_array_equal(plan.sample(-1.0).flat, START.flat)
    for t in (3.0, 3.0001, 99.0):
        np.testing.assert_array_equal(plan.sample(t).p, GOAL)
        np.testing.assert_array_equal(plan.sample(t).flat[3:12], 0.0)
    assert plan.done(3.0)
    assert not plan.done(2.999)


def test_replanning_in_flight_is_continuous_in_all_four_derivatives():
    plan = PointToPoint(START, GOAL, 1.0, 3.0)
    here = plan.sample(1.1)
    assert np.linalg.norm(here.v) > 0.5
    again = PointToPoint(here, np.array([-1.0, 0.0, 1.0]), 0.0, 4.0)
    np.testing.assert_allclose(again.sample(0.0).flat, here.flat, atol=1e-12)


def test_yaw_turns_the_short_way():
    plan = PointToPoint(FullState.at((0, 0, 1), yaw=3.0), GOAL, -3.0, 2.0)
    yaws = [plan.sample(t).yaw for t in np.linspace(0.0, 2.0, 50)]
    assert yaws == sorted(yaws)
    assert yaws[-1] == pytest.approx(2.0 * np.pi - 3.0)


@pytest.mark.parametrize("duration", [0.0, -1.0, np.nan, np.inf])
def test_a_duration_that_cannot_be_flown_is_refused(duration):
    with pytest.raises(ConfigError, match="duration"):
        PointToPoint(START, GOAL, 0.0, duration)


@pytest.mark.parametrize("goal", [np.array([1.0, np.nan, 1.0]), np.zeros(2)])
def test_a_goal_that_is_no_place_is_refused(goal):
    with pytest.raises(ConfigError, match="goal"):
        PointToPoint(START, goal, 0.0, 1.0)


def test_staying_takes_the_shortest_flight_and_turning_takes_its_time():
    assert compute_flight_time(START, START.p, 0.0) == pytest.approx(0.1)
    assert compute_flight_time(START, START.p, 3.0, yaw_rate_max=1.0) > 6.0


@pytest.mark.parametrize("v", [(1.0, 0.0, 0.0), (-0.6, 0.8, 0.0), (0.0, 0.3, -0.4)])
def test_a_stop_brakes_with_a_max_all_the_way_and_never_turns_back(v):
    start = FullState.at((1.0, 2.0, 1.0), v, yaw=0.7)
    stop, speed = plan_stop(start, 2.0), np.linalg.norm(v)
    np.testing.assert_allclose(
        stop.goal - start.p, STOP_DISTANCE * speed * np.array(v) / 2.0
    )
    assert stop.peaks[1] == pytest.approx(2.0, rel=0.01)
    along = [
        stop.sample(t).v @ np.array(v) for t in np.linspace(0.0, stop.duration, 50)
    ]
    assert along == sorted(along, reverse=True)
    assert stop.sample(stop.duration).yaw == pytest.approx(0.7)


def test_a_stop_under_way_goes_on_from_all_four_derivatives_and_keeps_the_limit():
    plan = PointToPoint(START, GOAL, 0.0, 4.0)
    here = plan.sample(1.3)
    stop = plan_stop(here, 2.0)
    np.testing.assert_allclose(stop.sample(0.0).flat, here.flat, atol=1e-12)
    assert stop.peaks[1] <= 2.01
    assert np.linalg.norm(stop.goal - here.p) < 0.7
    at_end = stop.sample(stop.duration * (1.0 - 1e-9)).flat
    np.testing.assert_allclose(at_end[3:12], 0.0, atol=1e-5)


def test_a_drone_at_rest_stops_where_it_is():
    assert plan_stop(START).duration == pytest.approx(0.1)
    np.testing.assert_array_equal(plan_stop(START).goal, START.p)
