import numpy as np
import pytest

from crazychoir.errors import ConfigError
from crazychoir.planning.feasibility import Limits, compute_peaks
from crazychoir.planning.minimum_snap import minimum_snap
from crazychoir.planning.scaling import compute_slowdown
from crazychoir.types import FullState

WAYPOINTS = np.array([[0, 0, 1], [1, 0, 1], [1, 1, 1.5], [0, 1, 1]], dtype=float)


def test_without_times_it_is_as_fast_as_the_limits_allow():
    limits = Limits(v_max=0.8, a_max=1.5)
    flight = minimum_snap(WAYPOINTS, limits=limits)
    most = compute_peaks(flight)
    assert most["speed"] <= 0.8
    assert most["acceleration"] <= 1.5
    assert most["speed"] > 0.79 or most["acceleration"] > 1.48
    for place, knot in zip(WAYPOINTS, flight.knots, strict=True):
        np.testing.assert_allclose(flight.sample(knot).p, place, atol=1e-9)
    np.testing.assert_allclose(flight.sample(0.0).flat[3:12], 0.0, atol=1e-9)
    np.testing.assert_allclose(
        flight.sample(flight.duration).flat[3:12], 0.0, atol=1e-9
    )


def test_an_end_that_moves_is_honoured_while_the_limits_are_kept():
    start = FullState.at((0, 0, 1), (0.5, 0.2, 0), (0.3, 0, 0), (0.1, 0, 0))
    limits = Limits(v_max=0.8, a_max=1.5)
    flight = minimum_snap(WAYPOINTS, start=start, limits=limits)
    np.testing.assert_allclose(
        flight.sample(0.0).flat[0:12], start.flat[0:12], atol=1e-9
    )
    assert 0.95 < compute_slowdown(flight, limits) <= 1.002


def test_a_start_that_is_too_fast_is_refused():
    with pytest.raises(ConfigError, match=r"0\.00 s: speed.*at most 0\.8"):
        minimum_snap(
            WAYPOINTS,
            start=FullState.at((0, 0, 1), (1, 0, 0)),
            limits=Limits(v_max=0.8, a_max=1.5),
        )


def test_ends_that_break_the_limits_in_any_time_are_refused():
    back = FullState.at((0, 0, 1), (-0.8, 0, 0))
    with pytest.raises(ConfigError, match=r"time for all waypoints.*ends at rest"):
        minimum_snap(WAYPOINTS, start=back, limits=Limits(v_max=0.8, a_max=0.5))


def test_given_times_are_kept_or_refused():
    assert minimum_snap(WAYPOINTS, [0, 0.1, 0.2, 0.3]).duration == pytest.approx(0.3)
    with pytest.raises(ConfigError, match=r"speed.*Give it more time"):
        minimum_snap(WAYPOINTS, [0, 1, 2, 3], limits=Limits(v_max=1.0))


def test_a_waypoint_outside_of_the_fence_is_named():
    with pytest.raises(
        ConfigError, match=r"waypoints\[2\]: found \[1.0, 1.0, 1.5\].*within the fence"
    ):
        minimum_snap(
            WAYPOINTS,
            limits=Limits(v_max=1, a_max=2, low=(-1, -1, 0), high=(2, 2, 1.2)),
        )


def test_a_flight_that_leaves_the_fence_between_waypoints_is_refused():
    with pytest.raises(ConfigError, match="set-point"):
        minimum_snap(
            WAYPOINTS, limits=Limits(v_max=1, a_max=2, low=(0, 0, 0), high=(1, 1, 1.5))
        )


@pytest.mark.parametrize(
    ("waypoints", "complaint"),
    [
        (WAYPOINTS[:1], "k at least 2"),
        ([[0, 0, 0], [0, np.nan, 0]], r"waypoints\[1\]"),
        (WAYPOINTS[[0, 1, 1, 2]], r"places\[2\].*another place"),
    ],
)
def test_bad_waypoints_are_refused(waypoints, complaint):
    with pytest.raises(ConfigError, match=complaint):
        minimum_snap(waypoints)


def test_without_times_and_limits_nothing_says_how_fast():
    with pytest.raises(ConfigError, match="v_max"):
        minimum_snap(WAYPOINTS, limits=Limits(a_max=1.0))


def test_forty_waypoints_are_no_trouble():
    places = np.cumsum(np.random.default_rng(1).uniform(-1, 1, (40, 3)), axis=0)
    flight = minimum_snap(places, np.arange(40.0))
    assert flight.jumps[0:3, 0:5].max() < 1e-8
