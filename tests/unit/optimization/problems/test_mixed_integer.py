import itertools

import numpy as np
import pytest

from crazychoir.errors import ConfigError, SolverError
from crazychoir.optimization.problems.mixed_integer import MixedIntegerBlock


def small(**changes):
    """min -x0 - 2 x1, x0 in 0..3 integer, x1 in [0, 2]; one resource x0 + x1."""
    given = {
        "c": [-1.0, -2.0],
        "A": [[1.0, 1.0]],
        "share": [2.0],
        "bounds": (0.0, [3.0, 2.0]),
        "integer": [0],
    }
    return MixedIntegerBlock(4, **(given | changes))


def test_a_corner_is_the_best_point_of_the_set():
    assert small().corner(np.array([-1.0, 1.0])) == pytest.approx([3.0, 0.0])
    held = small(rows=([[2.0, 0.0]], [5.0]))
    assert held.corner(np.array([-1.0, 0.0]))[0] == 2.0


@pytest.mark.parametrize(
    ("y", "x", "missing"),
    [
        (2.5, [0.0, 2.0], 0.0),
        (3.5, [1.0, 2.0], 0.0),
        (0.0, [0.0, 0.0], 0.0),
        (-1.0, [0, 0], 1.0),
    ],
)
def test_within_an_allocation_the_least_excess_comes_first_and_then_the_cost(
    y, x, missing
):
    found, excess = small().within(np.array([y]))
    assert found == pytest.approx(x, abs=1e-5)
    assert excess == pytest.approx([missing], abs=1e-5)


@pytest.mark.parametrize("n", [1, 2, 3])
def test_an_agent_with_zero_cost_stays_within_its_allocation_too(n):
    """c = 0, with as many resources as variables, and fewer, and more."""
    block = MixedIntegerBlock(
        0,
        np.zeros(n),
        [np.ones(n), -np.ones(n)],
        [0.0, 0.0],
        bounds=(0, 2),
        integer=[0],
    )
    x, missing = block.within(np.array([2.5, -1.0]))
    assert x.shape == (n,)
    assert 1.0 <= x.sum() <= 2.5
    assert missing == pytest.approx([0.0, 0.0])
    x, missing = block.within(np.array([-1.0, -1.0]))
    assert missing.sum() == pytest.approx(2.0)


def test_within_is_the_best_of_all_points():
    chance = np.random.default_rng(2)
    block = MixedIntegerBlock(
        0,
        -chance.random(3),
        chance.random((2, 3)),
        [1.0, 1.0],
        bounds=(0, 2),
        integer=range(3),
    )
    points = np.array(list(itertools.product(range(3), repeat=3)))
    for y in chance.uniform(0.0, 3.0, (20, 2)):
        fitting = points[(points @ block.A.T <= y).all(axis=1)]
        assert block.c @ block.within(y)[0] == pytest.approx((fitting @ block.c).min())


@pytest.mark.parametrize(
    ("changes", "match"),
    [
        (
            {"c": [1.0, float("nan")]},
            r"agent 4: c\[1\]: found nan; allowed: a finite number",
        ),
        ({"A": [[1.0, float("inf")]]}, r"agent 4: A\[0, 1\]: found inf"),
        ({"A": [[1.0]]}, r"agent 4: A: found shape \(1, 1\); allowed: \(1, 2\)"),
        ({"share": [1.0, 2.0]}, r"agent 4: A: found shape \(1, 2\); allowed: \(2, 2\)"),
        (
            {"bounds": (0.0, [3.0, -2.0])},
            r"agent 4: low\[1\]: found 0.0; allowed: at most high\[1\] = -2.0",
        ),
        (
            {"bounds": ([0.0], 1.0)},
            r"agent 4: low: found shape \(1,\); allowed: \(2,\)",
        ),
        (
            {"bounds": (0.0, float("nan"))},
            r"agent 4: high\[0\]: found nan; allowed: a number, or inf",
        ),
        ({"integer": [2]}, "agent 4: integer: found 2; allowed: indices 0 to 1"),
        (
            {"rows": ([[1.0, 1.0]], [1.0, 2.0])},
            r"agent 4: D: found shape \(1, 2\); allowed: \(2, 2\)",
        ),
    ],
)
def test_arrays_that_do_not_fit_are_refused_with_agent_row_and_value(changes, match):
    with pytest.raises(ConfigError, match=match):
        small(**changes)


def test_a_set_without_a_point_or_without_a_bound_is_named():
    with pytest.raises(
        SolverError, match=r"agent 4: local problem: .* infeasible: 1 rows D x <= d"
    ):
        small(rows=([[1.0, 1.0]], [-1.0])).corner(np.zeros(2))
    with pytest.raises(
        SolverError, match=r"unbounded: x\[1\] without a bound; give low and high"
    ):
        small(bounds=(0.0, [3.0, np.inf])).corner(np.array([0.0, -1.0]))


@pytest.mark.parametrize("unit", [1e-12, 1e-9, 1e-6, 1.0, 1e6, 1e12])
def test_rows_in_any_unit_hold(unit):
    rows = (
        np.array([[2.0, 0.0], [0.0, 1.0]]) * [[unit], [1.0]],
        np.array([7.0 * unit, 2.5]),
    )
    block = MixedIntegerBlock(
        0, [-1.0, -1.0], [[1.0, 1.0]], [1.0], rows=rows, bounds=(0, 10), integer=[0]
    )
    np.testing.assert_allclose(block.corner(block.c), [3.0, 2.5])
    empty = np.array([[unit, 0.0], [-unit, 0.0]]), np.array([unit, -2.0 * unit])
    block = MixedIntegerBlock(
        0, [-1.0, -1.0], [[1.0, 1.0]], [1.0], rows=empty, bounds=(0, 10), integer=[0]
    )
    with pytest.raises(SolverError, match=r"agent 0: local problem.*infeasible"):
        block.corner(block.c)


@pytest.mark.parametrize("unit", [1e-12, 1e-9, 1e-6, 1.0, 1e6, 1e12])
def test_resources_in_any_unit_hold(unit):
    block = MixedIntegerBlock(
        2, [-1.0, -1.0], [[2.0 * unit, unit]], [unit], bounds=(0, 10), integer=[0]
    )
    x, v = block.within(np.array([5.5 * unit]))
    np.testing.assert_allclose(x, [0.0, 5.5])
    np.testing.assert_allclose(v, [0.0], atol=1e-8 * unit)
    x, v = block.within(np.array([-unit]))
    np.testing.assert_allclose(x, [0.0, 0.0], atol=1e-7)
    np.testing.assert_allclose(v, [unit], rtol=1e-7)
