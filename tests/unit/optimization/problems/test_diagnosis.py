"""What an error says of rows that exclude each other."""

import re

import cvxpy as cp
import numpy as np
import pytest

from crazychoir.errors import SolverError
from crazychoir.optimization.problems.problems import (
    CommonCost,
    ConstraintCoupled,
    CostCoupled,
)
from crazychoir.optimization.problems.projection import Convex, Intersection, Strip

V = cp.Variable(2, name="v")
S = cp.Variable(name="s")
FIRST, SECOND = "constraints[0]", "constraints[1]"
CONFLICTS = {
    "two values": ([V[0] == 1, V[0] == 2], [FIRST, SECOND, "violated by 1,"]),
    "zero is one": ([np.array([0.0, 1.0]) == 0 * V], [FIRST, "row 1: violated by 1,"]),
    "zero is below": ([0 * V[0] <= -1], [FIRST, "row 0: violated by 1,"]),
    "one of three": ([V[0] == 1, V[1] == 7, V[0] == 2], [FIRST, "constraints[2]"]),
    "large and small rows": ([1e6 * V[0] == 1e6, 1e-6 * V[0] == 2e-6], [FIRST, SECOND]),
    "tiny values": ([V[0] == 1e-9, V[0] == 2e-9], [FIRST, SECOND, "violated by 1e-09"]),
    "an inequality": (
        [V[0] == 1, V[0] <= 0, V >= -5],
        [FIRST, SECOND, "violated by 1,"],
    ),
    "inequalities": (
        [V[0] <= 1, V[0] >= 2, V[1] <= 1e9],
        [FIRST, SECOND, "violated by 1,"],
    ),
    "tiny inequalities": (
        [V[0] <= 1e-9, V[0] >= 2e-9],
        [FIRST, SECOND, "violated by 1e-09"],
    ),
    "nearly equal ones": (
        [V[0] <= 1, V[0] >= 1 + 1e-8],
        [FIRST, SECOND, "violated by 1e-08"],
    ),
    "small beside large": (
        [V[0] == 1e9, V[1] == 1e-5, V[1] == -1e-5],
        [SECOND, "constraints[2]", "by 2e-05"],
    ),
    "a fixed point": (
        [np.array([1.0, 2.0]) == V, V <= 1.5],
        [f"{FIRST} (v == [1. 2.]), row 1", "row 1: violated by 0.5"],
    ),
}


@pytest.mark.parametrize("name", CONFLICTS)
def test_the_rows_that_exclude_each_other_are_named(name):
    constraints, parts = CONFLICTS[name]
    asked = [
        CostCoupled(0, V, cp.sum_squares(V), constraints).argmin,
        lambda: Convex(V, constraints).project(np.zeros(2)),
        lambda: ConstraintCoupled(
            0, V, cp.sum_squares(V), cp.sum_squares(V), constraints
        ).argmin(np.ones(1)),
        CommonCost(0, V, cp.sum_squares(V), constraints).argmin,
    ]
    for ask in asked:
        with pytest.raises(SolverError, match="infeasible") as error:
            ask()
        for part in parts:
            assert part in str(error.value)


def test_rows_that_have_no_part_in_the_conflict_are_not_named():
    with pytest.raises(SolverError) as error:
        CostCoupled(
            0, V, cp.sum_squares(V), [V[1] == 7, V[0] == 1, V[1] <= 8, V[0] == 2]
        ).argmin()
    assert set(re.findall(r"constraints\[\d\]", str(error.value))) == {
        "constraints[1]",
        "constraints[3]",
    }


@pytest.mark.parametrize(
    "cost",
    [
        cp.sum_squares(V),
        V[0] + cp.sum_squares(V),
        V[0],
        cp.norm(V),
        cp.sum_squares(V) + S,
    ],
)
@pytest.mark.parametrize(
    "rows",
    [[V[0] == 1, V[0] == 2], [0 * V == 1], [0 * V <= -1], [V[0] == 1, V[0] <= 0]],
)
def test_whatever_solves_it_a_conflict_is_infeasible(cost, rows):
    with pytest.raises(
        SolverError, match=r"infeasible: constraints\[\d\] .* row \d: violated by"
    ):
        CostCoupled(0, V, cost, rows).argmin()


def test_more_than_some_rows_are_not_named():
    with pytest.raises(SolverError) as error:
        CostCoupled(
            0,
            (y := cp.Variable(150)),
            cp.sum_squares(y),
            [y[:9] == 1, y[:9] == 2, 0 * y == 1],
        ).argmin()
    assert str(error.value).count("violated by") == 3


def test_parameters_that_change_make_and_end_a_conflict():
    e = cp.Parameter(value=1.0)
    problem = CostCoupled(0, V, cp.sum_squares(V), [V[0] == 1, V[0] == e])
    for value in (1.0, 2.0, 1.0):
        e.value = value
        problem.refresh()
        if value == 1.0:
            np.testing.assert_allclose(problem.argmin(), [1.0, 0.0], atol=1e-12)
        else:
            with pytest.raises(SolverError, match="infeasible: constraints"):
                problem.argmin()


def test_a_sparse_parameter_is_read_without_a_warning():
    E = cp.Parameter((2, 2), sparsity=[(0, 1), (0, 0)])
    E.value_sparse = sparse_of([1.0, 2.0])
    problem = CostCoupled(0, V, cp.sum_squares(V), [np.array([1.0, 2.0]) == E @ V])
    np.testing.assert_allclose(problem.argmin(), [1.0, 0.0], atol=1e-12)
    E.value_sparse = sparse_of([1.0, 3.0])
    problem.refresh()
    with pytest.raises(SolverError, match="infeasible: constraints"):
        problem.argmin()


def sparse_of(values):
    import scipy.sparse

    return scipy.sparse.coo_array(
        (np.array(values), (np.array([0, 1]), np.array([0, 0]))), shape=(2, 2)
    )


def test_measurements_that_exclude_each_other_have_no_point_in_common():
    strips = [Strip([1.0, 0.0], 1.0, 0.0), Strip([1.0, 0.0], 2.0, 0.0)]
    with pytest.raises(SolverError, match=r"infeasible: constraints\[\d\]"):
        Intersection(2, strips).project(np.zeros(2))
