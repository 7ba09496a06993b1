"""Moves of whole routes: a plan at the wrong robots is left, whatever robot it is."""

import numpy as np
import pytest

from crazychoir.routing.instance.generate import InstanceShape, random_instance
from crazychoir.routing.search.fleet import build_fleet
from crazychoir.routing.search.recreate import InsertionMemory, restore_routes
from crazychoir.routing.search.ruin import SearchStep, begin_step
from crazychoir.routing.search.search import search_plan
from crazychoir.routing.search.tail_exchange import exchange_tails
from crazychoir.routing.search.tours import Tours, is_route_feasible, refresh_route

TASKS = 12


def one_robot_serves_all(holder):
    """Vehicles, one with much capacity, and a plan in which `holder` serves all tasks."""
    shape = InstanceShape(capacities=(3, 3))
    instance = random_instance(3, TASKS, 4, shape)
    team = [instance.local(i).vehicle for i in range(3)]
    object.__setattr__(team[1], "capacity", 9.0)
    routes = [[], [], []]
    routes[holder] = [v for j in range(TASKS) for v in (j, TASKS + j)]
    return team, instance.tasks.penalty, routes


@pytest.mark.parametrize("holder", range(3))
def test_the_robot_that_serves_all_tasks_at_first_does_not_matter(holder):
    team, penalty, routes = one_robot_serves_all(holder)
    best = search_plan(team, [[]] * 3, penalty, 20_000, 3).total
    found = search_plan(team, routes, penalty, 6_000, 1)
    assert found.total <= 1.02 * best
    assert len(found.routes[1]) == 2 * TASKS


def exchanged(seed):
    """Tours before and after an exchange, its record, and the vehicles as arrays."""
    team, penalty, routes = one_robot_serves_all(0)
    routes[2] = routes[0][8:]
    routes[0] = routes[0][:8]
    fleet = build_fleet(team, penalty)
    before, tours = Tours.of(fleet, routes), Tours.of(fleet, routes)
    for k in range(3):
        refresh_route(fleet, before, k)
        refresh_route(fleet, tours, k)
    step = SearchStep.of(tours)
    memory = InsertionMemory.of(tours, np.zeros(3, np.bool_))
    begin_step(step)
    exchange_tails(fleet, tours, step, memory, np.array([seed], np.uint64))
    return fleet, before, tours, step


@pytest.mark.parametrize("seed", range(8))
def test_routes_with_exchanged_tails_are_feasible_and_can_be_restored(seed):
    fleet, before, tours, step = exchanged(seed)
    for k in range(3):
        stops = tours.stop[k, 1 : tours.stops[k] + 1]
        served = np.flatnonzero(tours.at == k)
        assert sorted(stops) == sorted([*served, *(TASKS + served)])
        assert is_route_feasible(fleet, tours, k)
    restore_routes(fleet, tours, step)
    np.testing.assert_array_equal(tours.stops, before.stops)
    np.testing.assert_array_equal(tours.at, before.at)
    np.testing.assert_allclose(tours.length, before.length)


def test_exchanges_hand_over_split_and_swap_routes():
    ends = {tuple(exchanged(seed)[2].stops.tolist()) for seed in range(200)}
    assert (0, 8, 16) in ends, "hand-over to the idle robot"
    assert (16, 0, 8) in ends, "exchange of whole routes"
    assert (24, 0, 0) in ends, "merge"
    assert any(min(stops) > 0 for stops in ends), "split"
