import numpy as np
import pytest

from crazychoir.errors import ConfigError
from crazychoir.planning.feasibility import Limits, check_limits
from crazychoir.planning.figure import circle
from crazychoir.planning.piecewise import Piecewise
from crazychoir.planning.point_to_point import PointToPoint
from crazychoir.planning.scaling import (
    PICK_UP_TIME,
    ResumedTrajectory,
    SlowedTrajectory,
    compute_slowdown,
    fit_to_limits,
    slow_down,
)
from crazychoir.types import FullState

FIGURE = circle((0, 0, 1), 0.5, 2.0, laps=2, yaw="along")


def test_what_keeps_the_limits_stays_itself():
    assert fit_to_limits(FIGURE, Limits(v_max=9.0)) is FIGURE
    assert compute_slowdown(FIGURE, Limits(v_max=9.0)) < 0.2


def test_what_was_scaled_passes_the_check():
    limits = Limits(
        v_max=1.0,
        a_max=1.2,
        j_max=9.0,
        yaw_rate_max=2.0,
        tilt_max=0.2,
        thrust_max=0.31,
        mass=0.03,
    )
    with pytest.raises(ConfigError):
        check_limits(FIGURE, limits)
    slow = fit_to_limits(FIGURE, limits)
    check_limits(slow, limits)
    assert isinstance(slow, SlowedTrajectory)
    assert slow.done(slow.duration)
    assert not slow.done(FIGURE.duration)


def test_pieces_stay_pieces():
    flight = PointToPoint(FullState.at((0, 0, 1)), np.ones(3), 0.0, 1.0)
    slow = fit_to_limits(flight, Limits(v_max=1.0))
    assert isinstance(slow, Piecewise)
    np.testing.assert_allclose(slow.sample(slow.duration).p, 1.0)


def test_no_speed_brings_it_into_the_fence():
    with pytest.raises(ConfigError, match="fence"):
        fit_to_limits(FIGURE, Limits(v_max=1.0, high=(0.4, 1, 2)))


@pytest.mark.parametrize("factor", [0.0, -1.0, np.nan, np.inf])
def test_bad_factors_are_refused(factor):
    with pytest.raises(ConfigError, match="factor"):
        slow_down(FIGURE, factor)


@pytest.mark.parametrize("t_0", [0.0, 1.3, 3.9])
def test_what_is_resumed_begins_at_rest_and_is_the_same_path(t_0):
    rest = ResumedTrajectory(FIGURE, t_0)
    first = rest.sample(0.0)
    np.testing.assert_allclose(
        first.flat[0:3], FIGURE.sample(min(t_0, FIGURE.duration - PICK_UP_TIME / 2)).p
    )
    np.testing.assert_allclose(first.flat[3:9], 0.0, atol=1e-12)
    np.testing.assert_allclose(
        rest.sample(rest.duration).p, FIGURE.sample(FIGURE.duration).p, atol=1e-9
    )
    assert rest.done(rest.duration)
    h = 1e-4
    for t in np.linspace(0.01, rest.duration - 0.01, 37):
        before, here, after = (
            rest.sample(t - h).flat,
            rest.sample(t).flat,
            rest.sample(t + h).flat,
        )
        largest = max(1.0, abs(here[3:12]).max())
        np.testing.assert_allclose(
            (after[0:9] - before[0:9]) / (2 * h), here[3:12], atol=2e-2 * largest
        )
        np.testing.assert_allclose(
            (after[12] - before[12]) / (2 * h), here[13], atol=1e-3
        )


def test_what_is_resumed_gets_the_pace_of_its_trajectory():
    rest = ResumedTrajectory(FIGURE, 0.5)
    np.testing.assert_allclose(
        rest.sample(PICK_UP_TIME + 0.3).flat,
        FIGURE.sample(0.5 + PICK_UP_TIME / 2 + 0.3).flat,
        atol=1e-9,
    )


def test_what_is_resumed_slowly_enough_asks_for_little_more_than_the_whole():
    v, a = (
        max(
            np.linalg.norm(FIGURE.sample(t).flat[k : k + 3])
            for t in np.linspace(0, 6, 200)
        )
        for k in (3, 6)
    )
    for t_0 in np.linspace(0.0, FIGURE.duration - 0.01, 23):
        rest = ResumedTrajectory(FIGURE, t_0, 4.0 * v / a)
        hardest = max(
            np.linalg.norm(rest.sample(t).flat[6:9])
            for t in np.linspace(0, rest.duration, 300)
        )
        assert hardest <= 1.1 * a


@pytest.mark.parametrize("t_0", [-0.1, FIGURE.duration, np.nan])
def test_what_is_over_is_not_resumed(t_0):
    with pytest.raises(ConfigError, match="Resumed"):
        ResumedTrajectory(FIGURE, t_0)
