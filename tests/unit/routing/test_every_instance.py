"""What is claimed of a plan holds for every instance that the loader admits, however degenerate."""

import warnings
from math import dist

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from crazychoir.errors import InstanceError, SolverError
from crazychoir.routing.distributed.master import (
    ColumnPool,
    PartitionProblem,
    find_partition,
)
from crazychoir.routing.distributed.member import (
    ColumnSettings,
    PriceSettings,
    ProofSettings,
    RoutingSettings,
)
from crazychoir.routing.distributed.pickup_delivery import PLANNING_METHODS
from crazychoir.routing.distributed.plain_loop import solve_in_loop
from crazychoir.routing.instance.checker import check_plan
from crazychoir.routing.instance.generate import InstanceShape, random_instance
from crazychoir.routing.instance.instance import Instance
from crazychoir.routing.pricing.arc_flow import solve_compact
from crazychoir.routing.pricing.route_table import RouteTable

TOLERANCE = 1e-6
QUICK = RoutingSettings(prices=PriceSettings(rounds=8))


@st.composite
def raw_instances(draw):
    """Up to three robots and three tasks on a grid so coarse that points coincide; all limits may be 0 or none."""
    robots, tasks, axes = (
        draw(st.integers(1, 3)),
        draw(st.integers(1, 3)),
        draw(st.sampled_from([2, 3])),
    )
    unit = draw(st.sampled_from([1.0, 0.01, 30.0]))
    point = st.lists(
        st.sampled_from([0.0, unit, 3 * unit]), min_size=axes, max_size=axes
    )
    return {
        "home": draw(st.lists(point, min_size=robots, max_size=robots)),
        "pickup": draw(st.lists(point, min_size=tasks, max_size=tasks)),
        "delivery": draw(st.lists(point, min_size=tasks, max_size=tasks)),
        "load": draw(
            st.lists(st.sampled_from([0.0, 1.0, 2.0]), min_size=tasks, max_size=tasks)
        ),
        "capacity": draw(
            st.lists(
                st.sampled_from([0.0, 1.0, 2.0, 3.0]), min_size=robots, max_size=robots
            )
        ),
        "route_length_limit": draw(
            st.sampled_from([None, 0.0, 6.1 * unit, 10.1 * unit, 14.1 * unit])
        ),
        "capability": draw(
            st.lists(
                st.lists(st.booleans(), min_size=tasks, max_size=tasks),
                min_size=robots,
                max_size=robots,
            )
        ),
    }


def instance_of(raw):
    """The instance, or None if the loader refuses it."""
    try:
        return Instance.parse(raw)
    except InstanceError as refusal:
        if "instance: task " not in str(refusal):
            raise
        return None


def path(robots):
    return {i: [j for j in (i - 1, i + 1) if 0 <= j < robots] for i in range(robots)}


def least_cost(instance):
    """By the compact model; None if there is no plan."""
    try:
        plan = solve_compact(instance)
    except SolverError as error:
        if "Infeasible" not in str(error):
            raise
        return None
    assert check_plan(instance, plan) == []
    return plan.cost


MEETING = {
    "home": [[0.0, 0.0]],
    "pickup": [[3.0, 0.0]] * 2,
    "delivery": [[3.0, 0.0]] * 2,
    "load": [1.0, 1.0],
}
NOWHERE = {
    "home": [[1.0, 1.0]] * 2,
    "pickup": [[1.0, 1.0]],
    "delivery": [[1.0, 1.0]],
    "load": [0.0],
}
USELESS = {
    "home": [[0.0, 0.0], [1.0, 0.0]],
    "pickup": [[1.0, 0.0]],
    "delivery": [[3.0, 0.0]],
    "load": [1.0],
}


@settings(max_examples=60, deadline=None, derandomize=True)
@given(raw_instances(), st.booleans())
@example(MEETING | {"capacity": [1.0]}, False)
@example(NOWHERE | {"capacity": [0.0, 0.0], "route_length_limit": 0.0}, False)
@example(USELESS | {"capacity": [0.0, 1.0], "capability": [[False], [True]]}, True)
def test_the_plan_is_feasible_optimal_and_proven(raw, weak):
    instance = instance_of(raw)
    if instance is None:
        return
    optimum, graph = least_cost(instance), path(instance.robots)
    options = (
        RoutingSettings(
            prices=PriceSettings(rounds=1),
            columns=ColumnSettings(batch=1, most_shared=1),
            proof=ProofSettings(first_gap=0.001),
        )
        if weak
        else QUICK
    )
    if optimum is None:
        with pytest.raises(SolverError, match="infeasible: no plan serves every task"):
            solve_in_loop(instance, graph, settings=options)
        return
    solution = solve_in_loop(instance, graph, settings=options)
    assert check_plan(instance, solution.plan) == []
    assert solution.cost == pytest.approx(optimum, abs=TOLERANCE)
    assert solution.bound_exact
    assert solution.lower_bound <= optimum + TOLERANCE
    assert solution.lower_bound == pytest.approx(
        optimum, abs=2 * TOLERANCE * max(1.0, optimum)
    )


@settings(max_examples=40, deadline=None, derandomize=True)
@given(
    raw_instances(),
    st.sampled_from(["resource", "resource-argmax"]),
    st.integers(1, 30),
)
@example(NOWHERE | {"capacity": [0.0, 0.0]}, "resource", 8)
@example(
    MEETING | {"home": [[0.0, 0.0], [1.0, 0.0]], "capacity": [2.0, 2.0]},
    "resource-argmax",
    60,
)
def test_claims_end_in_a_feasible_plan_or_a_refusal_and_their_bound_is_one(
    raw, method, rounds
):
    instance = instance_of(raw)
    if instance is None:
        return
    optimum, graph = least_cost(instance), path(instance.robots)
    try:
        solution = solve_in_loop(
            instance,
            graph,
            method,
            RoutingSettings(prices=PriceSettings(rounds=rounds)),
        )
    except SolverError as refusal:
        # Without a limit every route can take one task more.
        if "use the method columns" not in str(refusal) or np.isinf(
            instance.route_length_limit
        ):
            raise
        return
    assert optimum is not None
    assert check_plan(instance, solution.plan) == []
    assert solution.bound_exact
    assert solution.lower_bound <= optimum + TOLERANCE
    assert optimum <= solution.cost + TOLERANCE


@settings(max_examples=40, deadline=None, derandomize=True)
@given(raw_instances(), st.lists(st.floats(0.0, 100.0), min_size=3, max_size=3))
def test_any_common_prices_give_a_lower_bound(raw, prices):
    """sum_j pi_j + sum_i min(0, least reduced cost): the one formula behind every bound."""
    instance = instance_of(raw)
    if instance is None or (optimum := least_cost(instance)) is None:
        return
    pi = np.array(prices[: len(instance.tasks)])
    tables = [RouteTable(instance.local(i).vehicle) for i in range(instance.robots)]
    assert all(table.complete and table.least(pi) <= 0.0 for table in tables)
    assert pi.sum() + sum(table.least(pi) for table in tables) <= optimum + TOLERANCE
    pool = ColumnPool(len(pi))
    for i, table in enumerate(tables):
        pool.add(i, [table.column(c) for c in range(1, len(table))])
    assert pool.relax(np.full(len(pi), 1e4)).value <= optimum + TOLERANCE
    assert find_partition(
        PartitionProblem(pool.items(), len(pi)), seed=0, nodes=1000
    ).cost == pytest.approx(optimum, abs=TOLERANCE)


@settings(max_examples=40, deadline=None, derandomize=True)
@given(raw_instances())
def test_every_column_of_a_table_is_a_tour_and_with_it_each_part_of_it(raw):
    """Claims rely on this: a robot that wins a part of its claim can serve that part."""
    instance = instance_of(raw)
    for i in range(instance.robots if instance else 0):
        table = RouteTable(instance.local(i).vehicle)
        for c in range(len(table)):
            tasks = table.column(c).tasks
            for left_out in tasks:
                part = table.find([j for j in tasks if j != left_out])
                assert part is not None
                assert part.length <= table.length[c] + TOLERANCE


def test_a_robot_with_no_share_left_still_claims_a_task_that_only_it_can_do():
    """Robot 0 is near the goods and can do nothing; robot 1 is far, its price is higher, and its share becomes 0."""
    goods = {
        "pickup": [[1.0, 0.0]],
        "delivery": [[2.0, 0.0]],
        "load": [1.0],
        "capacity": [1.0, 1.0],
    }
    homes = [[0.0, 0.0], [300.0, 0.0]]
    instance = Instance.parse({"home": homes, **goods, "capability": [[False], [True]]})
    for method in PLANNING_METHODS[1:]:
        solution = solve_in_loop(instance, {0: [1], 1: [0]}, method)
        assert [route.robot for route in solution.routes] == [1]
        assert solution.cost == pytest.approx(
            dist(homes[1], [1.0, 0.0]) + 1.0 + dist([2.0, 0.0], homes[1])
        )


@pytest.mark.parametrize("key", ["home", "pickup", "delivery"])
@pytest.mark.parametrize("value", [1.1e5, -1.1e5, 1e200, -(10**400)])
def test_places_beyond_what_sums_are_exact_for_are_refused(key, value):
    raw = random_instance(1, 1, seed=1).to_json()
    raw[key][0][1] = value
    with pytest.raises(
        InstanceError,
        match=rf"{key}\[0\]\[1\]: found .*; allowed: a number from -100000 to 100000",
    ):
        Instance.parse(raw)


@pytest.mark.parametrize(
    ("key", "value"),
    [("load", 1.1e6), ("capacity", 1e300), ("capacity", -1), ("load", -0.1)],
)
def test_amounts_beyond_what_sums_are_exact_for_are_refused(key, value):
    raw = random_instance(1, 1, seed=1).to_json()
    raw[key][0] = value
    with pytest.raises(
        InstanceError,
        match=rf"{key}\[0\]: found .*; allowed: a number from 0 to 1e\+06",
    ):
        Instance.parse(raw)


def test_the_farthest_and_heaviest_that_are_admitted_are_solved():
    raw = {
        "home": [[-1e5, -1e5], [1e5, 1e5]],
        "pickup": [[1e5, -1e5]],
        "delivery": [[-1e5, 1e5]],
        "load": [1e6],
    }
    with warnings.catch_warnings(action="error"):
        solution = solve_in_loop(
            Instance.parse(raw | {"capacity": [0.0, 1e6]}), path(2)
        )
    assert solution.cost == pytest.approx(4e5 + 2e5 * np.sqrt(2))
    assert solution.bound_exact


def test_a_robot_within_reach_of_more_tasks_than_a_set_holds_says_so():
    points = [[0.01 * j, 1.0] for j in range(129)]
    raw = {
        "home": [[0.0, 0.0]],
        "pickup": points,
        "delivery": points,
        "load": [1.0] * 129,
        "capacity": [1.0],
        "route_length_limit": 4.0,
    }
    with pytest.raises(
        InstanceError,
        match="robot 0: tasks that it could serve: found 129; allowed: at most 128",
    ):
        solve_in_loop(Instance.parse(raw), {0: []}, "resource-columns")
    all_but_one = [[False] + [True] * 128, [True] * 129]
    most = Instance.parse(
        raw
        | {"home": [[0.0, 0.0]] * 2, "capacity": [1.0, 1.0], "capability": all_but_one}
    )
    table = RouteTable(most.local(0).vehicle, most=2000)
    assert [table.find([j]).tasks for j in (1, 64, 65, 128)] == [
        (1,),
        (64,),
        (65,),
        (128,),
    ]


def test_a_search_that_ends_early_does_not_claim_that_there_is_no_plan():
    instance = random_instance(3, 5, seed=4)
    tables = [RouteTable(instance.local(i).vehicle) for i in range(3)]
    columns = [
        (i, table.column(c))
        for i, table in enumerate(tables)
        for c in range(1, len(table))
    ]
    lonely = [(i, column) for i, column in columns if 0 not in column.tasks]
    assert (
        find_partition(PartitionProblem(lonely, 5), seed=0, nodes=100).bound == np.inf
    )
    assert (
        find_partition(PartitionProblem(columns, 5), seed=0, nodes=100).bound < np.inf
    )
    cut = RoutingSettings(columns=ColumnSettings(most_labels=8))
    limited = InstanceShape(capacities=(9, 9), route_length_limit=80.0)
    with pytest.raises(SolverError, match="no plan found: route tables were cut"):
        solve_in_loop(
            random_instance(1, 5, seed=4, shape=limited),
            {0: []},
            "resource-columns",
            cut,
        )
