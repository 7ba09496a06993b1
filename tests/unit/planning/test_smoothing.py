import numpy as np
import pytest

from crazychoir.errors import ConfigError
from crazychoir.planning.smoothing import PULSE_RESPONSE, GoalSmoother

H = 0.01


def flown(goals, v_max=0.6, a_max=1.8):
    """(n, 14), and the smoother."""
    smoother = GoalSmoother(np.zeros(3), v_max, a_max, H)
    return np.array([smoother.step(goal).flat for goal in goals]), smoother


def test_a_goal_that_jumps_is_followed_within_the_limits_and_without_a_jump():
    jumps = np.repeat(np.random.default_rng(3).uniform(-2, 2, size=(40, 3)), 50, axis=0)
    x, smoother = flown(jumps)
    v, a, j = (np.linalg.norm(x[:, 3 * n : 3 * n + 3], axis=1) for n in (1, 2, 3))
    assert 0.5 < v.max() <= 0.6 * 1.001
    assert a.max() <= PULSE_RESPONSE.slope * smoother.w * 0.6 * 1.001 <= 1.8 * 1.002
    assert j.max() <= PULSE_RESPONSE.curvature * smoother.w**2 * 0.6 * 1.02
    for n in range(3):  # each derivative is the slope of the one before: nothing jumps
        slope = np.diff(x[:, 3 * n : 3 * n + 3], axis=0) / H
        middle = 0.5 * (x[1:, 3 * n + 3 : 3 * n + 6] + x[:-1, 3 * n + 3 : 3 * n + 6])
        assert np.abs(slope - middle).max() < (0.01, 0.05, 1.0)[n]


def test_it_comes_to_rest_at_its_goal():
    x, _ = flown(np.tile([1.0, -2.0, 0.5], (1500, 1)))
    np.testing.assert_allclose(x[-1], [1.0, -2.0, 0.5, *np.zeros(11)], atol=1e-9)


def test_a_goal_that_moves_evenly_is_followed_late():
    t = H * np.arange(1, 1001)
    x, smoother = flown(np.outer(t, [0.3, 0.0, 0.0]))
    assert 0.3 * t[-1] - x[-1, 0] == pytest.approx(0.3 * smoother.lag, abs=0.003)


@pytest.mark.parametrize("far", [0.02, 3.0])
def test_a_goal_that_stands_is_reached_within_1_percent_of_the_way_when_it_is_said(far):
    x, smoother = flown(np.tile([far, 0.0, 0.0], (1500, 1)))
    said = far / 0.6 + 10.1 / smoother.w
    left = 1.0 - x[:, 0] / far
    assert (
        left[round(said / H)]
        < 0.01
        < left[round((said - 0.5 * far / 0.6 - 0.5 / smoother.w) / H)]
    )


def test_late_steps_make_up_for_what_was_missed():
    one, other = (
        GoalSmoother(np.zeros(3), 1.0, 2.0, H),
        GoalSmoother(np.zeros(3), 1.0, 2.0, H),
    )
    for _ in range(3):
        last = one.step(np.ones(3))
    np.testing.assert_array_equal(other.step(np.ones(3), 0.0301).flat, last.flat)


@pytest.mark.parametrize(
    "limits", [(0.0, 1.0, H), (1.0, -1.0, H), (1.0, float("nan"), H), (1.0, 1.0, 0.0)]
)
def test_limits_are_positive(limits):
    with pytest.raises(ConfigError, match="a positive number"):
        GoalSmoother(np.zeros(3), *limits)
