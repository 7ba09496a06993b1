from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from crazychoir.bus.codec import decode, encode
from crazychoir.errors import SolverError
from crazychoir.routing.distributed import large_bound, proof
from crazychoir.routing.distributed import robot_profile as introduction
from crazychoir.routing.distributed.bound import Bound, find_fitting_gap
from crazychoir.routing.distributed.cluster_problem import (
    bound_saving,
    measure_route,
    reoptimize_cluster,
    restrict_problem,
)
from crazychoir.routing.distributed.clusters import (
    Neighbors,
    list_served_tasks,
    list_unserved_tasks,
)
from crazychoir.routing.distributed.gossip import Gossip
from crazychoir.routing.distributed.large_bound import LargeBound
from crazychoir.routing.distributed.master import (
    ColumnPool,
    PartitionProblem,
    find_partition,
)
from crazychoir.routing.distributed.member import (
    ColumnSettings,
    GraphPosition,
    ProofSettings,
    RoutingMember,
    RoutingSettings,
    SearchSettings,
)
from crazychoir.routing.distributed.plain_loop import (
    compute_diameter,
    make_team,
    solve_in_loop,
)
from crazychoir.routing.distributed.robot_profile import introduce_robots
from crazychoir.routing.distributed.team_order import TeamOrder
from crazychoir.routing.instance.checker import check_plan
from crazychoir.routing.instance.generate import InstanceShape, random_instance
from crazychoir.routing.instance.instance import Instance
from crazychoir.routing.pricing.arc_flow import solve_compact
from crazychoir.routing.pricing.bidirectional_pricing import HalfRoutes
from crazychoir.routing.pricing.packing import pack_columns
from crazychoir.routing.pricing.route_table import RouteColumn, RouteTable

WINDOWS = {
    "pickup": [[0, 20]] * 4 + [None],
    "delivery": [[0, 40]] * 5,
    "home": [[0, 90]] * 3,
}


def require_same_vehicle(one, other):
    np.testing.assert_array_equal(one.distance, other.distance)
    np.testing.assert_array_equal(one.duration, other.duration)
    for name, value in vars(replace(other)).items():
        if name not in ("ways", "times"):
            np.testing.assert_array_equal(getattr(one, name), value, err_msg=name)


def members(instance, links, settings=None):
    n, span = instance.robots, compute_diameter(links)
    places = [
        GraphPosition(i, n, tuple(links[i]), span, {j: len(links[j]) for j in links[i]})
        for i in range(n)
    ]
    return [
        RoutingMember(instance.local(i), place, settings or RoutingSettings())
        for i, place in enumerate(places)
    ]


def run_all(programs, links):
    """Results of generators of all robots, run together; messages pass the codec."""
    messages, results = [next(program) for program in programs], [None] * len(programs)
    while True:
        sent = [decode(encode(message)) for message in messages]
        for i, program in enumerate(programs):
            try:
                messages[i] = program.send({j: sent[j] for j in links[i]})
            except StopIteration as end:
                results[i] = (end.value,)
        if any(results):
            assert all(results), "not all robots end in the same round"
            return [value for (value,) in results]


@pytest.mark.parametrize(
    ("fixed", "gap"), [(1000.0, 0.004), pytest.param(1e6, 4e-6, marks=pytest.mark.slow)]
)
def test_where_robots_are_dear_the_bound_counts_whole_ones(graph, fixed, gap):
    """Without that, parts of robots leave a gap of half of their cost, a sixth of the plan's."""
    plain = random_instance(6, 10, 0, InstanceShape(route_length_limit=30.0)).to_json()
    instance = Instance.parse(plain | {"fixed_cost": fixed})
    links = graph("ring", 6)
    team = members(instance, links)
    for member in team:
        member.fixed = fixed  # as the robots' introductions tell
    gossips = [Gossip(member) for member in team]
    values = run_all([gossip.run() for gossip in gossips], links)
    best = solve_in_loop(instance, links)
    assert len({gossip.bound.robots for gossip in gossips}) == 1
    assert gossips[0].bound.robots <= len(best.routes) == 3
    assert best.lower_bound == pytest.approx(best.cost, rel=1e-9)
    for value, gossip in zip(values, gossips, strict=True):
        assert gossip.bound.value == pytest.approx(value, rel=1e-6)
        assert best.cost * (1.0 - gap) <= gossip.bound.value <= best.cost + 1e-6


@pytest.mark.parametrize("shape", ["ring", "path", "star"])
@pytest.mark.parametrize("seed", [1, 2])
def test_the_gossip_reaches_the_relaxation_over_all_columns_and_proves_it(
    graph, shape, seed
):
    instance, links = (
        random_instance(
            6, 10, seed, InstanceShape(capable=0.8, route_length_limit=27.0)
        ),
        graph(shape, 6),
    )
    team = members(instance, links)
    gossips = [Gossip(member) for member in team]
    values = run_all([gossip.run() for gossip in gossips], links)
    everything = ColumnPool(10)
    for i in range(6):
        table = RouteTable(instance.local(i).vehicle)
        everything.add(i, [table.column(c) for c in range(1, len(table))])
    relaxed = everything.relax(team[0].penalty).value
    for value, gossip in zip(values, gossips, strict=True):
        assert value == pytest.approx(relaxed, abs=1e-6)
        assert gossip.bound.value == pytest.approx(relaxed, abs=1e-5)
        assert gossip.bound.value == gossips[0].bound.value
        assert gossip.bound.exact


def test_the_bound_of_a_cut_table_is_not_exact(graph):
    links = graph("ring", 3)
    team = members(
        random_instance(3, 6, 4),
        links,
        RoutingSettings(columns=ColumnSettings(most_labels=100)),
    )
    gossips = [Gossip(member) for member in team]
    run_all([gossip.run() for gossip in gossips], links)
    assert not any(gossip.bound.exact for gossip in gossips)


@pytest.mark.parametrize("most_bytes", [introduction.MOST_BYTES, 1])
def test_introductions_tell_all_that_a_route_depends_on(graph, monkeypatch, most_bytes):
    monkeypatch.setattr(introduction, "MOST_BYTES", most_bytes)
    raw = random_instance(3, 5, 6, InstanceShape(capable=0.7, loads=(1, 1))).to_json()
    distance = np.random.default_rng(3).uniform(1, 9, size=(3, 13, 13)).tolist()
    raw |= {
        "distance": distance,
        "speed": [1, 2, 3],
        "time_windows": WINDOWS,
        "initial_load": [1, 0, 2],
    }
    instance, links = Instance.parse(raw), graph("path", 3)
    for known in run_all(
        [introduce_robots(member) for member in members(instance, links)], links
    ):
        for i in range(3):
            mine, told = instance.local(i).vehicle, known.robots[i].vehicle
            require_same_vehicle(told, mine)


def test_robots_of_a_process_that_were_told_the_same_hold_one_object(graph):
    instance, links = random_instance(3, 5, 6), graph("path", 3)
    one, *others = run_all(
        [introduce_robots(member) for member in members(instance, links)], links
    )
    assert all(other is one for other in others)
    with pytest.raises(TypeError, match="does not support item assignment"):
        one.robots[0] = instance.local(1)


def test_robots_of_a_process_that_were_told_different_things_hold_different_objects(
    graph,
):
    links = graph("path", 2)
    told = [
        run_all([introduce_robots(m) for m in members(instance, links)], links)[0]
        for instance in (
            random_instance(2, 5, 6),
            random_instance(2, 5, 6, InstanceShape(route_length_limit=90.0)),
            random_instance(2, 5, 7),
        )
    ]
    assert len({id(known) for known in told}) == 3


def test_a_robot_restricted_to_some_tasks_is_that_vehicle_with_these_tasks_only():
    local, chosen = (
        random_instance(2, 7, 3, InstanceShape(route_length_limit=30.0)).local(1),
        np.array([1, 4, 6]),
    )
    part, whole = restrict_problem(local, chosen).vehicle, local.vehicle.only(chosen)
    require_same_vehicle(part, whole)


def remote(home, **more):
    """Two robots, one of them far away, that alone can serve the first two of six tasks."""
    random = np.random.default_rng(0)
    raw = {
        "home": [[home, 0.0], [0.5, 0.5]],
        "pickup": random.random((6, 2)).tolist(),
        "load": [1] * 6,
    }
    raw |= {"delivery": random.random((6, 2)).tolist(), "capacity": [1, 2]}
    return Instance.parse(
        raw
        | {"capability": [[True] * 2 + [False] * 4, [False] * 2 + [True] * 4]}
        | more
    )


def test_a_robot_serves_its_tasks_from_however_far(graph):
    solution = solve_in_loop(remote(100.0), graph("path", 2))
    assert solution.cost == pytest.approx(204.0921, abs=1e-3)
    assert solution.lower_bound == pytest.approx(solution.cost, abs=1e-3)


def test_distances_of_a_matrix_may_be_any_times_those_between_the_points(graph):
    near = remote(1.0)
    points = np.vstack([near.home, near.tasks.pickup, near.tasks.delivery])
    distance = np.linalg.norm(points[:, None] - points[None], axis=2)
    one, many = (
        remote(1.0, distance=(times * distance).tolist()) for times in (1.0, 1000.0)
    )
    few, more = (solve_in_loop(instance, graph("path", 2)) for instance in (one, many))
    assert more.cost == pytest.approx(1000.0 * few.cost)
    assert more.lower_bound == pytest.approx(more.cost)


def test_after_introductions_all_have_one_penalty_which_is_no_less_than_any_robot_for_a_task_alone(
    graph,
):
    flying = replace(remote(30.0).local(0), start=np.array([0.0, -70.0]))
    for local in (remote(30.0).local(0), flying):
        team = members(remote(30.0), graph("path", 2))
        team[0] = replace(team[0], local=local, reach=0.0)
        run_all([introduce_robots(member) for member in team], graph("path", 2))
        np.testing.assert_array_equal(team[0].penalty, team[1].penalty)
        assert all(
            (member.penalty >= member.local.vehicle.shortest_trip).all()
            for member in team
        )


@pytest.mark.parametrize("objective", ["total", "makespan"])
def test_nothing_is_saved_by_leaving_a_task_out_that_costs_more_than_any_plan(
    objective,
):
    raw = random_instance(2, 6, 3).to_json() | {
        "objective": objective,
        "speed": [0.01, 2.0],
        "recharge": 6,
    }
    raw |= {
        "service_time": 3.0,
        "fixed_cost": 4.0,
        "time_windows": {"pickup": [[500, None]] * 6},
    }
    instance = Instance.parse(raw)
    robots = {i: instance.local(i) for i in range(2)}
    everything = [v for j in range(6) for v in (j, 6 + j, 13)][:-1]
    cost, finish = measure_route(robots[0], everything)
    reach = float(robots[0].vehicle.distance.max())
    assert (cost if objective == "total" else finish) < bound_saving(robots, reach)


def test_clusters_are_disjoint_hold_every_task_and_differ_from_pass_to_pass():
    instance = random_instance(12, 20, 5)
    robots = {i: instance.local(i) for i in range(12)}
    near = Neighbors(robots, TeamOrder.of(robots))
    routes = {i: [i, 20 + i] for i in range(10)}
    draws = [near.draw(routes, (5, 6), 2, [k]) for k in range(8)]
    for clusters in draws:
        assert sorted(i for c in clusters for i in c.robots) == list(range(12))
        assert sorted(j for c in clusters for j in c.tasks) == list(range(20)), (
            "open tasks too"
        )
        for c in clusters:
            assert set(c.leaders) <= set(c.robots)
            assert len(c.leaders) == min(2, len(c.robots))
            assert len(c.robots) <= 5
            assert len([i for i in c.robots if i in routes]) <= 6
    assert draws[0] == near.draw(routes, (5, 6), 2, [0])
    assert any(draws[0] != other for other in draws[1:])


def test_robots_with_neighbouring_routes_are_near():
    points = [[0.0, 0.0], [0.0, 1.0], [9.0, 9.0], [9.0, 8.0]]
    raw = {
        "home": [[0.5, 0.0], [0.0, 0.5], [9.0, 9.0]],
        "pickup": points,
        "delivery": points,
        "load": [1.0] * 4,
    }
    instance = Instance.parse(raw | {"capacity": [4.0] * 3})
    robots = {i: instance.local(i) for i in range(3)}
    near = Neighbors(robots, TeamOrder.of(robots))
    far = near.nearness({0: [0, 4], 1: [1, 5], 2: [2, 6]})
    assert far[0, 1] < 1.0 < 5.0 < far[0, 2]
    np.testing.assert_array_equal(far, far.T)


def test_a_cluster_gets_better_and_keeps_its_tasks():
    instance = random_instance(4, 8, 2, InstanceShape(capacities=(5, 5)))
    robots = {i: instance.local(i) for i in range(4)}
    routes = {i: [i, 8 + i, 4 + i, 12 + i] for i in range(4)}
    near = Neighbors(robots, TeamOrder.of(robots))
    (cluster,) = near.draw(routes, (8, 40), 1, [0])
    new = reoptimize_cluster(robots, routes, cluster, np.full(8, 1e3), 500, 1)
    assert list_unserved_tasks(new, 8) == []
    assert (
        sum(measure_route(robots[i], new[i])[0] for i in robots)
        < sum(measure_route(robots[i], routes[i])[0] for i in robots) - 1.0
    )
    assert list_served_tasks([3, 11, 17, 0, 8], 8) == [0, 3]


@pytest.mark.parametrize("seed", range(3))
def test_where_routes_are_not_listed_the_plan_is_good_and_has_no_bound(graph, seed):
    instance = random_instance(6, 10, seed, InstanceShape(route_length_limit=30.0))
    proven = solve_in_loop(instance, graph("ring", 6))
    assert proven.lower_bound == pytest.approx(proven.cost, abs=1e-4)
    searched = solve_in_loop(
        instance,
        graph("ring", 6),
        settings=RoutingSettings(
            columns=ColumnSettings(most_listed=0), search=SearchSettings(steps=40_000)
        ),
    )
    assert (searched.feasible, searched.lower_bound, searched.bound_exact) == (
        True,
        None,
        False,
    )
    assert proven.cost - 1e-6 <= searched.cost <= 1.05 * proven.cost


def test_a_proof_that_would_be_too_long_is_left_out_unless_asked_for(graph):
    instance = random_instance(
        5, 9, 39, InstanceShape(capable=0.8, route_length_limit=32.0)
    )
    few = RoutingSettings(
        search=SearchSettings(still_passes=2, steps=4_000),
        proof=ProofSettings(most_proven=0),
    )
    found = solve_in_loop(instance, graph("ring", 5), settings=few)
    proven = solve_in_loop(
        instance,
        graph("ring", 5),
        settings=replace(few, proof=replace(few.proof, prove=True)),
    )
    assert found.bound_exact
    assert found.lower_bound <= proven.cost + 1e-6 <= found.cost + 2e-6
    assert proven.lower_bound == pytest.approx(proven.cost, abs=1e-4)


FIELDS = {
    "refusals": {"penalty": [3.0, None, 30.0]},
    "windows and service": {
        "time_windows": {"delivery": [[0, 30], None, [0, 40]]},
        "service_time": 0.5,
    },
    "a fixed cost": {"fixed_cost": 5.0},
    "makespan": {"objective": "makespan"},
    "makespan, then total": {"objective": ["makespan", "total"]},
    "open tours": {"open_tours": True},
}


@pytest.mark.parametrize("name", FIELDS)
def test_the_optimum_of_the_arc_flow_model_is_found(graph, name):
    raw = (
        random_instance(2, 3, 9, InstanceShape(route_length_limit=40.0)).to_json()
        | FIELDS[name]
    )
    instance = Instance.parse(raw)
    best = solve_compact(instance)
    solution = solve_in_loop(instance, graph("path", 2))
    plan = instance.plan(solution.routes)
    assert check_plan(instance, plan) == []
    assert plan.values == pytest.approx(best.values, abs=1e-4)
    assert solution.cost == pytest.approx(plan.cost)
    if "makespan" in name:
        assert solution.lower_bound is None
    else:
        assert solution.lower_bound == pytest.approx(best.cost, abs=1e-4)


def test_no_bound_where_refusals_are_weighed_by_priority(graph):
    raw = random_instance(3, 5, 9, InstanceShape(route_length_limit=40.0)).to_json()
    instance = Instance.parse(raw | {"penalty": [2.0] * 5, "priority": [0, 1, 0, 1, 0]})
    solution = solve_in_loop(instance, graph("path", 3))
    assert solution.lower_bound is None
    assert solution.feasible


def test_infeasible_without_listed_routes_is_an_error_at_the_end(graph):
    points = [[1.0, 0.0], [9.0, 0.0]]
    raw = {
        "pickup": points,
        "delivery": points,
        "load": [1.0, 1.0],
        "home": [[5.0, 0.0]],
        "capacity": [1.0],
    }
    instance = Instance.parse(raw | {"route_length_limit": 9.0})
    with pytest.raises(
        SolverError, match=r"robot 0: clusters: .* no plan found that serves task"
    ):
        solve_in_loop(
            instance,
            {0: []},
            settings=RoutingSettings(
                columns=ColumnSettings(most_listed=0), search=SearchSettings(steps=100)
            ),
        )


def test_bytes_are_told_by_kind(graph):
    instance = random_instance(4, 6, 1, InstanceShape(route_length_limit=30.0))
    kinds = solve_in_loop(instance, graph("ring", 4)).bytes_by_kind
    assert set(kinds) >= {
        "start",
        "introductions",
        "bases",
        "prices",
        "plans",
        "columns",
    }
    assert all(size > 0 for size in kinds.values())
    claims = solve_in_loop(instance, graph("ring", 4), "resource").bytes_by_kind
    assert set(claims) == {"start", "prices", "claims", "plans"}


@pytest.mark.parametrize("seed", [18, 33, 39, 45, 52])
def test_refusals_are_weighed_in_the_proof_where_the_relaxation_has_a_gap(graph, seed):
    robots, tasks, limit = 3 + seed % 4, 6 + seed % 5, (25, 32, 45)[seed // 3 % 3]
    raw = random_instance(
        robots,
        tasks,
        seed,
        InstanceShape(capable=(1, 0.8, 0.5)[seed % 3], route_length_limit=limit),
    ).to_json()
    penalty = np.random.default_rng(seed).uniform(4.0, 14.0, size=tasks)
    instance = Instance.parse(raw | {"penalty": penalty.tolist()})
    tables = [RouteTable(instance.local(i).vehicle) for i in range(robots)]
    columns = [
        (i, table.column(c))
        for i, table in enumerate(tables)
        for c in range(1, len(table))
    ]
    refusals = [
        (robots + j, RouteColumn(float(penalty[j]), (j,))) for j in range(tasks)
    ]
    best = find_partition(
        PartitionProblem(columns + refusals, tasks), seed=0, nodes=10_000
    )
    solution = solve_in_loop(
        instance,
        graph("ring", robots),
        settings=RoutingSettings(search=SearchSettings(first_steps=1)),
    )
    assert solution.cost == pytest.approx(best.cost, abs=1e-6)
    assert solution.lower_bound == pytest.approx(best.cost, abs=1e-3)


def test_tables_that_are_cut_are_given_up_and_no_relaxation_follows(graph):
    instance = random_instance(3, 9, 4)
    solution = solve_in_loop(
        instance,
        graph("ring", 3),
        settings=RoutingSettings(
            columns=ColumnSettings(most_labels=1000), search=SearchSettings(steps=2000)
        ),
    )
    assert solution.feasible
    assert solution.lower_bound is None
    assert not {"bases", "prices"} & set(solution.bytes_by_kind)


def test_disclosed_names_all_that_introductions_tell(graph):
    told = {}

    def listen(message):
        _, content = message
        for item in content if isinstance(content, list) else ():
            if isinstance(item, list) and len(item) == 2 and isinstance(item[1], dict):
                told.update(item[1])
        return message

    raw = random_instance(3, 3, 1, InstanceShape(route_length_limit=30.0)).to_json()
    instance = Instance.parse(raw | {"fixed_cost": 2.0, "speed": [2.0] * 3})
    solution = solve_in_loop(instance, graph("ring", 3), carry=listen)
    assert {"home", "speed", "fixed", "window", "initial_load"} <= set(told)
    assert {f"own {name.replace('_', ' ')}" for name in told} <= set(solution.disclosed)
    assert "route lengths or times" in solution.disclosed


@pytest.mark.parametrize(
    "seed", [*(pytest.param(s, marks=pytest.mark.slow) for s in range(3)), 3]
)
def test_a_large_team_proves_a_bound_by_halves_or_names_its_relaxation(graph, seed):
    """With most_listed = 0 every team is large.

    By halves it proves the optimum, not only the relaxation of the gossip.
    """
    instance, links = (
        random_instance(
            4, 7, seed, InstanceShape(capable=0.8, route_length_limit=27.0)
        ),
        graph("ring", 4),
    )
    gossips = [Gossip(member) for member in members(instance, links)]
    relaxed = run_all([gossip.run() for gossip in gossips], links)[0]
    large = RoutingSettings(
        columns=ColumnSettings(most_listed=0), proof=ProofSettings(prove=True)
    )
    found, best = (
        solve_in_loop(instance, links, settings=large),
        solve_in_loop(instance, links),
    )
    assert found.bound_exact
    assert found.bound_relaxation is None
    assert relaxed - 1e-4 * relaxed <= found.lower_bound <= best.cost + 1e-9
    assert found.lower_bound == pytest.approx(found.cost, abs=1e-3)
    for more in (
        {"route_length_limit": None},
        {"time_windows": {"pickup": [[0, 30]] * 7}},
    ):
        other = Instance.parse(instance.to_json() | more)
        found, best = (
            solve_in_loop(other, links, settings=large),
            solve_in_loop(other, links),
        )
        assert not found.bound_exact
        assert found.bound_relaxation == "ng-route"
        assert 0.5 * best.cost < found.lower_bound <= best.cost + 1e-9
        assert best.bound_exact


def fly_all_routes(v):
    """{tasks: length of the best route} by all orders of pickups and deliveries."""
    m, best = v.tasks, {(): 0.0}

    def fly(at, length, picked, board):
        end = length + v.distance[at, 2 * m + 1]
        if picked and not board and end <= v.limit + 1e-9:
            tasks = tuple(sorted(picked))
            best[tasks] = min(best.get(tasks, np.inf), end + v.fixed)
        for j in board:
            fly(m + j, length + v.distance[at, m + j], picked, board - {j})
        for j in set(range(m)) - picked:
            if v.capable[j] and sum(v.load[list(board | {j})]) <= v.capacity:
                fly(j, length + v.distance[at, j], picked | {j}, board | {j})

    fly(2 * m, 0.0, frozenset(), frozenset())
    return best


def cheapest_of_all_plans(instance):
    """Cost of the best plan, by all routes of all robots."""
    penalty = instance.local(0).tasks.refusal
    plans = {frozenset(): 0.0}
    for i in range(instance.robots):
        more = {}
        for own, length in fly_all_routes(instance.local(i).vehicle).items():
            for served, cost in plans.items():
                if not served & set(own):
                    key = served | set(own)
                    more[key] = min(more.get(key, np.inf), cost + length)
        plans = more
    return min(
        cost + sum(penalty[j] for j in set(range(len(penalty))) - served)
        for served, cost in plans.items()
    )


@pytest.mark.parametrize(
    "fields",
    [
        {},
        {"fixed_cost": 3.0},
        {"penalty": [9.0, None, 5.0, None]},
        {"open_tours": True, "capacity": [4.0, 4.0, 4.0]},
    ],
)
@pytest.mark.parametrize("most", [2, 20_000])
def test_no_bound_of_a_large_team_is_above_the_best_of_all_plans(graph, fields, most):
    """The first plan is poor, so that the proof has to find a better one."""
    poor = RoutingSettings(
        columns=ColumnSettings(most_listed=0),
        search=SearchSettings(starters=1, first_steps=8, steps=1),
        proof=ProofSettings(prove=True, most_proven=most),
    )
    for seed in range(2):
        shape = InstanceShape(capable=0.8, route_length_limit=30.0)
        raw = random_instance(3, 4, seed, shape).to_json()
        instance = Instance.parse(raw | fields)
        best = cheapest_of_all_plans(instance)
        found = solve_in_loop(instance, graph("path", 3), settings=poor)
        assert found.bound_exact
        assert found.lower_bound <= best + 1e-6 <= found.cost + 2e-6
        if most > 2:
            assert found.cost == pytest.approx(best, abs=1e-6)
            assert found.lower_bound == pytest.approx(best, abs=1e-3)


def test_a_large_team_proves_a_bound_with_a_robot_far_away(graph):
    instance = remote(20.0, route_length_limit=90.0)
    found = solve_in_loop(
        instance,
        graph("path", 2),
        settings=RoutingSettings(
            columns=ColumnSettings(most_listed=0), proof=ProofSettings(prove=True)
        ),
    )
    assert found.bound_exact
    assert found.lower_bound == pytest.approx(found.cost, abs=1e-4)


@pytest.mark.parametrize("penalty", [1.0, 6.0, 12.0])
def test_the_bound_of_a_large_team_holds_where_tasks_are_refused_whatever_its_plan(
    graph, penalty
):
    instance = random_instance(
        4,
        7,
        2,
        InstanceShape(route_length_limit=27.0, fields={"penalty": [penalty] * 7}),
    )
    links = graph("ring", 4)
    best = solve_in_loop(instance, links)
    bounds = [
        LargeBound(member, [(0, RouteColumn(90.0, (0, 1)))])
        for member in members(instance, links)
    ]
    run_all([bound.run() for bound in bounds], links)
    assert {bound.value for bound in bounds} == {bounds[0].value}
    assert 0.9 * best.cost <= bounds[0].value <= best.cost + 1e-9


def test_where_pricing_is_cut_there_is_no_bound(graph):
    for limit in (27.0, None):
        instance = random_instance(4, 7, 1, InstanceShape(route_length_limit=limit))
        cut = RoutingSettings(
            columns=ColumnSettings(most_listed=0, most_labels=9),
            proof=ProofSettings(prove=True),
        )
        found = solve_in_loop(instance, graph("ring", 4), settings=cut)
        assert (found.lower_bound, found.bound_exact, found.bound_relaxation) == (
            None,
            False,
            None,
        )


def test_what_is_proven_stays_when_a_later_pass_is_cut(graph, monkeypatch):
    instance, links = (
        random_instance(3, 7, 1, InstanceShape(route_length_limit=27.0)),
        graph("ring", 3),
    )
    settings = RoutingSettings(
        columns=ColumnSettings(most_listed=0),
        proof=ProofSettings(prove=True, most_proven=0),
    )
    whole = solve_in_loop(instance, links, settings=settings)
    priced, passes = LargeBound._priced, {i: 0 for i in range(3)}

    def cut(self, pi):
        passes[self._i] += 1
        return (
            [-np.inf, True, pack_columns([])]
            if passes[self._i] > 2 and self._i == 1
            else priced(self, pi)
        )

    monkeypatch.setattr(LargeBound, "_priced", cut)
    part = solve_in_loop(instance, links, settings=settings)
    assert set(passes.values()) == {3}
    assert part.bound_exact
    assert 0.5 * whole.lower_bound < part.lower_bound < whole.lower_bound


def test_a_robot_with_too_many_half_routes_prices_by_a_relaxation(graph, monkeypatch):
    class Few(HalfRoutes):
        def __init__(self, vehicle, most):
            super().__init__(vehicle, 900)

    raw = random_instance(3, 8, 1, InstanceShape(route_length_limit=30.0)).to_json()
    instance = Instance.parse(raw | {"capacity": [1, 1, 8], "load": [1] * 8})
    assert [Few(instance.local(i).vehicle, 0).complete for i in range(3)] == [
        True,
        True,
        False,
    ]
    settings = RoutingSettings(
        columns=ColumnSettings(most_listed=0),
        search=SearchSettings(steps=4_000),
        proof=ProofSettings(prove=True),
    )
    exact = solve_in_loop(instance, graph("ring", 3), settings=settings)
    monkeypatch.setattr(large_bound, "HalfRoutes", Few)
    found = solve_in_loop(instance, graph("ring", 3), settings=settings)
    assert (exact.bound_exact, found.bound_exact, found.bound_relaxation) == (
        True,
        False,
        "ng-route",
    )
    assert 0.8 * exact.lower_bound < found.lower_bound <= exact.lower_bound + 1e-4


@pytest.mark.parametrize("limit", [60.0, None])
def test_a_robot_that_can_serve_more_tasks_than_a_set_holds_leaves_the_plan_without_a_bound(
    graph, limit
):
    instance = random_instance(
        2, 130, 0, InstanceShape(room=(0.7, 0.7), route_length_limit=limit)
    )
    few = RoutingSettings(
        search=SearchSettings(starters=1, first_steps=30, steps=100),
        proof=ProofSettings(prove=True),
    )
    found = solve_in_loop(instance, graph("path", 2), settings=few)
    assert (found.feasible, found.lower_bound, found.bound_relaxation) == (
        True,
        None,
        None,
    )


def test_a_team_of_two_kinds_prices_once_a_kind_and_proves_what_single_robots_prove(
    graph,
):
    raw = random_instance(
        6, 9, 8, InstanceShape(capacities=(4, 4), route_length_limit=27.0)
    ).to_json()
    raw |= {
        "home": [raw["home"][0]] * 4 + [raw["home"][1]] * 2,
        "capacity": [4.0] * 4 + [3.0] * 2,
    }
    raw |= {"load": [2.0] * 5 + [1.0] * 4, "fixed_cost": 1.5}
    instance = Instance.parse(raw)
    team = members(instance, graph("ring", 6))
    run_all([introduce_robots(member) for member in team], graph("ring", 6))
    assert [member.alike for member in team] == [{0: (0, 1, 2, 3), 4: (4, 5)}] * 6
    assert [member.speaks for member in team] == [
        True,
        False,
        False,
        False,
        True,
        False,
    ]
    gossips, everything = [Gossip(member) for member in team], ColumnPool(9)
    run_all([gossip.run() for gossip in gossips], graph("ring", 6))
    for i in range(6):
        table = RouteTable(instance.local(i).vehicle)
        everything.add(i, [table.column(c) for c in range(1, len(table))])
    assert {gossip.bound.value for gossip in gossips} == {gossips[0].bound.value}
    assert gossips[0].bound.value == pytest.approx(
        everything.relax(team[0].penalty).value
    )
    assert min(gossips[0].bound.least.values()) < -1.0, (
        "one more of a kind would help, so its number counts"
    )
    found, apart = (
        solve_in_loop(instance, graph("ring", 6), m)
        for m in ("columns", "resource-columns")
    )
    assert found.cost == pytest.approx(apart.cost)
    assert found.bound_exact
    assert found.lower_bound == pytest.approx(found.cost, abs=1e-4)


def test_the_passes_of_a_bound_end_sooner_for_a_plan_that_is_far_from_it(
    graph, monkeypatch
):
    instance = random_instance(4, 7, 2, InstanceShape(route_length_limit=27.0))
    links = graph("ring", 4)
    plan = [(0, RouteColumn(90.0, (0, 1)))]
    priced = LargeBound._priced
    calls = []
    monkeypatch.setattr(
        LargeBound, "_priced", lambda self, pi: calls.append(pi) or priced(self, pi)
    )
    found = []
    for share in (0.0, 0.1):
        calls.clear()
        passes = large_bound.BoundPasses(final_share=share)
        monkeypatch.setattr(large_bound, "BOUND_PASSES", passes)
        team = [LargeBound(member, plan) for member in members(instance, links)]
        run_all([bound.run() for bound in team], links)
        found.append((len(calls), team[0].value))
    (calls_exact, exact), (calls_early, early) = found
    assert calls_early < calls_exact
    assert exact - 0.1 * (90.0 - early) - 1e-4 * exact <= early <= exact + 1e-9


def test_a_plan_that_leaves_tasks_out_is_as_far_from_the_bound_as_it_costs(graph):
    shape = InstanceShape(route_length_limit=27.0, fields={"penalty": [40.0] * 7})
    instance = random_instance(4, 7, 2, shape)
    plan = [(0, RouteColumn(90.0, (0, 1)))]
    member = members(instance, graph("ring", 4))[0]
    gap = LargeBound(member, plan)._final_gap(100.0, 80.0)
    assert gap == pytest.approx(0.01 * (90.0 + 5 * 40.0 - 80.0))


@pytest.mark.parametrize(
    ("most", "least", "below"), [(15, 1.5, 1.61), (3, 0.25, 0.4), (200, 8.0, 8.0)]
)
def test_the_widest_gap_with_few_columns_is_found_where_one_robot_has_too_many(
    most, least, below
):
    """The robot has a column every 0.1 m above the bound."""

    def near(gap, most):
        found = [RouteColumn(0.1 * k, (0,)) for k in range(1, 200) if 0.1 * k <= gap]
        return found if len(found) <= most else None

    member = SimpleNamespace(
        tolerance=lambda value: 1e-6, place=SimpleNamespace(robot=0, diameter=0)
    )
    bound = Bound(100.0, np.zeros(1), least={0: 0.0})
    search = find_fitting_gap(bound, member, near, (1.0, 8.0), most)
    with pytest.raises(StopIteration) as end:
        next(search)
    assert least <= end.value.value <= below
    assert len(near(end.value.value, most)) <= most


@pytest.mark.parametrize(("seed", "most"), [(1, 10), (2, 6), (2, 20)])
def test_a_proof_that_looks_only_at_plans_near_the_bound_is_right(
    graph, monkeypatch, seed, most
):
    """The plan is so poor that few columns are enough for the bound, or for a better plan."""
    searched = []
    find = proof.find_partition

    def follow(*arguments, **options):
        searched.append(options["below"])
        return find(*arguments, **options)

    monkeypatch.setattr(proof, "find_partition", follow)
    shape = InstanceShape(capable=0.8, route_length_limit=30.0)
    instance = random_instance(4, 6, seed, shape)
    poor = RoutingSettings(
        columns=ColumnSettings(most_listed=0),
        search=SearchSettings(starters=1, first_steps=2, steps=1),
        proof=ProofSettings(prove=True, most_proven=most, dives=0),
    )
    best = cheapest_of_all_plans(instance)
    found = solve_in_loop(instance, graph("ring", 4), settings=poor)
    assert min(searched) < np.inf
    assert 0.99 * best <= found.lower_bound <= best + 1e-6 <= found.cost + 2e-6


PRIORITY = {"priority": [0, 1, 0, 0, 2], "penalty": [None, 3, None, 4, 3]}


@pytest.mark.parametrize(
    ("fields", "method", "columns", "has_bound"),
    [
        ({}, "columns", ColumnSettings(), True),
        ({}, "resource-columns", ColumnSettings(most_labels=80), False),
        ({"objective": ["vehicles", "total"]}, "columns", ColumnSettings(), False),
        ({"objective": ["makespan"]}, "columns", ColumnSettings(), False),
        (PRIORITY, "columns", ColumnSettings(), False),
    ],
)
def test_a_bound_that_is_shown_while_a_team_works_is_one_on_its_cost(
    graph, fields, method, columns, has_bound
):
    shape = InstanceShape(route_length_limit=30.0, fields=fields)
    instance = random_instance(3, 5, 1, shape)
    ring = graph("ring", 3)
    agents = make_team(instance, ring, method, RoutingSettings(columns=columns))
    shown = []
    while not all(agent.done for agent in agents.values()):
        messages = {i: agent.message() for i, agent in agents.items()}
        for i, agent in agents.items():
            agent.step({j: messages[j] for j in ring[i]})
            shown.append(agent.progress.bound)
    cost = sum(agent.solution.cost for agent in agents.values()) / len(agents)
    bounds = [bound for bound in shown if bound is not None]
    assert bool(bounds) is has_bound
    assert all(bound <= cost + 1e-6 for bound in bounds)
