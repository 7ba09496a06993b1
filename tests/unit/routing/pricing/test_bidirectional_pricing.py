"""Routes put together of halves against the table of all."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from crazychoir.errors import InstanceError
from crazychoir.routing.instance.generate import InstanceShape, random_instance
from crazychoir.routing.pricing.bidirectional_pricing import HalfRoutes
from crazychoir.routing.pricing.reduced_cost import find_least_reduced_cost
from crazychoir.routing.pricing.route_table import RouteTable
from tests.unit.routing.instance.test_vehicle_routes import vehicle_of


@pytest.mark.parametrize("kind", ["limit", "open limit", "matrix limit"])
@settings(max_examples=30, deadline=None)
@given(
    st.integers(0, 10**6),
    st.sampled_from([1.0, 4.0, 8.0, 20.0]),
    st.sampled_from([0.6, 1.0, 1.6]),
)
def test_the_least_of_all_routes_is_found(kind, seed, worth, far):
    v = vehicle_of(seed, 6, kind)
    v = replace(v, limit=far * v.limit)
    prices = np.random.default_rng(seed).uniform(-0.2, 1.0, size=6) * worth
    table, halves = RouteTable(v), HalfRoutes(v)
    assert HalfRoutes.fits(v)
    assert halves.complete
    assert halves.least(prices) == pytest.approx(table.least(prices), abs=1e-9)
    found = halves.cheapest(prices, 4, 0.0)
    assert len(found) == len({column.tasks for column in found}) <= 4
    for column in found:
        assert column.length >= table.find(column.tasks).length - 1e-9
        assert column.length - prices[list(column.tasks)].sum() < 0.0
    if found:
        assert found[0].length == pytest.approx(
            table.find(found[0].tasks).length, abs=1e-9
        )
        assert found[0].length - prices[list(found[0].tasks)].sum() == pytest.approx(
            table.least(prices), abs=1e-9
        )
        assert halves.cheapest(prices, 4, table.least(prices) - 1e-6) == []


@pytest.mark.parametrize("kind", ["limit", "open limit", "matrix limit"])
@settings(max_examples=15, deadline=None)
@given(
    st.integers(0, 10**6),
    st.sampled_from([0.0, 5.0, 30.0]),
    st.sampled_from([0.6, 1.6]),
)
def test_halves_list_the_same_routes_near_the_best_as_the_table(kind, seed, gap, far):
    v = vehicle_of(seed, 6, kind)
    v = replace(v, limit=far * v.limit)
    prices = np.random.default_rng(seed).uniform(-0.2, 1.0, size=6) * 8.0
    table, halves = RouteTable(v), HalfRoutes(v)
    below = table.least(prices, 0.5) + gap
    expected = {c.tasks: c.length for c in table.within(prices, below, reward=0.5)}
    most = len(expected)
    found = halves.within(prices, below, max(1, 40 * most), reward=0.5)
    assert {c.tasks: c.length for c in found} == pytest.approx(expected, abs=1e-9)
    assert () not in expected
    if most:
        assert halves.within(prices, below, most - 1, reward=0.5) is None
        assert table.within(prices, below, most - 1, reward=0.5) is None
    if gap == 30.0 and table.size == most:
        assert len(table) == most + 1


def test_the_length_of_a_column_is_that_of_its_halves_at_any_prices():
    vehicle = (
        random_instance(4, 10, 3, InstanceShape(route_length_limit=25.0))
        .local(0)
        .vehicle
    )
    halves, random, lengths = HalfRoutes(vehicle), np.random.default_rng(0), {}
    for _ in range(200):
        for column in halves.cheapest(random.uniform(0.0, 20.0, 10), 10, 0.0):
            lengths.setdefault(column.tasks, set()).add(column.length)
    assert len(lengths) > 20
    assert max(len(values) for values in lengths.values()) <= 4, (
        "one a pair of halves, whatever the prices"
    )


def test_halves_that_are_cut_say_so():
    v = vehicle_of(3, 6, "limit")
    assert not HalfRoutes(v, most=5).complete


@pytest.mark.parametrize(
    "kind", ["plain", "windows limit", "aboard limit", "trips limit"]
)
def test_what_cannot_be_halved(kind):
    some = [vehicle_of(seed, 4, kind) for seed in range(6)]
    assert not any(
        HalfRoutes.fits(v) for v in some if v.aboard.any() or "aboard" not in kind
    )


def test_nothing_to_serve():
    v = replace(vehicle_of(1, 4, "limit"), capable=np.zeros(4, bool))
    assert HalfRoutes(v).least(np.full(4, 9.0)) == 0.0
    assert HalfRoutes(v).cheapest(np.full(4, 9.0), 3, 0.0) == []


def test_more_tasks_than_a_set_holds_are_refused_by_name():
    v = (
        random_instance(
            2, 130, 0, InstanceShape(room=(0.7, 0.7), route_length_limit=60.0)
        )
        .local(0)
        .vehicle
    )
    for price in (HalfRoutes, lambda v: find_least_reduced_cost(v, np.ones(130))):
        with pytest.raises(InstanceError, match="at most 128"):
            price(v)
