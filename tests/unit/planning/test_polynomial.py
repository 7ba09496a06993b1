import numpy as np
import pytest

from crazychoir.errors import ConfigError
from crazychoir.planning.polynomial import Polynomial7th
from crazychoir.types import FullState

HERE = FullState.at((0, 0, 1), (0.5, 0, 0), yaw=3.0, yaw_rate=0.2)
THERE = FullState.at((1, 2, 1), (0, 0.3, 0), (0, 0, 1), (1, 0, 0), yaw=-3.0)


def test_it_ends_moving_and_then_stands():
    plan = Polynomial7th(HERE, THERE, 2.0)
    np.testing.assert_array_equal(plan.sample(2.0).v, (0, 0.3, 0))
    np.testing.assert_array_equal(plan.sample(2.1).v, 0.0)
    np.testing.assert_array_equal(plan.goal, (1, 2, 1))
    assert plan.sample(2.0).yaw == pytest.approx(2.0 * np.pi - 3.0)


@pytest.mark.parametrize("duration", [0.0, -1.0, np.nan, np.inf])
def test_a_duration_that_cannot_be_flown_is_refused(duration):
    with pytest.raises(ConfigError, match="Polynomial7th: duration"):
        Polynomial7th(HERE, THERE, duration)


def test_an_end_that_is_not_finite_is_named():
    with pytest.raises(ConfigError, match="goal"):
        Polynomial7th(HERE, FullState.at((0, np.nan, 0)), 1.0)
    with pytest.raises(ConfigError, match="start"):
        Polynomial7th(FullState(np.zeros(13)), HERE, 1.0)
