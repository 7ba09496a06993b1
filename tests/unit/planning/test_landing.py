import numpy as np
import pytest

from crazychoir.planning.landing import Landing
from crazychoir.planning.point_to_point import PointToPoint, stopping
from crazychoir.types import FullState


def test_a_landing_comes_to_rest_and_then_goes_straight_down():
    stop = stopping(FullState.at((0.0, 0.0, 1.0), (1.0, 0.5, 0.0)))
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
