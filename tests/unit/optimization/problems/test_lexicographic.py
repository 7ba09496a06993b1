import itertools
from fractions import Fraction

import numpy as np
import pytest
from scipy.optimize import linprog

from crazychoir.errors import SolverError
from crazychoir.optimization.problems.lexicographic import (
    ProgramColumns,
    find_optimal_basis,
    unite_columns,
)


def columns_of(c, A):
    return unite_columns(
        [ProgramColumns.artificial(len(A)), ProgramColumns.own(0, c, A)]
    )


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
    chance, start = np.random.default_rng(seed), ProgramColumns.artificial(len(b))
    everything = columns_of(c, A)
    basis = find_optimal_basis(everything, start, b)
    central = linprog(c, A_eq=A, b_eq=b)
    assert central.status == 0
    assert basis.columns.cost[0] @ basis.level == pytest.approx(0.0, abs=1e-9)
    assert basis.columns.cost[1] @ basis.level == pytest.approx(central.fun, abs=1e-9)
    half = np.sort(len(b) + chance.permutation(len(c))[: len(c) // 2])
    elsewhere = find_optimal_basis(
        unite_columns([start, everything.take(half)]), start, b
    ).columns
    again = find_optimal_basis(everything, elsewhere, b)
    assert np.array_equal(again.columns.ids, basis.columns.ids)


def test_equal_columns_of_two_owners_are_told_apart_by_their_ids():
    one = ProgramColumns.own(7, np.array([1.0]), np.array([[1.0]]))
    other = ProgramColumns.own(3, np.array([1.0]), np.array([[1.0]]))
    start = ProgramColumns.artificial(1)
    for parts in ([start, one, other], [start, other, one]):
        basis = find_optimal_basis(unite_columns(parts), start, np.array([2.0]))
        assert basis.columns.ids.tolist() == [
            [7, 0]
        ]  # the delta of the lower id is the greater
        assert basis.level == pytest.approx([2.0])


def test_a_ray_is_found_and_named():
    columns = columns_of(np.array([-1.0, 0.0]), np.array([[1.0, -1.0]]))
    start = ProgramColumns.artificial(1)
    assert find_optimal_basis(columns, start, np.array([1.0])).ray == (0, 1)
    assert find_optimal_basis(columns.free(), start, np.array([1.0])).ray is None


def test_a_union_takes_each_column_once_in_the_order_of_ids():
    some = ProgramColumns.own(2, np.arange(3.0), np.ones((2, 3)))
    all_ = unite_columns([some, ProgramColumns.artificial(2), some.take(np.array([1]))])
    assert all_.ids.tolist() == [[-1, 0], [-1, 1], [2, 0], [2, 1], [2, 2]]
    assert all_.cost.tolist() == [[1, 1, 0, 0, 0], [0, 0, 0, 1, 2]]


def test_a_singular_start_is_refused():
    twice = unite_columns([ProgramColumns.own(0, np.zeros(2), np.ones((2, 2)))])
    with pytest.raises(SolverError, match="singular"):
        find_optimal_basis(twice, twice, np.ones(2))


def exact_optimum(c, A, b):
    """The least c'x over all feasible bases in rational numbers, c >= 0; None if there is no feasible one."""
    m, n = A.shape
    least = None
    for chosen in itertools.combinations(range(n), m):
        rows = [[Fraction(int(A[i, j])) for j in chosen] + [b[i]] for i in range(m)]
        for k in range(m):
            pivot = next((i for i in range(k, m) if rows[i][k]), None)
            if pivot is None:
                break
            rows[k], rows[pivot] = rows[pivot], rows[k]
            rows[k] = [value / rows[k][k] for value in rows[k]]
            for i in range(m):
                if i != k:
                    rows[i] = [
                        value - rows[i][k] * other
                        for value, other in zip(rows[i], rows[k], strict=True)
                    ]
        else:
            x = [row[-1] for row in rows]
            if min(x) >= 0:
                cost = sum(
                    int(c[j]) * value for j, value in zip(chosen, x, strict=True)
                )
                least = cost if least is None else min(least, cost)
    return least


@pytest.mark.parametrize("seed", range(60))
def test_tiny_and_huge_right_hand_sides_of_one_program_count_as_rational_numbers_say(
    seed,
):
    """Each entry of b has its own power of ten, to 10^-6 or 10^6; HiGHS, with absolute tolerances, misses some."""
    chance = np.random.default_rng(seed)
    m, n = int(chance.integers(1, 4)), int(chance.integers(3, 8))
    A = np.hstack(
        [
            chance.integers(-2, 3, (m, n)),
            np.eye(m, dtype=int) * chance.choice([-1, 1], m),
        ]
    )
    c = chance.integers(0, 4, n + m)
    right = [
        Fraction(int(chance.integers(0, 4)))
        * Fraction(10) ** int(chance.integers(-6, 7))
        for _ in range(m)
    ]
    exact = exact_optimum(c, A, right)
    b = np.array([float(value) for value in right])
    basis = find_optimal_basis(
        columns_of(c.astype(float), A.astype(float)), ProgramColumns.artificial(m), b
    )
    artificial = basis.columns.ids[:, 0] < 0
    if exact is None:
        assert (basis.level[artificial] > 1e-9 * basis.terms[artificial]).any()
    else:
        assert (basis.level[artificial] == 0.0).all()
        assert (basis.level >= 0.0).all()
        assert basis.columns.cost[1] @ basis.level == pytest.approx(
            float(exact), rel=1e-12
        )


def test_a_first_cost_comes_before_c():
    dear = ProgramColumns.own(0, np.array([0.0]), np.array([[1.0]]), np.array([1.0]))
    cheap = ProgramColumns.own(1, np.array([5.0]), np.array([[1.0]]))
    basis = find_optimal_basis(
        unite_columns([ProgramColumns.artificial(1), dear, cheap]),
        ProgramColumns.artificial(1),
        np.array([1.0]),
    )
    assert basis.columns.ids.tolist() == [[1, 0]]
