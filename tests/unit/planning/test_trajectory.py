import numpy as np
import pytest

from crazychoir.errors import ConfigError
from crazychoir.planning.figure import circle
from crazychoir.planning.trajectory import sample_setpoints


def test_set_points_are_at_the_rate_and_at_the_end():
    figure = circle((0, 0, 1), 0.5, 1.0, ramp=0.33)
    t, x = sample_setpoints(figure, 10.0)
    np.testing.assert_allclose(t[:-1], np.arange(14) / 10.0)
    assert t[-1] == figure.duration
    assert x.shape == (15, 14)
    np.testing.assert_array_equal(x[7], figure.sample(0.7).flat)
    t, _ = sample_setpoints(circle((0, 0, 1), 0.5, 1.0, ramp=0.5), 10.0)
    np.testing.assert_allclose(t, np.arange(16) / 10.0)


@pytest.mark.parametrize("rate", [0.0, -1.0, np.nan, np.inf, 1e9])
def test_a_rate_that_is_none_is_refused(rate):
    with pytest.raises(ConfigError, match="set-points"):
        sample_setpoints(circle((0, 0, 1), 0.5, 1.0), rate)
