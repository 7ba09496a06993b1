"""Cuts from subsets of tasks and robots."""

from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from crazychoir.routing.pricing.bidirectional_pricing import HalfRoutes
from crazychoir.routing.pricing.route_table import RouteTable
from crazychoir.routing.pricing.subset_rows import (
    PricedRows,
    SubsetRow,
    find_violated_rows,
)
from tests.unit.routing.instance.test_vehicle_routes import vehicle_of

SOME_ROWS = (
    SubsetRow((0, 1, 2)),
    SubsetRow((1, 3), (0,)),
    SubsetRow((2, 4, 5)),
    SubsetRow((0, 3, 4, 5), (7,)),
    SubsetRow((0, 2, 3), (7,), (1, 1, 1, 2), 3),
    SubsetRow((0, 1, 2, 4, 5), (), (2, 3, 2, 1, 1), 5),
)


@given(st.data())
def test_every_plan_satisfies_every_row(data):
    """A plan gives each task to at most one robot."""
    robot_of = data.draw(st.lists(st.integers(-1, 3), min_size=7, max_size=7))
    size = data.draw(st.integers(2, 5))
    tasks = data.draw(st.permutations(range(7)))[:size]
    robots = data.draw(st.sets(st.integers(0, 3), max_size=3))
    members = size + len(robots)
    weights = data.draw(st.lists(st.integers(1, 3), min_size=members, max_size=members))
    divisor = data.draw(st.integers(2, 5))
    row = SubsetRow(
        tuple(sorted(tasks)), tuple(sorted(robots)), tuple(weights), divisor
    )
    used = sum(
        row.coefficient(i, [j for j in range(7) if robot_of[j] == i]) for i in range(4)
    )
    assert used <= row.limit


@pytest.mark.parametrize("robot", [0, 7])
@settings(max_examples=20, deadline=None)
@given(st.integers(0, 10**6))
def test_halves_price_the_charges_of_rows_like_the_table(robot, seed):
    v = vehicle_of(seed, 6, "limit")
    v = replace(v, robot=robot)
    draw = np.random.default_rng(seed)
    prices = draw.uniform(-0.2, 1.0, size=6) * 8.0
    rows = PricedRows(SOME_ROWS, tuple(draw.uniform(0.0, 3.0, len(SOME_ROWS)).tolist()))
    table, halves = RouteTable(v), HalfRoutes(v)
    cost = {
        column.tasks: column.length
        - prices[list(column.tasks)].sum()
        + rows.charge(v.robot, column.tasks)
        for column in map(table.column, range(len(table)))
    }
    assert halves.least(prices, rows) == pytest.approx(min(cost.values()), abs=1e-9)
    below = min(cost.values()) + 2.0
    near = halves.within(prices, below, 1000, rows=rows)
    assert {c.tasks for c in near} == {t for t, c in cost.items() if c < below and t}
    best = halves.cheapest(prices, 5, 0.0, rows)
    if best:
        assert cost[best[0].tasks] == pytest.approx(min(cost.values()), abs=1e-9)


def test_routes_without_some_tasks_are_those_of_the_table_without_them():
    v = vehicle_of(5, 6, "limit")
    prices = np.full(6, 30.0)
    table, halves = RouteTable(v), HalfRoutes(v).without({1, 4})
    every = map(table.column, range(1, len(table)))
    expected = {c.tasks for c in every if not {1, 4} & set(c.tasks)}
    assert {c.tasks for c in halves.within(prices, np.inf, 1000)} == expected
    assert HalfRoutes(v).without(range(6)).cheapest(prices, 3, 0.0) == []


def test_the_row_that_half_columns_violate_is_found():
    columns = [(0, (0, 1)), (1, (1, 2)), (2, (0, 2)), (3, (3,))]
    found = find_violated_rows(columns, np.array([0.5, 0.5, 0.5, 1.0]), range(4), 9)
    assert found[0] == SubsetRow((0, 1, 2))
    assert (
        find_violated_rows(columns, np.array([1.0, 0.0, 0.0, 1.0]), range(4), 9) == []
    )
    alone = [(5, (0,)), (5, (1,)), (6, (0, 1))]
    half = np.full(3, 0.5)
    assert find_violated_rows(alone, half, [5], 9)[0] == SubsetRow((0, 1), (5,))
    assert find_violated_rows(alone, half, [], 9) == [], "5 has an identical robot"


def test_rows_survive_a_message():
    rows = PricedRows(SOME_ROWS, (0.5, 0.0, 1.25, 3.0, 0.25, 8.0))
    assert PricedRows.unpack(rows.pack()) == rows
    assert rows.value == -(0.5 + 0.0 + 1.25 + 2 * 3.0 + 0.25 + 8.0)


def test_no_selection_of_disjoint_columns_is_cut_off():
    sets = [(0, 1), (1, 2), (0, 2), (2,), (0,), (1,)]
    columns = list(enumerate(sets))
    for chosen in product((0.0, 1.0), repeat=len(sets)):
        tasks = [j for x, served in zip(chosen, sets, strict=True) if x for j in served]
        if len(tasks) == len(set(tasks)):
            assert find_violated_rows(columns, np.array(chosen), range(6), 9) == []
