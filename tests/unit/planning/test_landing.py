import numpy as np
import pytest

from crazychoir.planning.landing import FlightLegs, Landing
from crazychoir.planning.point_to_point import PointToPoint, plan_stop
from crazychoir.types import FullState


def test_a_landing_comes_to_rest_and_then_goes_straight_down():
    stop = plan_stop(FullState.at((0.0, 0.0, 1.0), (1.0, 0.5, 0.0)))
    floor = np.array([*stop.goal[0:2], 0.0])
    landing = Landing(stop, PointToPoint(FullState.at(stop.goal), floor, 0.0, 5.0))
    assert landing.duration == pytest.approx(stop.duration + 5.0)
    np.testing.assert_array_equal(landing.sample(0.0).p, [0.0, 0.0, 1.0])
    for t in np.linspace(stop.duration, landing.duration, 20):
        np.testing.assert_allclose(landing.sample(t).p[0:2], floor[0:2])
    np.testing.assert_array_equal(landing.sample(landing.duration).p, floor)
    assert landing.sample(landing.reaches(0.04)).p[2] == pytest.approx(0.04, abs=1e-3)
    assert landing.done(landing.duration)
    assert not landing.done(landing.duration - 0.01)


def test_the_legs_of_a_flight_follow_each_other_and_it_stays_at_the_end_of_the_last():
    there, back = np.array([1.0, 0.0, 1.0]), np.array([0.0, 0.5, 1.0])
    first = PointToPoint(FullState.at((0.0, 0.0, 1.0)), there, 0.0, 2.0)
    second, third = (
        PointToPoint(FullState.at(there), back, 0.0, 3.0),
        PointToPoint(FullState.at(back), there, 0.0, 1.0),
    )
    legs = FlightLegs(first, second, third)
    assert legs.duration == pytest.approx(6.0)
    assert legs.sample(1.2).flat == pytest.approx(first.sample(1.2).flat)
    for t, place in ((2.0, there), (5.0, back), (6.0, there), (9.0, there)):
        assert legs.sample(t).p == pytest.approx(place)
        assert legs.sample(t).v == pytest.approx(np.zeros(3))
    assert not legs.done(5.9)
    assert legs.done(6.0)
