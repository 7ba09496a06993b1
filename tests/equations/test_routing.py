"""The equations of crazychoir/routing: prices are subgradients, shares are conserved, bounds are bounds."""

import numpy as np
import pytest

from crazychoir.routing.distributed.bound import Bound
from crazychoir.routing.distributed.columns import ColumnProgram
from crazychoir.routing.distributed.master import ColumnPool
from crazychoir.routing.distributed.member import (
    GraphPosition,
    PriceSettings,
    RoutingMember,
    RoutingSettings,
)
from crazychoir.routing.distributed.plain_loop import solve_in_loop
from crazychoir.routing.distributed.primal_decomposition import PriceRounds
from crazychoir.routing.instance.generate import InstanceShape, random_instance
from crazychoir.routing.instance.instance import Instance
from crazychoir.routing.pricing.bidirectional_pricing import HalfRoutes
from crazychoir.routing.pricing.route_table import RouteColumn, RouteTable

N, M = 4, 6
RING = {0: [1, 3], 1: [0, 2], 2: [1, 3], 3: [0, 2]}
PATH = {0: [1], 1: [0, 2], 2: [1, 3], 3: [2]}
DRAW = np.random.default_rng(7)


@pytest.fixture(scope="module")
def instance():
    return random_instance(
        N, M, seed=21, shape=InstanceShape(capable=0.8, route_length_limit=45.0)
    )


@pytest.fixture(scope="module")
def tables(instance):
    return [RouteTable(instance.local(i).vehicle) for i in range(N)]


@pytest.fixture(scope="module")
def relaxation(tables):
    """Value of the central relaxation over all columns."""
    pool = ColumnPool(M)
    for i, table in enumerate(tables):
        pool.add(i, (table.column(c) for c in range(1, len(table))))
    return pool.relax(np.full(M, 100.0)).value


def trade(instance, graph, span, settings):
    """Price rounds of all robots; returns them after the last round, with the sum of the shares of every round."""
    members = []
    for i in range(N):
        place = GraphPosition(
            i, N, tuple(graph[i]), span, {j: len(graph[j]) for j in graph[i]}
        )
        members.append(RoutingMember(instance.local(i), place, settings))
    agents = [PriceRounds(member) for member in members]
    programs = [agent.run() for agent in agents]
    messages, sums, ended = [next(program) for program in programs], [], []
    while not ended:
        sent = list(messages)
        for i, program in enumerate(programs):
            try:
                messages[i] = program.send({j: sent[j] for j in graph[i]})
            except StopIteration:
                ended.append(i)
        sums.append(sum(agent.y for agent in agents))
    assert ended == list(range(N))
    return agents, members, sums


def test_the_price_is_a_subgradient_of_the_local_value(tables):
    """p(z) >= p(y) + mu' (z - y), and mu is the slope where p is smooth."""
    for table in tables:
        program = ColumnProgram(table, np.full(M, 60.0))
        points = DRAW.uniform(-0.2, 0.8, size=(12, M))
        solved = [program.solve(y) for y in points]
        for y, at in zip(points, solved, strict=True):
            for z, there in zip(points, solved, strict=True):
                assert there.value >= at.value + at.mu @ (z - y) - 1e-6
            direction = DRAW.normal(size=M)
            step = 1e-6
            ahead, behind = (
                program.solve(y + s * step * direction).value for s in (1, -1)
            )
            assert (ahead - behind) / (2 * step) == pytest.approx(
                at.mu @ direction, rel=1e-3, abs=1e-3
            )


def test_prices_are_between_zero_and_the_penalty(tables):
    for table in tables:
        program = ColumnProgram(table, np.full(M, 15.0))
        for y in DRAW.uniform(-1, 2, size=(20, M)):
            mu = program.solve(y).mu
            assert mu.min() >= 0.0
            assert mu.max() <= 15.0


@pytest.mark.parametrize(("graph", "span"), [(RING, 2), (PATH, 3)])
def test_every_round_keeps_the_sum_of_the_shares(instance, graph, span):
    _, _, sums = trade(
        instance, graph, span, RoutingSettings(prices=PriceSettings(rounds=40))
    )
    assert len(sums) > 10
    np.testing.assert_allclose(sums, np.ones((len(sums), M)), atol=1e-12)


@pytest.mark.parametrize(("graph", "span"), [(RING, 2), (PATH, 3)])
def test_the_local_values_converge_to_the_central_relaxation(
    instance, tables, relaxation, graph, span
):
    values = []
    for rounds in (1, 400):
        agents, members, _ = trade(
            instance,
            graph,
            span,
            RoutingSettings(prices=PriceSettings(rounds=rounds, still=0.0)),
        )
        programs = [ColumnProgram(tables[i], members[i].penalty) for i in range(N)]
        values.append(
            sum(
                program.solve(agent.y).value
                for program, agent in zip(programs, agents, strict=True)
            )
        )
    assert relaxation - 1e-6 <= values[1] <= 1.05 * relaxation
    assert values[1] - relaxation < 0.3 * (values[0] - relaxation)


def test_all_robots_stop_in_the_same_round_when_shares_stand_still(instance):
    agents, _, _ = trade(
        instance, PATH, 3, RoutingSettings(prices=PriceSettings(rounds=300, still=0.02))
    )
    assert len({agent.rounds for agent in agents}) == 1
    assert agents[0].rounds < 300
    assert agents[0].rounds % 3 == 0


def test_any_common_price_bounds_the_optimum_and_excesses_add_up(instance, tables):
    """sum pi + sum min(0, least) <= cost of any plan - sum of the excesses of its columns."""
    solution = solve_in_loop(instance, RING)
    for _ in range(30):
        pi = DRAW.uniform(0, 20, size=M)
        least = [min(0.0, table.least(pi)) for table in tables]
        bound = pi.sum() + sum(least)
        assert bound <= solution.cost + 1e-9
        excess = -sum(least)
        for route in solution.routes:
            excess += route.length - pi[list(route.tasks)].sum()
        assert bound + excess == pytest.approx(solution.cost)


def test_a_reward_for_robots_that_leave_keeps_the_bound_and_the_excesses(instance):
    """n mu + sum pi + sum least <= cost of any plan of at least n robots, less the excesses of its columns."""
    fixed = Instance.parse(instance.to_json() | {"fixed_cost": 300.0})
    solution, tables = (
        solve_in_loop(fixed, RING),
        [RouteTable(fixed.local(i).vehicle) for i in range(N)],
    )
    n = len(solution.routes)
    for _ in range(30):
        pi, mu = DRAW.uniform(0, 200, size=M), DRAW.uniform(0, 300)
        least = {i: tables[i].least(pi, mu) for i in range(N)}
        assert list(least.values()) == [
            min(0.0, (t.reduced_costs(pi)[1:] - mu).min()) for t in tables
        ]
        bound = Bound(n * mu + pi.sum() + sum(least.values()), pi, mu, n, least)
        assert bound.value <= solution.cost + 1e-9
        flown = {
            route.robot: RouteColumn(route.length + 300.0, route.tasks)
            for route in solution.routes
        }
        excess = sum(
            bound.excess(i, flown.get(i, RouteColumn(0.0, ()))) for i in range(N)
        )
        assert bound.value + excess == pytest.approx(solution.cost)


def test_prices_sum_up_to_a_bound_with_the_least_of_all_routes_put_together_of_halves(
    instance, tables, relaxation
):
    """sum_j pi_j + sum_i least_i <= the relaxation for every pi >= 0, and equal at its own prices."""
    halves, pool = (
        [HalfRoutes(instance.local(i).vehicle) for i in range(N)],
        ColumnPool(M),
    )
    for i, table in enumerate(tables):
        pool.add(i, (table.column(c) for c in range(1, len(table))))
    at_its_own = pool.relax(np.full(M, 100.0)).prices
    assert at_its_own.sum() + sum(
        half.least(at_its_own) for half in halves
    ) == pytest.approx(relaxation)
    for pi in DRAW.uniform(0.0, 20.0, size=(20, M)):
        assert pi.sum() + sum(half.least(pi) for half in halves) <= relaxation + 1e-6
        drawn = 0.6 * at_its_own + 0.4 * pi
        assert (
            drawn.sum() + sum(half.least(drawn) for half in halves) <= relaxation + 1e-6
        )
