import threading

import cvxpy
import highspy
import numpy as np
import pytest
from scipy.optimize import linprog, milp

from crazychoir.optimization.problems.linear import LinearProgram

ROWS = np.array([[1.0, 1.0], [3.0, 1.0]]), np.array([4.0, 6.5])
BOUNDS = np.zeros(2), np.full(2, 10.0)
OURS = -1
"""A solve of this package, among numbers of threads of other users of HiGHS."""


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


def _solve_beside_other_solvers(steps, results):
    program = LinearProgram(np.array([-1.0, -1.0]), ROWS, bounds=BOUNDS)
    for threads in steps:
        if threads == OURS:
            x = program.solve(np.zeros(2))
            results.append(float(np.sum(x)))
        else:
            # a whole number of at most 2.5, as cvxpy asks for it: with threads of its own
            other = highspy.Highs()
            other.setOptionValue("output_flag", False)
            other.setOptionValue("threads", threads)
            other.addCol(-1.0, 0.0, 2.5, 0, np.array([], np.int32), np.array([]))
            other.changeColIntegrality(0, highspy.HighsVarType.kInteger)
            other.solve()
            results.append(other.getSolution().col_value[0])


@pytest.mark.parametrize(
    "steps",
    [(0, OURS), (OURS, 0), (OURS, 4), (3, OURS, 3, OURS)],
    ids=["theirs first", "ours first", "ours, then four threads", "in turns"],
)
def test_order_of_use_of_highs_does_not_matter(steps):
    """HiGHS refuses a solve with another number of threads than the first solve of a thread."""
    expected = [4.0 if threads == OURS else 2.0 for threads in steps]
    in_threads = [[] for _ in range(4)]
    threads = [
        threading.Thread(target=_solve_beside_other_solvers, args=(steps * 5, results))
        for results in in_threads
    ]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()

    for results in in_threads:
        assert results == pytest.approx(expected * 5)


def test_cvxpy_and_a_linear_program_of_ours_solve_in_turns():
    whole = cvxpy.Variable(integer=True)
    theirs = cvxpy.Problem(cvxpy.Maximize(whole), [whole <= 2.5])
    ours = LinearProgram(np.array([-1.0, -1.0]), ROWS, bounds=BOUNDS)
    for _ in range(2):
        assert theirs.solve(solver=cvxpy.HIGHS) == pytest.approx(2.0)
        assert np.sum(ours.solve(np.zeros(2))) == pytest.approx(4.0)
