from contextlib import suppress

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from crazychoir.errors import SolverError
from crazychoir.routing.generate import random_instance
from crazychoir.routing.least import columns_below, least_reduced_cost, relaxed_reduced_cost, route_of
from crazychoir.routing.pricing import RouteTable, shortest_route
from tests.unit.routing.test_vehicle_routes import KINDS, flown, vehicle_of


@pytest.mark.parametrize("kind", KINDS)
@settings(max_examples=12, deadline=None)
@given(st.integers(0, 10**6), st.sampled_from([2.0, 8.0, 20.0]), st.sampled_from([1, 3, 1000]))
def test_the_least_reduced_cost_is_that_of_the_table(kind, seed, worth, width):
    v = vehicle_of(seed, 5, kind)
    prices = np.random.default_rng(seed).uniform(-0.2, 1.0, size=5) * worth
    table = RouteTable(v)
    if not len(table):
        return
    found = least_reduced_cost(v, prices, most=10**6, width=width)
    assert found.exact
    assert found.value == pytest.approx(table.least(prices), abs=1e-8)
    for column in found.columns:
        assert table.find(column.tasks).length == pytest.approx(column.length, abs=1e-8)
    if found.value < 0.0:
        best = found.columns[0]
        assert best.length - prices[list(best.tasks)].sum() == pytest.approx(found.value, abs=1e-8)
    below = max(found.value, 0.0) + 1.0
    for near in (1, 3):
        assert relaxed_reduced_cost(v, prices, below, near) <= min(below, found.value + 1e-8)
    assert relaxed_reduced_cost(v, prices, below, 5) == pytest.approx(min(below, table.least(prices)), abs=1e-8)


@pytest.mark.parametrize("kind", KINDS)
@settings(max_examples=12, deadline=None)
@given(st.integers(0, 10**6), st.sampled_from([2.0, 8.0]), st.sampled_from([0.0, 3.0, 12.0]))
def test_the_columns_below_are_those_of_the_table(kind, seed, worth, below):
    v = vehicle_of(seed, 4, kind)
    prices = np.random.default_rng(seed).uniform(-0.2, 1.0, size=4) * worth
    table = RouteTable(v)
    found = columns_below(v, prices, below)
    expected = [c for c in table.cheapest(prices, len(table), below) if c.tasks]
    assert found.exact
    assert [c.tasks for c in found.columns] == [c.tasks for c in sorted(expected)]
    assert [c.length for c in found.columns] == pytest.approx([c.length for c in sorted(expected)], abs=1e-8)


def test_a_search_that_is_cut_says_so():
    v = random_instance(1, 9, seed=3).local(0).vehicle
    prices = np.full(9, 9.0)
    assert least_reduced_cost(v, prices).exact
    assert not least_reduced_cost(v, prices, most=50, width=5).exact
    assert not columns_below(v, prices, 0.0, most=50).exact
    assert relaxed_reduced_cost(v, prices, 0.0, 3, most=50) == -np.inf


def test_a_forbidden_task_is_in_no_column():
    v = random_instance(1, 6, seed=3).local(0).vehicle
    prices = np.array([9.0, 9.0, -np.inf, 9.0, 9.0, 9.0])
    found = least_reduced_cost(v, prices)
    assert found.value == pytest.approx(RouteTable(v).least(prices))
    assert all(2 not in column.tasks for column in found.columns)


@pytest.mark.parametrize("kind", ["plain", "limit", "open limit", "windows", "aboard limit", "trips limit"])
@pytest.mark.parametrize("seed", [1, 2])
def test_a_good_route_of_a_set_is_feasible_and_no_better_than_the_best(kind, seed):
    v = vehicle_of(seed, 4, kind)
    table, good = RouteTable(v), []
    for c in range(int(not v.aboard.any()), len(table)):
        tasks = table.column(c).tasks
        assert route_of(v, tasks).exact
        with suppress(SolverError):  # where limits are tight it may find none
            good.append(route_of(v, tasks, most=1))
            assert not good[-1].exact
            assert good[-1].length == pytest.approx(flown(v, good[-1].nodes)[0])
            assert good[-1].length >= route_of(v, tasks).length - 1e-8
    assert 2 * len(good) >= len(table) - 1


def test_routes_of_many_tasks_are_good_and_flagged():
    v = random_instance(1, 12, seed=5).local(0).vehicle
    exact = shortest_route(v, range(12))[1]
    good = route_of(v, range(12), most=1000)
    assert not good.exact
    assert exact - 1e-9 <= good.length <= 1.03 * exact
    assert route_of(v, range(12)) == (*shortest_route(v, range(12)), True)
    more = random_instance(1, 40, seed=4).local(0).vehicle
    long = route_of(more, range(40))
    assert not long.exact
    assert long.length == pytest.approx(flown(more, long.nodes)[0])
