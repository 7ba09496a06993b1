"""Insertion and auction: cheapest places in a route, and a team that shares tasks out by bids."""

from dataclasses import replace
from itertools import permutations

import numpy as np
import pytest

from crazychoir.optimization.rounds.program import Program
from crazychoir.routing.instance.generate import InstanceShape, random_instance
from crazychoir.routing.search.parallel_auction import Insertion, run_parallel_auction
from crazychoir.team.graph import graph_from_name


def vehicle(tasks=4, seed=0, **changes):
    instance = random_instance(
        1, tasks, seed, InstanceShape(loads=(1, 2), capacities=(3, 3))
    )
    return replace(instance.local(0).vehicle, **changes)


def feasible(vehicle, route):
    m, done = vehicle.tasks, dict.fromkeys(np.flatnonzero(vehicle.aboard).tolist())
    now = sum(vehicle.load[j] for j in done)
    for v in route:
        if v < m:
            now, done[v] = now + vehicle.load[v], None
        elif v - m not in done:
            return False
        else:
            now -= vehicle.load[v - m]
        if now > vehicle.capacity + 1e-9:
            return False
    return vehicle.length(route) <= vehicle.limit + 1e-9


@pytest.mark.parametrize("seed", range(10))
def test_the_cheapest_insertion_is_the_best_of_all_that_keep_the_rest_in_order(seed):
    v = vehicle(4, seed)
    insertion, m = Insertion(v), v.tasks
    route = ()
    for j in range(3):
        found = insertion.cheapest(route, j)
        both = [
            r
            for r in permutations((*route, j, m + j))
            if [n for n in r if n % m != j] == list(route)
        ]
        lengths = [v.length(r) - v.length(route) for r in both if feasible(v, r)]
        assert (found is None) == (not lengths)
        if found:
            extra, route = found
            assert extra == pytest.approx(min(lengths))
            assert feasible(v, route)


def test_a_full_robot_takes_nothing_in_between():
    v = vehicle(2, 0, capacity=1.0, load=np.ones(2))
    _, one = Insertion(v).cheapest((), 0)
    _, two = Insertion(v).cheapest(one, 1)
    assert two in ((0, 2, 1, 3), (1, 3, 0, 2))
    assert Insertion(replace(v, load=np.array([1.0, 2.0]))).cheapest(one, 1) is None


def test_a_vehicle_that_is_incapable_or_beyond_its_limit_takes_no_task():
    v = vehicle(2)
    extra, _ = Insertion(v).cheapest((), 0)
    assert (
        Insertion(replace(v, capable=np.array([False, True]))).cheapest((), 0) is None
    )
    assert Insertion(replace(v, limit=extra)).cheapest((), 0) is not None
    assert Insertion(replace(v, limit=extra - 1e-6)).cheapest((), 0) is None


def test_what_is_aboard_is_delivered_and_counts_from_the_start():
    v = vehicle(
        3,
        1,
        aboard=np.array([True, False, True]),
        load=np.ones(3),
        capacity=2.0,
        limit=0.1,
    )
    insertion = Insertion(v)
    first = insertion.first()
    assert sorted(first) == [3, 5], "whatever the limit: it cannot be left"
    assert insertion.loads(first) == [2.0, 1.0, 0.0]
    free = replace(v, limit=np.inf)
    _, route = Insertion(free).cheapest(first, 1)
    assert route.index(1) > 0, "there is no room before something is delivered"


@pytest.mark.parametrize("seed", range(5))
def test_improvement_never_costs_and_keeps_all_tasks(seed):
    v = vehicle(6, seed)
    insertion, route = Insertion(v), ()
    for j in range(6):
        route = insertion.cheapest(route, j)[1]
    better = insertion.improved(route)
    assert sorted(better) == sorted(route)
    assert feasible(v, better)
    assert v.length(better) <= v.length(route)


class Auction(Program):
    def __init__(self, i, vehicle, free, diameter):
        self.arguments = i, vehicle, free, diameter
        super().__init__()

    def run(self):
        return (yield from run_parallel_auction(*self.arguments))


def sold(vehicles, free, graph):
    agents = {
        i: Auction(i, v, free, graph.diameter() if len(vehicles) > 1 else 0)
        for i, v in vehicles.items()
    }
    while not all(agent.done for agent in agents.values()):
        assert not any(agent.done for agent in agents.values()), "all end in one round"
        messages = {i: agent.message() for i, agent in agents.items()}
        for i, agent in agents.items():
            agent.step({j: messages[j] for j in graph.neighbors(i)})
    return {i: agent.result for i, agent in agents.items()}


@pytest.mark.parametrize("shape", ["ring", "path", "complete"])
@pytest.mark.parametrize("seed", range(5))
def test_every_task_is_sold_once_to_a_capable_robot(seed, shape):
    instance = random_instance(
        5, 12, seed, InstanceShape(capable=0.6, route_length_limit=60.0)
    )
    vehicles = {i: instance.local(i).vehicle for i in range(5)}
    results = sold(vehicles, list(range(12)), graph_from_name(shape, 5))
    taken = sorted(v for route, _ in results.values() for v in route)
    assert taken == list(range(24))
    assert all(left == () for _, left in results.values())
    for i, (route, _) in results.items():
        assert feasible(vehicles[i], route)
        assert all(vehicles[i].capable[v] for v in route if v < 12)


def test_the_auction_does_not_depend_on_the_graph():
    instance = random_instance(5, 12, 3, InstanceShape(capable=0.6))
    vehicles = {i: instance.local(i).vehicle for i in range(5)}
    assert sold(vehicles, list(range(12)), graph_from_name("ring", 5)) == sold(
        vehicles, list(range(12)), graph_from_name("complete", 5)
    )


def test_a_task_that_no_robot_can_serve_is_left_and_named_by_all():
    instance = random_instance(3, 4, 1)
    vehicles = {
        i: replace(
            instance.local(i).vehicle, capable=np.array([True, False, True, True])
        )
        for i in range(3)
    }
    results = sold(vehicles, [0, 1, 2], graph_from_name("ring", 3))
    assert {left for _, left in results.values()} == {(1,)}
    assert sorted(v for route, _ in results.values() for v in route) == [0, 2, 4, 6], (
        "3 was not for sale"
    )


def test_a_robot_alone_needs_no_rounds():
    v = vehicle(3)
    assert Auction(0, v, [0, 1, 2], 0).done
