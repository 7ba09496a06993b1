from itertools import combinations, pairwise, permutations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from crazychoir.errors import SolverError
from crazychoir.routing.instance.generate import InstanceShape, random_instance
from crazychoir.routing.instance.instance import Instance
from crazychoir.routing.pricing.route_table import (
    RouteTable,
    exceeds_label_limit,
    find_shortest_route,
)


def brute_force(local, tasks):
    """Length of the shortest tour over all orders, or None."""
    m, best = len(local.tasks), None
    for order in permutations([*tasks, *(m + j for j in tasks)]):
        if any(order.index(j) > order.index(m + j) for j in tasks):
            continue
        held = np.cumsum(
            [local.tasks.load[v] if v < m else -local.tasks.load[v - m] for v in order]
        )
        tour = [2 * m, *order, 2 * m]
        length = sum(local.vehicle.distance[a, b] for a, b in pairwise(tour))
        if (
            (held <= local.capacity).all()
            and length <= local.limit
            and (best is None or length < best)
        ):
            best = length
    return best


@settings(max_examples=25, deadline=None)
@given(
    st.integers(0, 10_000),
    st.sampled_from([None, 16.0, 25.0]),
    st.sampled_from([(10, 10), (3, 3, 2)]),
)
def test_the_table_holds_exactly_the_feasible_sets_with_their_shortest_tours(
    seed, limit, room
):
    limit = None if len(room) == 3 else limit
    try:
        instance = random_instance(
            1, 3, seed, InstanceShape(room=room, route_length_limit=limit)
        )
    except ValueError:
        return
    local = instance.local(0)
    expected = {()}
    for size in (1, 2, 3):
        expected |= {
            tasks
            for tasks in combinations(range(3), size)
            if brute_force(local, tasks) is not None
        }
    table = RouteTable(local.vehicle)
    found = {table.column(c).tasks: table.column(c).length for c in range(len(table))}
    assert set(found) == expected
    for tasks in expected - {()}:
        assert found[tasks] == pytest.approx(brute_force(local, tasks), abs=1e-9)


def test_the_least_reduced_cost_is_the_least_of_all_columns():
    local = random_instance(1, 6, seed=3).local(0)
    table = RouteTable(local.vehicle)
    prices = np.random.default_rng(0).uniform(0, 12, size=6)
    every = [
        table.column(c).length - prices[list(table.column(c).tasks)].sum()
        for c in range(len(table))
    ]
    assert table.least(prices) == pytest.approx(min(every))
    best = table.cheapest(prices, 5, below=0.0)
    assert [c.length - prices[list(c.tasks)].sum() for c in best] == pytest.approx(
        sorted(every)[:5]
    )


def test_a_forbidden_task_is_in_no_column():
    table = RouteTable(random_instance(1, 5, seed=1).local(0).vehicle)
    prices = np.array([9.0, 9.0, -np.inf, 9.0, 9.0])
    assert all(
        2 not in column.tasks for column in table.cheapest(prices, 1000, below=np.inf)
    )


def test_idle_costs_nothing_and_comes_first():
    table = RouteTable(random_instance(1, 4, seed=1).local(0).vehicle)
    assert table.column(0).tasks == ()
    assert table.length[0] == 0.0
    assert table.complete


def test_a_robot_that_can_do_nothing_has_the_idle_column_only():
    raw = random_instance(2, 3, seed=1).to_json()
    raw["capability"] = [[True] * 3, [False] * 3]
    raw["capacity"][0] = 9.0
    table = RouteTable(Instance.parse(raw).local(1).vehicle)
    assert [table.column(c).tasks for c in range(len(table))] == [()]
    assert table.least(np.full(3, 100.0)) == 0.0


def test_more_than_sixty_four_tasks_use_the_second_word():
    points = [[0.1 * j, 1.0] for j in range(70)]
    raw = {
        "home": [[0.0, 0.0]],
        "pickup": points,
        "delivery": points,
        "load": [1.0] * 70,
        "capacity": [1.0],
    }
    local = Instance.parse(raw | {"route_length_limit": 15.0}).local(0).vehicle
    table = RouteTable(local, most=30_000)
    assert table.find([66]).length == pytest.approx(2 * np.hypot(6.6, 1.0))
    assert table.find([63, 64]).length == pytest.approx(
        np.hypot(6.3, 1) + 0.1 + np.hypot(6.4, 1)
    )
    nodes, length = find_shortest_route(local, [3, 63, 64, 69])
    assert nodes == [3, 73, 63, 133, 64, 134, 69, 139] or nodes[::2] == [69, 64, 63, 3]
    assert length == pytest.approx(np.hypot(0.3, 1) + 6.6 + np.hypot(6.9, 1))


def test_a_table_that_is_cut_says_so():
    local = random_instance(1, 7, seed=2).local(0)
    assert RouteTable(local.vehicle).complete
    cut = RouteTable(local.vehicle, most=60)
    assert not cut.complete
    assert len(cut) < len(RouteTable(local.vehicle))


def test_the_route_of_a_set_is_as_long_as_its_column():
    local = random_instance(
        1, 6, seed=5, shape=InstanceShape(route_length_limit=30.0)
    ).local(0)
    table = RouteTable(local.vehicle)
    for c in range(len(table)):
        column = table.column(c)
        nodes, length = find_shortest_route(local.vehicle, column.tasks)
        assert length == column.length
        assert sorted(nodes) == sorted([*column.tasks, *(6 + j for j in column.tasks)])


@pytest.mark.parametrize(
    "change",
    [{"route_length_limit": 30.0}, {"capability": [[True, False, True, True]]}],
)
def test_a_set_that_does_not_fit_is_refused(change):
    raw = random_instance(2, 4, seed=4).to_json() | {"capability": [[True] * 4] * 2}
    raw["capability"] = [*change.get("capability", [[True] * 4]), [True] * 4]
    raw["route_length_limit"] = change.get("route_length_limit")
    with pytest.raises(SolverError, match="robot 0: a tour of tasks"):
        find_shortest_route(Instance.parse(raw).local(0).vehicle, [0, 1, 2, 3])


def test_capacity_holds_along_the_route():
    points = {"pickup": [[1.0, 0.0], [2.0, 0.0]], "delivery": [[3.0, 0.0], [4.0, 0.0]]}
    raw = {"home": [[0.0, 0.0]], **points, "load": [1.0, 1.0]}
    locals_ = [
        Instance.parse(raw | {"capacity": [capacity]}).local(0)
        for capacity in (1.0, 2.0)
    ]
    lengths = [RouteTable(local.vehicle).find([0, 1]).length for local in locals_]
    assert lengths == pytest.approx([10.0, 8.0])


def test_columns_are_in_the_order_of_length_and_tasks():
    table = RouteTable(random_instance(1, 6, seed=9).local(0).vehicle)
    columns = [table.column(c) for c in range(len(table))]
    assert columns == sorted(columns)
    assert len({c.tasks for c in columns}) == len(columns)
    assert all(len(set(c.tasks)) == len(c.tasks) for c in columns)


@pytest.mark.parametrize("seed", range(4))
def test_a_table_that_is_said_to_need_too_many_labels_does(seed):
    instance = random_instance(1, 7, seed)
    vehicle = instance.local(0).vehicle
    mosts = [500, 1000, 2000, 4000, 8000, 16_000]
    told = [exceeds_label_limit(vehicle, most) for most in mosts]
    complete = [RouteTable(vehicle, most).complete for most in mosts]
    assert told[0]
    assert not told[-1]
    assert not any(a and b for a, b in zip(told, complete, strict=True))


def test_a_limit_leaves_the_number_of_labels_open():
    shape = InstanceShape(route_length_limit=25.0)
    vehicle = random_instance(1, 20, 1, shape).local(0).vehicle
    assert not exceeds_label_limit(vehicle, 10)
