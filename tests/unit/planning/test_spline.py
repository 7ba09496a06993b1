import numpy as np
import pytest

from crazychoir.errors import ConfigError
from crazychoir.planning.spline import compute_chord_times, fit_spline, unwrap_yaws
from crazychoir.types import FullState

PLACES = np.array([[0, 0, 1], [1, 0, 1], [1, 1, 1]], dtype=float)


def test_without_ends_it_starts_and_ends_at_rest():
    flight = fit_spline([1.0, 2.0, 4.0], PLACES)
    assert flight.duration == 3.0
    np.testing.assert_allclose(flight.sample(0.0).flat[3:9], 0.0, atol=1e-12)
    np.testing.assert_allclose(flight.sample(3.0).flat[3:9], 0.0, atol=1e-12)


@pytest.mark.parametrize(
    ("times", "places", "complaint"),
    [
        ([0, 1, 1], PLACES, r"times\[2\].*more than times\[1\] = 1"),
        ([0, 2, 1], PLACES, r"times\[2\]"),
        ([0, 1], PLACES, "3 finite numbers"),
        ([0, 1, np.nan], PLACES, "3 finite numbers"),
        ([0], PLACES[:1], "k at least 2"),
        ([0, 1], PLACES[:2, :2], r"\(k, 3\)"),
        ([0, 1], [[0, 0, 0], [np.inf, 0, 0]], r"places\[1\]"),
    ],
)
def test_what_has_no_spline_is_refused(times, places, complaint):
    with pytest.raises(ConfigError, match=complaint):
        fit_spline(times, places)


def test_a_derivative_that_the_degree_has_no_room_for_is_refused():
    moving = FullState.at((0, 0, 0), (1, 0, 0), (0, 1, 0))
    with pytest.raises(ConfigError, match="acceleration at an end"):
        fit_spline([0, 1, 2], PLACES, start=moving, degree=3)
    with pytest.raises(ConfigError, match="jerk at an end"):
        fit_spline(
            [0, 1, 2], PLACES, goal=FullState.at((0, 0, 0), j=(0, 0, 1)), degree=5
        )
    with pytest.raises(ConfigError, match="3, 5 or 7"):
        fit_spline([0, 1, 2], PLACES, degree=4)
    with pytest.raises(ConfigError, match="finite"):
        fit_spline([0, 1, 2], PLACES, start=FullState.at((0, 0, 0), (np.nan, 0, 0)))


def test_yaws_take_the_short_way():
    np.testing.assert_allclose(
        unwrap_yaws([3.0, -3.0, 3.0, 0.5], 4), [3.0, 2 * np.pi - 3.0, 3.0, 0.5]
    )
    with pytest.raises(ConfigError, match="yaws"):
        unwrap_yaws([0.0, 1.0], 3)


def test_times_of_chords():
    np.testing.assert_allclose(compute_chord_times(PLACES), [0, 1, 2])
    with pytest.raises(ConfigError, match=r"places\[2\].*give times, to wait"):
        compute_chord_times(PLACES[[0, 1, 1]])
