import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from crazychoir.routing.instance.generate import random_instance
from crazychoir.routing.instance.legs import Legs
from crazychoir.routing.instance.vehicle import Vehicle
from crazychoir.routing.pricing.reduced_cost import (
    bound_reduced_cost,
    find_least_reduced_cost,
)
from crazychoir.routing.pricing.route_table import RouteTable
from tests.unit.routing.instance.test_vehicle_routes import KINDS, vehicle_of


@pytest.mark.parametrize("kind", KINDS)
@settings(max_examples=12, deadline=None)
@given(
    st.integers(0, 10**6),
    st.sampled_from([2.0, 8.0, 20.0]),
    st.sampled_from([1, 3, 1000]),
)
def test_the_least_reduced_cost_is_that_of_the_table(kind, seed, worth, width):
    v = vehicle_of(seed, 5, kind)
    prices = np.random.default_rng(seed).uniform(-0.2, 1.0, size=5) * worth
    table = RouteTable(v)
    if not len(table):
        return
    found = find_least_reduced_cost(v, prices, most=10**6, width=width)
    assert found.exact
    assert found.value == pytest.approx(table.least(prices), abs=1e-8)
    for column in found.columns:
        assert table.find(column.tasks).length == pytest.approx(column.length, abs=1e-8)
    if found.value < 0.0:
        best = found.columns[0]
        assert best.length - prices[list(best.tasks)].sum() == pytest.approx(
            found.value, abs=1e-8
        )
    below = max(found.value, 0.0) + 1.0
    for near in (1, 3):
        assert bound_reduced_cost(v, prices, below, near) <= min(
            below, found.value + 1e-8
        )
    assert bound_reduced_cost(v, prices, below, 5) == pytest.approx(
        min(below, table.least(prices)), abs=1e-8
    )


def test_a_search_that_is_cut_says_so():
    v = random_instance(1, 9, seed=3).local(0).vehicle
    prices = np.full(9, 9.0)
    assert find_least_reduced_cost(v, prices).exact
    assert not find_least_reduced_cost(v, prices, most=50, width=5).exact
    assert bound_reduced_cost(v, prices, 0.0, 3, most=50) == -np.inf


def test_a_forbidden_task_is_in_no_column():
    v = random_instance(1, 6, seed=3).local(0).vehicle
    prices = np.array([9.0, 9.0, -np.inf, 9.0, 9.0, 9.0])
    found = find_least_reduced_cost(v, prices)
    assert found.value == pytest.approx(RouteTable(v).least(prices))
    assert all(2 not in column.tasks for column in found.columns)


@pytest.mark.parametrize("limit", [13.0, np.inf])
@pytest.mark.parametrize("price", [2.05, 2.5, 6.0])
def test_a_route_of_the_shortest_ways_alone_is_not_cut(limit, price):
    """Stops in a row, one metre apart, with nothing to spare: bounds of what follows are exact there."""
    x = np.array([1.0, 3, 5, 7, 9, 11, 2, 4, 6, 8, 10, 12, 0, 13])
    distance = np.abs(x[:, None] - x[None, :])
    v = Vehicle(
        Legs.of(distance),
        Legs.of(distance),
        np.zeros(14),
        np.full(14, np.inf),
        np.ones(6),
        1.0,
        limit,
        np.ones(6, bool),
        np.zeros(6, bool),
        fixed=-1.0,
    )
    found = find_least_reduced_cost(v, np.full(6, price), width=1)
    assert found.value == pytest.approx(12.0 - 6 * price)
    assert found.columns[0].tasks == (0, 1, 2, 3, 4, 5)
