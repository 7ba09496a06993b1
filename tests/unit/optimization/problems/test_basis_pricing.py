import numpy as np
import pytest

from crazychoir.errors import SolverError
from crazychoir.optimization.problems.basis_pricing import BasisPricing
from crazychoir.optimization.problems.lexicographic import (
    OptimalBasis,
    ProgramColumns,
    find_optimal_basis,
    unite_columns,
)


def price(c, entries, b, others, other_costs, sign=None, is_cost_counted=True):
    """Return the pricing of the best basis of columns, for other columns."""
    entries, others = np.array(entries), np.array(others)
    artificial = ProgramColumns.artificial(len(b))
    basis = find_optimal_basis(
        unite_columns([artificial, ProgramColumns.own(0, np.array(c), entries)]),
        OptimalBasis.of(artificial, np.array(b)),
        np.array(b),
    )
    own = ProgramColumns.own(1, np.array(other_costs), others)
    sign = np.ones(len(b)) if sign is None else np.array(sign)
    return BasisPricing(basis, own, sign, is_cost_counted)


def test_a_column_that_lowers_the_cost_of_a_common_basis_shows():
    pricing = price([3.0], [[1.0]], [1.0], [[1.0, 1.0]], [3.0, 1.0])
    assert pricing.excess() == pytest.approx(0.5)


def test_no_column_lowers_a_cost_that_is_not_counted():
    pricing = price([3.0], [[1.0]], [1.0], [[1.0]], [1.0], is_cost_counted=False)
    assert pricing.excess() == 0.0


def test_prices_are_those_of_the_rows_as_they_were_given():
    pricing = price([3.0], [[1.0]], [1.0], [[1.0]], [3.0], sign=[-1.0])
    assert pricing.left_over == 0
    assert pricing.prices().tolist() == [-3.0]


def test_a_penalty_bars_a_column_that_would_use_a_row_left_over():
    """Both rows are the same; a column that differs there must not enter."""
    pricing = price(
        [1.0], [[1.0], [1.0]], [1.0, 1.0], [[1.0, 0.5], [1.0, 1.0]], [1.0, -4.0]
    )
    assert pricing.left_over == 1
    M = pricing.penalties()
    assert M.tolist() == [10.0]
    assert pricing.penalties(M).tolist() == M.tolist()
    y = pricing.prices(M)
    assert (pricing.own.cost[1] - y @ pricing.own.entries).tolist() == [0.0, 0.0]


def test_a_row_that_is_nearly_implied_is_in_doubt():
    small = 1e-7
    pricing = price(
        [1.0], [[1.0], [1.0]], [1.0, 1.0], [[1.0 - small, 0.5], [1.0, 1.0]], [-4.0, 1.0]
    )
    doubts = pricing.doubts()
    assert doubts[0] == pytest.approx(0.5 * small, rel=1e-3)
    with pytest.raises(SolverError, match="row 0 differs from a sum of other rows"):
        pricing.require_distinct(doubts, "agent 1")
    pricing.require_distinct(np.zeros(1), "agent 1")
