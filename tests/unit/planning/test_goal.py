import numpy as np
import pytest

from crazychoir.errors import ConfigError
from crazychoir.planning.feasibility import Limits
from crazychoir.planning.goal import goto, land, takeoff, timed_goals
from crazychoir.types import FullState

HERE = FullState.at((0, 0, 0.1), yaw=0.5)
GOALS = [(0, 0, 0, 0.1, 0), (3, 1, 0, 1, 0), (6, 1, 1, 1, 2), (10, 0, 0, 1, -2)]


def test_a_flight_to_a_goal_takes_the_time_that_it_needs_at_least():
    there = np.array([2.0, 0, 1])
    fast, slow = goto(HERE, there), goto(HERE, there, duration=20.0)
    assert 0.99 < fast.peaks[0] <= 1.0
    assert slow.duration == 20.0
    assert fast.sample(fast.duration).yaw == pytest.approx(0.5)
    assert goto(HERE, there, duration=0.2).duration == pytest.approx(fast.duration)


def test_a_take_off_goes_straight_up():
    flight = takeoff(FullState.at((1, 2, 0)), 0.8)
    np.testing.assert_array_equal(flight.goal, (1, 2, 0.8))
    with pytest.raises(ConfigError, match="height at the start"):
        takeoff(FullState.at((1, 2, 1)), 0.8)


def test_a_landing_stops_first_and_goes_down_slowly():
    flight = land(FullState.at((0, 0, 1), (0.8, 0, 0), yaw=0.4), ground=0.1, speed=0.2)
    np.testing.assert_allclose(
        flight.sample(flight.duration).p, (*flight.legs[0].goal[0:2], 0.1)
    )
    assert flight.legs[0].goal[0] > 0.1
    assert 0.19 < flight.last.peaks[0] <= 0.2
    assert flight.sample(flight.duration).yaw == pytest.approx(0.4)
    with pytest.raises(ConfigError, match="height at rest"):
        land(HERE, ground=0.2)
    with pytest.raises(ConfigError, match="land: set-point"):
        land(
            FullState.at((0.9, 0, 1), (1, 0, 0)),
            limits=Limits(v_max=1, a_max=2, high=(1, 1, 2)),
        )


def test_goals_outside_of_the_fence_and_ways_through_it_are_refused():
    fence = Limits(v_max=1, a_max=2, yaw_rate_max=2, low=(-1, -1, 0), high=(1, 1, 2))
    with pytest.raises(ConfigError, match="goto: goal"):
        goto(HERE, np.array([2.0, 0, 1]), limits=fence)
    with pytest.raises(ConfigError, match="goto: set-point"):
        goto(FullState.at((0.9, 0, 1), (1, 0, 0)), np.array([0.5, 0, 1]), limits=fence)
    with pytest.raises(ConfigError, match="three numbers"):
        goto(HERE, np.zeros(2))


def test_timed_goals_are_reached_in_time_at_rest():
    flight = timed_goals(HERE, GOALS)
    assert flight.duration == 10.0
    for t, x, y, z, yaw in GOALS[1:]:
        state = flight.sample(t)
        np.testing.assert_allclose(state.p, (x, y, z), atol=1e-12)
        assert np.cos(state.yaw - yaw) == pytest.approx(1.0)
        np.testing.assert_allclose(state.flat[3:12], 0.0, atol=1e-9)
    assert flight.jumps[:, 0:3].max() < 1e-9
    assert abs(flight.sample(10.0).yaw - 2.0) < np.pi


@pytest.mark.parametrize(
    ("goals", "complaint"),
    [
        ([], "goals"),
        ([(1, 0, 0, 1)], r"\(k, 5\)"),
        ([(0, 0, 0, 0.1, 0)], r"goals\[0\]: t"),
        ([(-1, 0, 0, 1, 0)], r"goals\[0\]: t"),
        ([(3, 0, 0, 1, 0), (3, 1, 0, 1, 0)], r"goals\[1\]: t"),
        ([(3, 0, 0, 1, 0), (2, 1, 0, 1, 0)], r"goals\[1\]: t"),
        ([(3, 0, 0, 1, 0), (6, 0, np.nan, 1, 0)], r"goals\[1\].*finite"),
        ([(0, 1, 0, 1, 0), (6, 0, 0, 1, 0)], "the place of the start"),
        (
            [(3, 0, 0, 1, 0), (4, 3, 0, 1, 0)],
            r"goals\[1\]: trajectory at .* acceleration.*more time",
        ),
        (
            [(3, 0, 0, 1, 0), (99, 7, 0, 1, 0)],
            r"goals\[1\]: found \[7.0, 0.0, 1.0\].*fence",
        ),
    ],
)
def test_bad_lists_of_goals_are_refused(goals, complaint):
    with pytest.raises(ConfigError, match=complaint):
        timed_goals(
            HERE, goals, Limits(v_max=1, a_max=2, yaw_rate_max=2, high=(5, 5, 5))
        )
