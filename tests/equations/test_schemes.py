"""The equations of the cooperative schemes: smoothing, aggregative costs, predictive control."""

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.linalg import expm, solve_discrete_are

from crazychoir.guidance.aggregative import Defence
from crazychoir.optimization.predictive_control import (
    Prediction,
    PredictiveControl,
    integrators,
)
from crazychoir.planning import smoothing
from crazychoir.planning.smoothing import compute_transition


def test_the_smoother_moves_as_four_equal_lags():
    w, h = 3.7, 0.04
    a, b = np.zeros((5, 5)), np.arange(3)
    a[b, b + 1] = 1.0  # p' = v, v' = a, a' = j, and u stays
    a[3] = [-(w**4), -4 * w**3, -6 * w**2, -4 * w, w**4]
    keep, take = compute_transition(w, h)
    np.testing.assert_allclose(
        np.column_stack([keep, take]), expm(h * a)[:4], atol=1e-12
    )


def test_the_bounds_of_the_smoother_are_the_integrals_of_its_answer():
    slope = lambda t: (t**2 / 2 - t**3 / 6) * np.exp(-t)  # noqa: E731
    curve = lambda t: (t - t**2 + t**3 / 6) * np.exp(-t)  # noqa: E731
    peaks = [3.0, 3 - 3**0.5, 3 + 3**0.5]
    for found, of in (
        (smoothing.PULSE_RESPONSE.slope, slope),
        (smoothing.PULSE_RESPONSE.curvature, curve),
    ):
        assert found == pytest.approx(
            quad(lambda t, of=of: abs(of(t)), 0, 60, points=peaks, limit=200)[0],
            abs=2e-4,
        )


@pytest.fixture
def defence():
    return Defence(np.array([0.3, -0.2]), intruder=1.5, goal=0.7, team=0.4)


def cost(d, x, s, r):
    return (
        d.intruder * sum((x - r) ** 2)
        + d.goal * sum((s - d.target) ** 2)
        + d.team * sum((x - s) ** 2)
    )


def test_the_gradients_of_a_defence(defence):
    draw = np.random.default_rng(0)
    x, s, r = draw.normal(size=(3, 2))
    for k, e in enumerate(1e-6 * np.eye(2)):
        own = (cost(defence, x + e, s, r) - cost(defence, x - e, s, r)) / 2e-6
        mean = (cost(defence, x, s + e, r) - cost(defence, x, s - e, r)) / 2e-6
        assert defence.gradient_own(x, s, r)[k] == pytest.approx(own, abs=1e-8)
        assert defence.gradient_mean(x, s)[k] == pytest.approx(mean, abs=1e-8)


def test_the_optimum_of_a_defence_is_that_of_the_sum_of_all_costs(defence):
    r = np.random.default_rng(1).normal(size=(4, 2))
    total = lambda x: sum(cost(defence, x[i], x.mean(axis=0), r[i]) for i in range(4))  # noqa: E731
    best = defence.optimum(r)
    for i in range(4):
        for k in range(2):
            e = np.zeros((4, 2))
            e[i, k] = 1e-5
            assert (total(best + e) - total(best - e)) / 2e-5 == pytest.approx(
                0.0, abs=1e-8
            )


@pytest.mark.parametrize(
    ("target", "places"),
    [
        ((0.0, 0.0), [(-0.5, 0.5), (-0.5, -0.5), (0.5, 0.0)]),
        ((0.2, 0.0), [(-0.4, 0.5), (-0.4, -0.5), (0.6, 0.0)]),
    ],
)
def test_with_equal_weights_a_defender_is_half_way(target, places):
    found = Defence(np.array(target)).optimum(
        np.array([(-1.0, 1.0), (-1.0, -1.0), (1.0, 0.0)])
    )
    np.testing.assert_allclose(found, places, atol=1e-12)


def test_jerk_that_is_held_integrates_exactly():
    h, one = 0.3, np.eye(2)
    chain = np.kron(np.eye(4, k=1), one)  # p' = v, v' = a, a' = u, u' = 0
    whole = expm(h * chain)
    A, B = integrators(h, 2)
    np.testing.assert_allclose(np.hstack([A, B]), whole[:6], atol=1e-12)


def test_the_condensed_program_is_the_cost_of_the_steps():
    draw, T = np.random.default_rng(2), 4
    A, B = integrators(0.5, 1)
    Q, P, R = np.diag([1.0, 0.5, 0.2]), np.diag([3.0, 2.0, 1.0]), np.array([[0.3]])
    free = np.zeros((0, 3)), np.zeros(0), np.zeros((0, 1)), np.zeros(0)
    of = Prediction(A, B, np.eye(1, 3), Q, R, *free, T, P=P)
    program, x = PredictiveControl(of).program.program, draw.normal(size=3)
    slope = PredictiveControl(of)._slope @ x

    def steps(u):
        states = of.states(x, u.reshape(T, 1))[: T + 1]
        running = sum(s @ Q @ s for s in states[:T]) + sum(R[0, 0] * u**2)
        return running + states[T] @ P @ states[T]

    u, other = draw.normal(size=(2, T))
    condensed = lambda u: 0.5 * u @ program.P @ u + slope @ u  # noqa: E731
    assert condensed(u) - condensed(other) == pytest.approx(steps(u) - steps(other))


@pytest.mark.parametrize("h", [0.1, 1.0, 2.0])
def test_the_gain_by_which_an_integrator_goes_on(h):
    p = (1 + np.sqrt(1 + 4 / h**2)) / 2
    one = np.eye(1)
    assert solve_discrete_are(one, h * one, one, one)[0, 0] == pytest.approx(p)
    assert 1 + h * (-h * p / (1 + p * h**2)) == pytest.approx(1 / (1 + p * h**2)), (
        "which is below 1"
    )
