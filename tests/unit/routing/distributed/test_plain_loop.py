import json
import os
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest

from crazychoir.bus.codec import MAX_PAYLOAD, decode, encode
from crazychoir.errors import ConfigError, SolverError
from crazychoir.routing.distributed import column_recovery, gossip
from crazychoir.routing.distributed.bound import improve_bound
from crazychoir.routing.distributed.distributed_columns import DistributedColumns
from crazychoir.routing.distributed.master import PartitionProblem, find_partition
from crazychoir.routing.distributed.member import (
    ColumnSettings,
    PriceSettings,
    ProofSettings,
    RoutingSettings,
    SearchSettings,
)
from crazychoir.routing.distributed.pickup_delivery import (
    CLAIM_METHODS,
    PLANNING_METHODS,
    PRICE_METHODS,
    PickupDelivery,
)
from crazychoir.routing.distributed.plain_loop import (
    compute_diameter,
    join_solutions,
    make_team,
    solve_in_loop,
)
from crazychoir.routing.distributed.proof import TaskPartition
from crazychoir.routing.instance.checker import check_plan
from crazychoir.routing.instance.generate import InstanceShape, random_instance
from crazychoir.routing.instance.instance import Instance
from crazychoir.routing.pricing.packing import pack_columns
from crazychoir.routing.pricing.route_table import RouteColumn, RouteTable
from crazychoir.team.round import Round

BENCHMARKS = [
    "pdvrp_opt_N3_M3_s1",
    "pdvrp_opt_N5_M5_s1",
    "pdvrp_opt_N5_M8_s1_R25",
    "pdvrp_opt_lab6_M10_s1",
    "pdvrp_opt_N10_M15_s1_R25",
]


@pytest.mark.parametrize("shape", ["ring", "complete"])
@pytest.mark.parametrize("name", BENCHMARKS)
def test_the_optimum_is_found_and_proven(reference_data, graph, name, shape):
    path = reference_data("pdvrp") / f"{name}.json"
    instance, optimum = Instance.load(path), json.loads(path.read_text())["optimum"]
    solution = solve_in_loop(instance, graph(shape, instance.robots))
    assert solution.feasible
    assert solution.cost == pytest.approx(optimum, abs=1e-6)
    assert solution.bound_exact
    assert optimum - 1e-4 <= solution.lower_bound <= solution.cost
    assert solution.rounds <= 200


@pytest.mark.parametrize("shape", ["ring", "path", "star"])
@pytest.mark.parametrize("name", ["flat", "limited", "room"])
def test_own_instances_on_other_graphs(small, graph, name, shape):
    instance, optimum = small(name)
    solution = solve_in_loop(instance, graph(shape, instance.robots))
    assert (solution.feasible, solution.cost) == (
        True,
        pytest.approx(optimum, abs=1e-6),
    )


def test_the_demo_flies_all_six_robots(repository, graph):
    path = repository / "agents" / "data" / "lab6.json"
    solution = solve_in_loop(Instance.load(path), graph("ring", 6))
    assert solution.cost == pytest.approx(json.loads(path.read_text())["optimum"])
    assert [route.robot for route in solution.routes] == [0, 1, 2, 3, 4, 5]


@pytest.mark.parametrize("method", ["resource", "resource-argmax"])
@pytest.mark.parametrize("seed", range(6))
def test_prices_and_claims_alone_end_in_a_feasible_plan_above_their_bound(
    graph, method, seed
):
    instance = random_instance(
        5, 7, seed, InstanceShape(capable=0.7, route_length_limit=45.0)
    )
    solution = solve_in_loop(instance, graph("ring", 5), method)
    best = solve_in_loop(instance, graph("ring", 5))
    assert check_plan(instance, solution.plan) == []
    assert solution.lower_bound <= best.cost + 1e-6
    assert best.cost <= solution.cost + 1e-6
    assert not any("columns" in word for word in solution.disclosed)


def three_robots_and_four_tasks(random):
    counts = {"home": 3, "pickup": 4, "delivery": 4}
    return {
        key: random.uniform(0.0, 5.0, (n, 2)).tolist() for key, n in counts.items()
    } | {"load": [1.0] * 4}


@pytest.mark.parametrize(
    ("method", "seed"), [("resource", 0), ("resource", 7), ("resource-argmax", 14)]
)
def test_the_winner_keeps_a_part_of_a_set_that_is_too_long_without_a_detour(
    graph, method, seed
):
    random, n = np.random.default_rng(seed), 11
    places = three_robots_and_four_tasks(random)
    short = random.uniform(0.0, 1.0, (3, n, n)) < 0.3
    ways = np.where(
        short, random.uniform(0.1, 1.0, (3, n, n)), random.uniform(4.0, 9.0, (3, n, n))
    )
    raw = places | {
        "capacity": [4.0] * 3,
        "route_length_limit": 9.0,
        "distance": ways.tolist(),
    }
    assert solve_in_loop(Instance.parse(raw), graph("path", 3), method).feasible


@pytest.mark.parametrize(
    ("method", "names_only"), [("resource", True), ("resource-argmax", False)]
)
def test_claims_by_name_tell_no_share(small, graph, method, names_only):
    instance, _ = small("limited")
    bids = []

    def listen(message):
        _, content = message
        bids.extend(bid for bid in content if isinstance(bid, list) and len(bid) == 3)
        return message

    solve_in_loop(instance, graph("ring", 4), method, carry=listen)
    assert bids
    assert all(amount == -float(robot) for _, amount, robot in bids) == names_only


@pytest.mark.parametrize("method", PLANNING_METHODS)
def test_messages_are_plain_values_and_the_codec_changes_nothing(small, graph, method):
    instance, _ = small("limited")
    plain = solve_in_loop(instance, graph("ring", 4), method)
    coded = solve_in_loop(
        instance,
        graph("ring", 4),
        method,
        carry=lambda message: decode(encode(message)),
    )
    assert coded == plain


@pytest.mark.parametrize("method", PLANNING_METHODS)
def test_the_order_of_the_agents_changes_nothing(small, graph, method):
    instance, _ = small("limited")
    agents = make_team(instance, graph("path", 4), method)
    plain = solve_in_loop(instance, graph("path", 4), method)
    order = [2, 0, 3, 1]
    while not agents[0].done:
        messages = {i: agents[i].message() for i in order}
        for i in order:
            agents[i].step({j: messages[j] for j in reversed(graph("path", 4)[i])})
    assert all(agent.done for agent in agents.values())
    assert join_solutions(instance, [agents[i].solution for i in order]) == plain


def test_all_robots_know_the_same_digest_cost_and_bound_but_only_their_own_route(
    small, graph
):
    instance, _ = small("limited")
    agents = make_team(instance, graph("ring", 4))
    assert all(isinstance(agent, Round) and agent.heavy for agent in agents.values())
    while not all(agent.done for agent in agents.values()):
        messages = {i: agent.message() for i, agent in agents.items()}
        assert len({agent.done for agent in agents.values()}) == 1
        for i, agent in agents.items():
            agent.step({j: messages[j] for j in graph("ring", 4)[i]})
    solutions = [agent.solution for agent in agents.values()]
    assert (
        len({(s.plan_digest, s.cost, s.lower_bound, s.rounds) for s in solutions}) == 1
    )
    for i, solution in enumerate(solutions):
        assert all(route.robot == i for route in solution.routes)
    assert {agent.progress.phase for agent in agents.values()} == {"done"}
    with pytest.raises(SolverError, match="digest"):
        join_solutions(
            instance, [replace(solutions[0], plan_digest="0" * 64), *solutions[1:]]
        )


def test_the_hash_seed_changes_nothing(repository):
    file = repository / "tests" / "data" / "pickup_delivery_limited.json"
    ring_of_four = [[1, 3], [0, 2], [1, 3], [2, 0]]
    code = (
        "from crazychoir.routing.distributed.plain_loop import Instance, solve_in_loop;"
        f"s = solve_in_loop(Instance.load(r'{file}'), dict(enumerate({ring_of_four})));"
        "print([s.plan_digest, s.cost, s.lower_bound, s.rounds])"
    )
    other = os.environ | {
        "PYTHONHASHSEED": "2" if os.environ.get("PYTHONHASHSEED") == "1" else "1"
    }
    said = subprocess.run(
        [sys.executable, "-c", code], env=other, capture_output=True, check=True
    ).stdout.decode()
    here = solve_in_loop(Instance.load(file), dict(enumerate(ring_of_four)))
    assert said == f"{[here.plan_digest, here.cost, here.lower_bound, here.rounds]}\n"


def test_one_robot_alone(graph):
    instance = random_instance(1, 4, seed=2, shape=InstanceShape(capacities=(5, 5)))
    for method in PLANNING_METHODS:
        solution = solve_in_loop(instance, {0: []}, method)
        assert solution.feasible
        assert len(solution.routes) == 1
        assert solution.lower_bound is None or solution.lower_bound <= solution.cost


WEAK = RoutingSettings(
    prices=PriceSettings(rounds=3),
    columns=ColumnSettings(batch=2, most_shared=20),
    proof=ProofSettings(first_gap=0.002),
)


@pytest.mark.parametrize("settings", [RoutingSettings(), WEAK], ids=["default", "weak"])
@pytest.mark.parametrize("seed", [18, 33, 39, 45, 52])
def test_where_the_relaxation_has_a_gap_the_widening_finds_what_enumeration_finds(
    graph, seed, settings
):
    robots, tasks, limit = 3 + seed % 4, 6 + seed % 5, (25, 32, 45)[seed // 3 % 3]
    instance = random_instance(
        robots,
        tasks,
        seed,
        InstanceShape(capable=(1, 0.8, 0.5)[seed % 3], route_length_limit=limit),
    )
    tables = [RouteTable(instance.local(i).vehicle) for i in range(robots)]
    columns = [
        (i, table.column(c))
        for i, table in enumerate(tables)
        for c in range(1, len(table))
    ]
    best = find_partition(PartitionProblem(columns, tasks), seed=0, nodes=10_000)
    solution = solve_in_loop(instance, graph("ring", robots), settings=settings)
    assert solution.cost == pytest.approx(best.cost, abs=1e-6)
    assert solution.lower_bound == pytest.approx(best.cost, abs=1e-3)


def infeasible():
    """Each task fits alone, both together do not, and there is one robot for them."""
    raw = {
        "pickup": [[1.0, 0.0], [9.0, 0.0]],
        "delivery": [[1.0, 0.0], [9.0, 0.0]],
        "load": [1.0, 1.0],
    }
    homes = {
        "home": [[5.0, 0.0], [5.0, 1.0]],
        "capacity": [1.0, 1.0],
        "route_length_limit": 9.0,
    }
    return Instance.parse(raw | homes | {"capability": [[True, True], [False, False]]})


WEIGHED = [
    {"objective": "makespan"},
    {"objective": ["makespan", "total"]},
    {"penalty": [5.0] * 4, "priority": [1, 2, 0, 0]},
]
"""What prices of tasks do not add up to."""


@pytest.mark.parametrize("method", PRICE_METHODS)
@pytest.mark.parametrize("more", WEIGHED)
def test_what_prices_do_not_add_up_to_is_refused_by_methods_of_prices(method, more):
    raw = three_robots_and_four_tasks(np.random.default_rng(1)) | {
        "capacity": [2.0] * 3
    }
    with pytest.raises(
        ConfigError,
        match=rf"method {method}: found .* the methods columns, cbba, auction\.",
    ):
        make_team(Instance.parse(raw | more), {0: [1], 1: [0, 2], 2: [1]}, method)
    for able in set(PLANNING_METHODS) - set(PRICE_METHODS):
        assert solve_in_loop(
            Instance.parse(raw | more), {0: [1], 1: [0, 2], 2: [1]}, able
        ).feasible


@pytest.mark.parametrize("method", PLANNING_METHODS)
def test_methods_that_cannot_refuse_a_task_say_so(method):
    """No robot can lift the last task. A method that can refuse a task leaves it out; other methods raise an error."""
    raw = three_robots_and_four_tasks(np.random.default_rng(1)) | {
        "capacity": [2.0] * 3
    }
    raw |= {"load": [1.0, 1.0, 1.0, 1000.0], "penalty": [None, None, None, 5.0]}
    if method in CLAIM_METHODS:
        said = rf"method {method}: found a finite penalty of task\(s\) 3, .* columns, resource-columns, cbba, auction\."
        with pytest.raises(ConfigError, match=said):
            make_team(Instance.parse(raw), {0: [1], 1: [0, 2], 2: [1]}, method)
    else:
        solution = solve_in_loop(
            Instance.parse(raw), {0: [1], 1: [0, 2], 2: [1]}, method
        )
        assert solution.feasible
        assert sorted(j for route in solution.routes for j in route.tasks) == [0, 1, 2]


@pytest.mark.parametrize(
    ("method", "more"),
    [
        *(
            (method, {"penalty": [0.5] * 4})
            for method in ("columns", "resource-columns")
        ),
        *(("columns", w) for w in WEIGHED),
    ],
)
def test_no_bound_is_above_the_optimum_where_tasks_are_refused_or_time_is_minimised(
    graph, method, more
):
    raw = three_robots_and_four_tasks(np.random.default_rng(1)) | {
        "capacity": [2.0] * 3,
        "route_length_limit": 25.0,
    }
    instance = Instance.parse(raw | more)
    solution = solve_in_loop(instance, graph("path", 3), method)
    assert solution.feasible
    assert (solution.lower_bound or 0.0) <= solve_in_loop(
        instance, graph("path", 3)
    ).cost + 1e-6
    assert solution.bound_exact == (solution.lower_bound is not None)
    assert solution.bound_exact == (more.keys() == {"penalty"})


@pytest.mark.parametrize("method", ["columns", "resource-columns"])
def test_a_bound_above_the_cost_is_an_error_and_not_clipped(graph, monkeypatch, method):
    def too_high(bound, *args):
        news = yield from improve_bound(bound, *args)
        bound.value += 7.0
        return news

    for module in (gossip, column_recovery):
        monkeypatch.setattr(module, "improve_bound", too_high)
    with pytest.raises(SolverError, match=r"bound .* above the cost .* of the plan"):
        solve_in_loop(
            random_instance(5, 8, 1, InstanceShape(route_length_limit=30.0)),
            graph("ring", 5),
            method,
        )


def test_an_infeasible_instance_is_a_clear_error():
    with pytest.raises(
        SolverError,
        match=r"^infeasible: no plan serves every task; each can be served alone",
    ):
        solve_in_loop(infeasible(), {0: [1], 1: [0]})
    with pytest.raises(SolverError, match="use the method columns"):
        solve_in_loop(infeasible(), {0: [1], 1: [0]}, "resource")


def test_robots_that_did_not_search_know_in_the_same_round_that_there_is_no_plan(graph):
    goods = {
        "pickup": [[x, 1] for x in range(6)],
        "delivery": [[x, 2] for x in range(6)],
        "load": [1] * 6,
    }
    raw = goods | {
        "home": [[x, 0] for x in range(4)],
        "capacity": [1] * 4,
        "route_length_limit": 6.8,
    }
    settings = RoutingSettings(
        search=SearchSettings(first_steps=50, steps=500), proof=ProofSettings(small=0)
    )
    agents, failed = (
        make_team(Instance.parse(raw), graph("ring", 4), "columns", settings),
        {},
    )
    while not failed:
        messages = {i: decode(encode(agent.message())) for i, agent in agents.items()}
        for i, agent in agents.items():
            try:
                agent.step({j: messages[j] for j in graph("ring", 4)[i]})
            except SolverError as error:
                failed[i] = str(error)
        assert not any(agent.done for agent in agents.values())
    assert sorted(failed) == [0, 1, 2, 3]
    assert all(
        "infeasible: no plan serves every task" in text for text in failed.values()
    )


def test_a_table_that_is_cut_gives_a_plan_without_a_bound(graph):
    shape = InstanceShape(route_length_limit=60.0)
    instance = random_instance(4, 6, seed=3, shape=shape)
    cut = RoutingSettings(columns=ColumnSettings(most_labels=200))
    for method in PLANNING_METHODS:
        solution = solve_in_loop(instance, graph("ring", 4), method, cut)
        assert (solution.feasible, solution.lower_bound, solution.bound_exact) == (
            True,
            None,
            False,
        )


def test_one_searcher_is_enough_for_a_large_search(small, graph):
    instance, optimum = small("limited")
    solution = solve_in_loop(
        instance,
        graph("ring", 4),
        settings=RoutingSettings(proof=ProofSettings(small=0, searchers=1)),
    )
    assert solution.cost == pytest.approx(optimum)


def test_columns_shared_a_few_at_a_time_still_prove_the_optimum(small, graph):
    instance, optimum = small("limited")
    solution = solve_in_loop(
        instance,
        graph("ring", 4),
        settings=RoutingSettings(
            prices=PriceSettings(rounds=3),
            columns=ColumnSettings(most_shared=1, batch=1),
        ),
    )
    assert solution.cost == pytest.approx(optimum)


def test_what_is_relayed_for_all_robots_together_fits_into_a_payload(small, graph):
    robots, columns = (
        50,
        [RouteColumn(1.0, tuple(range(20)))]
        * (RoutingSettings().columns.most_relayed // 50),
    )
    assert (
        len(encode([[i, [pack_columns(columns), False, False]] for i in range(robots)]))
        < MAX_PAYLOAD
    )
    instance, optimum = small("limited")
    whole = RoutingSettings(
        prices=PriceSettings(rounds=3), proof=ProofSettings(first_gap=10.0)
    )
    plain = solve_in_loop(instance, graph("star", 4), settings=whole)
    parted = solve_in_loop(
        instance,
        graph("star", 4),
        settings=replace(whole, columns=replace(whole.columns, most_relayed=4)),
    )
    assert parted.cost == plain.cost == pytest.approx(optimum)
    assert parted.rounds > plain.rounds, "one column of each robot in a message"


def test_neighbours_with_other_tasks_or_options_are_noticed(small):
    instance, _ = small("limited")
    other = Instance.parse(instance.to_json() | {"load": [1.0] * 5})
    for stranger in (
        PickupDelivery(other.local(1), [0], 4, 3, {0: 1}),
        PickupDelivery(instance.local(1), [0], 4, 3, {0: 1}, "resource"),
        PickupDelivery(
            instance.local(1),
            [0],
            4,
            3,
            {0: 1},
            settings=RoutingSettings(columns=ColumnSettings(batch=3)),
        ),
    ):
        me = PickupDelivery(instance.local(0), [1], 4, 3, {1: 1})
        with pytest.raises(
            ConfigError, match=r"robot 0: neighbour\(s\) 1: found another task list"
        ):
            me.step({1: stranger.message()})


def test_the_first_message_is_light_and_the_table_is_made_in_a_step(small):
    instance, _ = small("limited")
    agent = PickupDelivery(instance.local(0), [1], 4, 3, {1: 1}, "resource-columns")
    _, fingerprint = agent.message()
    assert isinstance(fingerprint, str)
    assert "table" not in vars(agent._member)
    agent.step({1: agent.message()})
    _, (mu, _) = agent.message()
    assert isinstance(mu, np.ndarray)
    assert agent.progress.phase == "prices"
    with pytest.raises(SolverError, match="not done in round 1"):
        _ = agent.solution


def test_a_damaged_plan_is_noticed(small, graph):
    instance, _ = small("limited")

    def damage(message):
        end, content = message
        if (
            isinstance(content, list)
            and len(content) == 5
            and isinstance(content[4], str)
        ):
            return [end, [*content[:2], [[9, [0]]], *content[3:]]]
        return message

    with pytest.raises(SolverError, match="its hash differs"):
        solve_in_loop(
            instance,
            graph("path", 4),
            carry=damage,
            settings=RoutingSettings(proof=ProofSettings(small=0, searchers=1)),
        )


@pytest.mark.parametrize(
    ("wrong", "text"),
    [
        ({0: [1], 1: []}, "one-way edge 0 -> 1"),
        ({0: [], 1: []}, "no path from 0 to \\[1\\]"),
        ({0: [1], 1: [0, 2]}, "one-way edge 1 -> 2"),
    ],
)
def test_a_graph_must_be_connected_and_undirected(wrong, text):
    with pytest.raises(ConfigError, match=text):
        compute_diameter(wrong)


def test_the_graph_must_be_of_the_robots_and_the_method_known(small, graph):
    instance, _ = small("limited")
    with pytest.raises(ConfigError, match="the robots 0 to 3"):
        solve_in_loop(instance, graph("ring", 5))
    with pytest.raises(
        ConfigError, match="resource-columns, resource, resource-argmax"
    ):
        solve_in_loop(instance, graph("ring", 4), "magic")


def test_diameters(graph):
    assert [
        compute_diameter(graph(shape, 6))
        for shape in ("ring", "complete", "path", "star")
    ] == [3, 1, 5, 2]


@pytest.mark.parametrize(
    ("plan", "what"), [({0: (0, 1), 1: (0,)}, "served twice"), ({0: (0,)}, "left out")]
)
def test_robots_with_different_plans_notice_it_all_in_the_same_round(
    graph, monkeypatch, plan, what
):
    """Each tells the route that it flies: whether these are one plan is seen of their tasks, not of a hash of them."""
    points = {
        key: [[0.0, y], [1.0, y]]
        for key, y in (("home", 0.0), ("pickup", 1.0), ("delivery", 2.0))
    }

    def run(self):
        yield None
        return TaskPartition(plan, None)

    monkeypatch.setattr(DistributedColumns, "run", run)
    agents = make_team(
        Instance.parse(points | {"load": [1.0] * 2, "capacity": [2.0] * 2}),
        graph("path", 2),
    )
    failed = []
    while not failed and not any(agent.done for agent in agents.values()):
        messages = {i: agent.message() for i, agent in agents.items()}
        for i, agent in agents.items():
            try:
                agent.step({1 - i: messages[1 - i]})
            except SolverError as error:
                failed.append(str(error))
    assert len(failed) == 2
    assert all(what in text for text in failed)


@pytest.mark.parametrize("method", ["resource", "resource-columns", "resource-argmax"])
def test_price_methods_refuse_routes_that_cannot_be_listed_before_computing(
    graph, method
):
    instance = random_instance(2, 15, 1)
    with pytest.raises(ConfigError, match="too many routes to list"):
        make_team(instance, graph("ring", 2), method)
