import numpy as np
import pytest

from crazychoir.optimization.problems.tableau import (
    NO_ENTERING_COLUMN,
    PIVOTS_USED_UP,
    drop_negligible,
    pivot_to_optimum,
    solve_identity,
)


def tableau_of(c, A, b):
    """min c'x s.t. A x + z = b, with z, the identity, as the first columns, and no artificial ones."""
    m, n = A.shape
    tableau = np.zeros((m + 2, m + n + m + 1))
    tableau[:m] = np.hstack([np.eye(m), A, np.eye(m), b[:, None]])
    tableau[m + 1, m : m + n] = c
    return tableau, np.arange(m)


@pytest.mark.parametrize("unit", [1.0, 1e-9, 1e9])
def test_it_walks_to_the_optimum_in_any_unit_of_a_row(unit):
    tableau, basic = tableau_of(
        np.array([-1.0, -1.0]),
        np.array([[unit, 0.0], [1.0, 1.0]]),
        np.array([unit, 3.0]),
    )
    pivots, end = pivot_to_optimum(tableau, basic, 0, 50)
    assert (pivots, end) == (2, NO_ENTERING_COLUMN)
    assert sorted(basic.tolist()) == [2, 3]
    assert sorted(tableau[:2, -1].tolist()) == [1.0, 2.0]


def test_it_ends_at_a_ray_and_after_the_most_pivots():
    tableau, basic = tableau_of(np.array([-1.0]), np.array([[-1.0]]), np.array([1.0]))
    assert pivot_to_optimum(tableau, basic, 0, 50) == (0, 1)
    tableau, basic = tableau_of(np.array([-1.0]), np.array([[1.0]]), np.array([1.0]))
    assert pivot_to_optimum(tableau, basic, 0, 1) == (1, PIVOTS_USED_UP)


def test_artificial_columns_leave_first_whatever_it_costs():
    tableau, basic = tableau_of(np.array([7.0]), np.array([[1e-6]]), np.array([1e-6]))
    assert pivot_to_optimum(tableau, basic, 1, 50) == (1, NO_ENTERING_COLUMN)
    assert basic.tolist() == [1]
    assert tableau[0, -1] == 1.0


def test_what_cancels_becomes_an_exact_zero():
    work = np.array([[0.1, 0.3, 1.0, 0.0], [0.7, 0.7 * 3.0, 0.0, 1.0]])
    assert not solve_identity(work)
    work = np.array([[0.0, 2.0, 1.0, 0.0], [4.0, 0.0, 0.0, 1.0]])
    assert solve_identity(work)
    assert work.tolist() == [[1.0, 0.0, 0.0, 0.25], [0.0, 1.0, 0.5, 0.0]]


def test_an_entry_that_no_sum_needs_is_dropped_in_any_units():
    factor = np.array([[1.0, 1.0], [0.0, 1e-6]])
    value = np.array([[1e-10, 1.0], [1.0, 1e-10]])
    size = np.abs(factor) @ np.abs(value)
    drop_negligible(value, factor, size, 1e-9)
    # The second row has no other term than its own: there 1e-10 matters.
    assert value.tolist() == [[0.0, 1.0], [1.0, 1e-10]]
