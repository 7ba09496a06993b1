import numpy as np
import pytest
from scipy.optimize import linprog, milp

from crazychoir.optimization.problems.linear import LinearProgram

ROWS = np.array([[1.0, 1.0], [3.0, 1.0]]), np.array([4.0, 6.5])
BOUNDS = np.zeros(2), np.full(2, 10.0)


def test_it_finds_what_scipy_finds_for_many_costs():
    program = LinearProgram(np.zeros(2), ROWS, bounds=BOUNDS)
    for c in np.random.default_rng(0).normal(size=(20, 2)):
        x = program.solve(c)
        assert c @ x == pytest.approx(linprog(c, *ROWS, bounds=(0, 10)).fun, abs=1e-9)


def test_integers_are_integers():
    program = LinearProgram(
        np.array([-2.0, -1.0]), ROWS, bounds=BOUNDS, integer=np.array([True, False])
    )
    x = program.solve(np.zeros(2))
    best = milp(
        [-2.0, -1.0],
        integrality=[1, 0],
        bounds=(0, 10),
        constraints=(ROWS[0], -np.inf, ROWS[1]),
    )
    np.testing.assert_allclose(x, best.x, atol=1e-9)
    assert x[0] == 1.0


def test_equalities_hold():
    x = LinearProgram(
        np.array([1.0, 2.0]), ROWS, (np.ones((1, 2)), np.ones(1)), BOUNDS
    ).solve(np.zeros(2))
    np.testing.assert_allclose(x, [1.0, 0.0], atol=1e-12)


@pytest.mark.parametrize(
    ("rows", "c", "word"),
    [
        (ROWS, [-1.0, np.nan], "not finite"),
        (
            (np.array([[1.0, 0.0], [-1.0, 0.0]]), np.array([0.0, -1.0])),
            [0.0, 0.0],
            "infeasible",
        ),
        (
            (np.array([[1.0, 0.0], [-1.0, 0.0]]), np.array([0.0, -1.0])),
            [1.0, 1.0],
            "infeasible",
        ),
        (ROWS, [1.0, 1.0], "unbounded"),
    ],
)
def test_why_there_is_no_solution(rows, c, word):
    assert LinearProgram(np.zeros(2), rows).solve(np.array(c)) == word
    assert (
        LinearProgram(np.zeros(2), rows, integer=np.array([True, True])).solve(
            np.array(c)
        )
        == word
    )


def test_a_search_ends_after_so_many_nodes():
    """A market split problem, which branch and bound hardly prunes."""
    draw = np.random.default_rng(2)
    A = draw.integers(0, 100, (4, 30)).astype(float)
    E = np.hstack([A, np.eye(4), -np.eye(4)])
    n, cost = 38, np.r_[np.zeros(30), np.ones(8)]
    bounds = np.zeros(n), np.r_[np.ones(30), np.full(8, 1e4)]
    integer = np.r_[np.ones(30, bool), np.zeros(8, bool)]
    nothing = np.zeros((0, n)), np.zeros(0)
    program = LinearProgram(
        cost, nothing, (E, np.floor(A.sum(1) / 2)), bounds, integer, most_nodes=3
    )
    assert program.solve(np.zeros(n)) == "too many nodes"
