import numpy as np
import pytest
from scipy.optimize import linprog

from crazychoir.errors import SolverError
from crazychoir.optimization.lexicographic import Columns, optimal_basis, union


def columns_of(c, A):
    return union([Columns.artificial(len(A)), Columns.own(0, c, A)])


def draw(seed):
    """A program, degenerate every second time: few different integers, many zeros."""
    chance = np.random.default_rng(seed)
    m, n = chance.integers(1, 6), chance.integers(2, 14)
    if seed % 2:
        A = chance.integers(-1, 2, (m, n)).astype(float)
        b, c = A @ chance.integers(0, 2, n), chance.integers(0, 3, n).astype(float)
    else:
        A = chance.normal(size=(m, n))
        b, c = A @ (chance.random(n) * (chance.random(n) < 0.5)), chance.random(n)
    sign = np.where(b < 0, -1.0, 1.0)
    return c, A * sign[:, None], b * sign


@pytest.mark.parametrize("seed", range(40))
def test_the_basis_is_optimal_and_the_same_from_any_start(seed):
    c, A, b = draw(seed)
    chance, start = np.random.default_rng(seed), Columns.artificial(len(b))
    everything = columns_of(c, A)
    basis = optimal_basis(everything, start, b)
    central = linprog(c, A_eq=A, b_eq=b)
    assert central.status == 0
    assert basis.columns.cost[0] @ basis.level == pytest.approx(0.0, abs=1e-9)
    assert basis.columns.cost[1] @ basis.level == pytest.approx(central.fun, abs=1e-9)
    half = np.sort(len(b) + chance.permutation(len(c))[: len(c) // 2])
    elsewhere = optimal_basis(union([start, everything.take(half)]), start, b).columns
    again = optimal_basis(everything, elsewhere, b)
    assert np.array_equal(again.columns.ids, basis.columns.ids)


def test_equal_columns_of_two_owners_are_told_apart_by_their_ids():
    one = Columns.own(7, np.array([1.0]), np.array([[1.0]]))
    other = Columns.own(3, np.array([1.0]), np.array([[1.0]]))
    start = Columns.artificial(1)
    for parts in ([start, one, other], [start, other, one]):
        basis = optimal_basis(union(parts), start, np.array([2.0]))
        assert basis.columns.ids.tolist() == [[7, 0]]  # the delta of the lower id is the greater
        assert basis.level == pytest.approx([2.0])


def test_a_ray_is_found_and_named():
    columns = columns_of(np.array([-1.0, 0.0]), np.array([[1.0, -1.0]]))
    start = Columns.artificial(1)
    assert optimal_basis(columns, start, np.array([1.0])).ray == (0, 1)
    assert optimal_basis(columns.free(), start, np.array([1.0])).ray is None


def test_a_union_takes_each_column_once_in_the_order_of_ids():
    some = Columns.own(2, np.arange(3.0), np.ones((2, 3)))
    all_ = union([some, Columns.artificial(2), some.take(np.array([1]))])
    assert all_.ids.tolist() == [[-1, 0], [-1, 1], [2, 0], [2, 1], [2, 2]]
    assert all_.cost.tolist() == [[1, 1, 0, 0, 0], [0, 0, 0, 1, 2]]


def test_a_singular_start_is_refused():
    twice = union([Columns.own(0, np.zeros(2), np.ones((2, 2)))])
    with pytest.raises(SolverError, match="singular"):
        optimal_basis(twice, twice, np.ones(2))
