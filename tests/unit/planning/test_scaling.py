import numpy as np
import pytest

from crazychoir.errors import ConfigError
from crazychoir.planning.feasibility import Limits, check
from crazychoir.planning.figure import circle
from crazychoir.planning.piecewise import Piecewise
from crazychoir.planning.point_to_point import PointToPoint
from crazychoir.planning.scaling import Slowed, scaled, slowdown, slowed
from crazychoir.types import FullState

FIGURE = circle((0, 0, 1), 0.5, 2.0, laps=2, yaw="along")


def test_what_keeps_the_limits_stays_itself():
    assert scaled(FIGURE, Limits(v_max=9.0)) is FIGURE
    assert slowdown(FIGURE, Limits(v_max=9.0)) < 0.2


def test_what_was_scaled_passes_the_check():
    limits = Limits(v_max=1.0, a_max=1.2, j_max=9.0, yaw_rate_max=2.0, tilt_max=0.2, thrust_max=0.31, mass=0.03)
    with pytest.raises(ConfigError):
        check(FIGURE, limits)
    slow = scaled(FIGURE, limits)
    check(slow, limits)
    assert isinstance(slow, Slowed)
    assert slow.done(slow.duration)
    assert not slow.done(FIGURE.duration)


def test_pieces_stay_pieces():
    flight = PointToPoint(FullState.at((0, 0, 1)), np.ones(3), 0.0, 1.0)
    slow = scaled(flight, Limits(v_max=1.0))
    assert isinstance(slow, Piecewise)
    np.testing.assert_allclose(slow.sample(slow.duration).p, 1.0)


def test_no_speed_brings_it_into_the_fence():
    with pytest.raises(ConfigError, match="fence"):
        scaled(FIGURE, Limits(v_max=1.0, high=(0.4, 1, 2)))


@pytest.mark.parametrize("factor", [0.0, -1.0, np.nan, np.inf])
def test_bad_factors_are_refused(factor):
    with pytest.raises(ConfigError, match="factor"):
        slowed(FIGURE, factor)
