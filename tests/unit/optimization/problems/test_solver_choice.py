"""Quadratic programs, against cvxpy: their rows are dependent or redundant, or exclude each other."""

import warnings
from dataclasses import dataclass

import cvxpy as cp
import numpy as np
import pytest

from crazychoir.errors import SolverError
from crazychoir.optimization.problems.problems import CostCoupled
from crazychoir.optimization.problems.projection import Convex
from crazychoir.optimization.problems.quadratic import (
    DOUBTFUL_STATUS,
    INACCURATE_STATUS,
)
from crazychoir.optimization.problems.solver_choice import DecidedProgram

ROUNDING = 1e-12
SAMPLE = 100
WHOLE = 2000


@dataclass
class Model:
    """min 1/2 x'Px + q'x  s.t.  E x = e,  A x <= b;  scales: of the rows of E and A, as a user may write them."""

    P: np.ndarray
    q: np.ndarray
    E: np.ndarray
    e: np.ndarray
    A: np.ndarray
    b: np.ndarray
    scales: tuple[np.ndarray, np.ndarray]

    def constraints(self, x):
        """Return them with the scales."""
        equal, upper = self.scales
        found = [(equal[:, None] * self.E) @ x == equal * self.e] if len(self.e) else []
        return found + (
            [(upper[:, None] * self.A) @ x <= upper * self.b] if len(self.b) else []
        )

    def cost(self, x):
        """Return cvxpy's expression."""
        return 0.5 * cp.quad_form(x, cp.psd_wrap(self.P)) + self.q @ x


def drawn(seed):
    """Return a random model: half of them have inequalities, half small integers, some a conflict."""
    draw = np.random.default_rng(seed)
    n = int(draw.integers(1, 7))
    is_integer = draw.random() < 0.5

    def numbers(*shape):
        return (
            draw.integers(-2, 3, shape).astype(float)
            if is_integer
            else draw.normal(size=shape)
        )

    x = numbers(n)
    E = numbers(int(draw.integers(0, n + 3)), n)
    e = E @ x
    for _ in range(int(draw.integers(0, 4)) if len(e) else 0):
        share = numbers(len(e))
        E, e = np.vstack([E, share @ E]), np.append(e, share @ e)
    if draw.random() < 0.3:
        E, e = np.vstack([E, np.zeros(n)]), np.append(e, 0.0)
    if len(e) and draw.random() < 0.4:
        e[draw.integers(len(e))] += draw.choice([-1, 1]) * 10.0 ** draw.uniform(-2, 2)
    A = numbers(int(draw.integers(0, 9)) if seed % 2 else 0, n)
    b = A @ x + (
        draw.integers(-1, 3, len(A)) if is_integer else draw.normal(size=len(A)) + 0.7
    )
    for r in range(len(A)):
        kind = draw.random()
        if kind < 0.3 and len(e):
            share = numbers(len(e))
            A[r], b[r] = share @ E, share @ e + draw.choice([-1.0, 0.5, 1.0, 3.0])
        elif kind < 0.5 and r:
            sign = draw.choice([-1.0, 1.0])
            A[r], b[r] = (
                sign * A[r - 1],
                sign * b[r - 1] + draw.choice([-1.0, 0.0, 0.0, 2.0]),
            )
    if draw.random() < 0.5:
        E = E * (1.0 + ROUNDING * draw.normal(size=E.shape))
        e = e * (1.0 + ROUNDING * draw.normal(size=e.shape))
    scales = tuple(
        10.0 ** draw.integers(-6, 7, len(rows)) * (draw.random() < 0.5)
        for rows in (e, b)
    )
    root = draw.normal(size=(n, n))
    P = root @ root.T + 0.1 * np.eye(n) if draw.random() < 0.5 else np.eye(n)
    return Model(
        P,
        draw.normal(size=n),
        E,
        e,
        A,
        b,
        tuple(np.where(s > 0.0, s, 1.0) for s in scales),
    )


def reference(model):
    """Return cvxpy's x, or "infeasible": of rows that are not scaled, and by HiGHS where Clarabel is not sure."""
    x = cp.Variable(len(model.q))
    ones = Model(
        model.P,
        model.q,
        model.E,
        model.e,
        model.A,
        model.b,
        (np.ones(len(model.e)), np.ones(len(model.b))),
    )
    problem = cp.Problem(cp.Minimize(ones.cost(x)), ones.constraints(x))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            problem.solve(solver=cp.CLARABEL)
        except cp.SolverError:
            problem = cp.Problem(cp.Minimize(0), ones.constraints(x))
            problem.solve(solver=cp.HIGHS)
    return (
        x.value
        if problem.status == cp.OPTIMAL
        else problem.status.removesuffix("_inaccurate")
    )


def require_same(seed):
    """Assert that argmin and, for a cost without a metric, the projection say what cvxpy says."""
    model = drawn(seed)
    expected = reference(model)
    x = cp.Variable(len(model.q), name="x")
    problem = CostCoupled(0, x, model.cost(x), model.constraints(x))
    assert problem.is_fast(), seed
    answers = [problem.argmin]
    if (np.eye(len(model.q)) == model.P).all():
        answers.append(lambda: Convex(x, model.constraints(x)).project(-model.q))
    for answer in answers:
        if isinstance(expected, str):
            assert expected == "infeasible", seed
            with pytest.raises(
                SolverError,
                match=r"(?s)status infeasible: constraints\[\d\] .*, row \d+: violated by",
            ):
                answer()
        else:
            allowed = 1e-4 * (1.0 + np.abs(expected).max())
            np.testing.assert_allclose(
                answer(), expected, atol=allowed, err_msg=f"{seed}"
            )
    return isinstance(expected, str)


def test_a_quadratic_program_is_infeasible_where_cvxpy_says_so():
    infeasible = sum(require_same(seed) for seed in range(SAMPLE))
    assert 0.2 * SAMPLE < infeasible < 0.8 * SAMPLE


@pytest.mark.slow
@pytest.mark.timeout(1200)
def test_two_thousand_quadratic_programs_are_infeasible_where_cvxpy_says_so():
    infeasible = sum(require_same(seed) for seed in range(WHOLE))
    assert 0.2 * WHOLE < infeasible < 0.8 * WHOLE


class Word:
    """A program that always says the same."""

    name = "fast"

    def __init__(self, said):
        self.said = said

    def solve(self, p):
        return self.said


@pytest.mark.parametrize(
    ("fast", "thorough", "said"),
    [
        ("infeasible", "never asked", "infeasible"),
        ("not finite", "never asked", "not finite"),
        ("too many steps", "found", "found"),
        (INACCURATE_STATUS, "infeasible", "infeasible"),
        (DOUBTFUL_STATUS, np.zeros(1), np.zeros(1)),
        (DOUBTFUL_STATUS, "infeasible", DOUBTFUL_STATUS),
    ],
)
def test_what_rounding_hides_is_asked_of_the_thorough_program(fast, thorough, said):
    assert DecidedProgram(Word(fast), lambda: Word(thorough)).solve(np.zeros(1)) == said


def test_the_thorough_program_is_made_when_it_is_first_needed():
    def make():
        raise AssertionError("made")

    assert DecidedProgram(Word("infeasible"), make).solve(np.zeros(1)) == "infeasible"


@pytest.mark.parametrize("k", range(3, 8))
@pytest.mark.parametrize("kind", ["equalities", "inequalities", "both"])
def test_rows_that_are_nearly_dependent_are_met_far_away(kind, k):
    """x_0 + x_1 = 1 and x_0 + (1 + d) x_1 = 2 meet at x_1 = 1/d."""
    v, d = cp.Variable(2), 10.0**-k
    first, second = v[0] + v[1], v[0] + (1.0 + d) * v[1]
    rows = {
        "equalities": [first == 1, second == 2],
        "inequalities": [first <= 1, second >= 2],
        "both": [first == 1, second >= 2],
    }[kind]
    x = CostCoupled(0, v, cp.sum_squares(v), rows).argmin()
    assert x[1] * d == pytest.approx(1.0, rel=1e-3)
    assert x[0] + x[1] <= 1.0 + 1e-4
    assert x[0] + (1.0 + d) * x[1] >= 2.0 - 1e-4


@pytest.mark.parametrize("d", [1e-10, 1e-11, 1e-12, 1e-13])
def test_where_rounding_decides_the_error_says_so(d):
    v = cp.Variable(2)
    problem = CostCoupled(
        0, v, cp.sum_squares(v), [v[0] + v[1] == 1, v[0] + (1.0 + d) * v[1] == 2]
    )
    with pytest.raises(
        SolverError, match=r"infeasible: constraints\[.*rounding decides"
    ):
        problem.argmin()
