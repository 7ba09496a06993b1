"""Route tables of vehicles with windows, trips, goods aboard and any matrices, against all orders of all stops."""

from itertools import combinations, permutations, product

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from crazychoir.errors import SolverError
from crazychoir.routing.instance.instance import COMMON_OBJECTIVES
from crazychoir.routing.instance.legs import Legs
from crazychoir.routing.instance.vehicle import Vehicle
from crazychoir.routing.pricing.route_table import RouteTable, find_shortest_route

SLACK = 1e-9


def flown(v, route):
    """Length and finish of a route as simple loops have it; None if it breaks a limit."""
    m = len(v.load)
    at, length, trip, t, trips, limit = 2 * m, 0.0, 0.0, v.earliest[2 * m], 1, v.limit
    board = [j for j in range(m) if v.aboard[j]]
    for node in [*route, 2 * m + 1]:
        length, trip = length + v.distance[at, node], trip + v.distance[at, node]
        t = max(t + v.duration[at, node], v.earliest[node])
        if trip > limit + SLACK or t > v.latest[node] + SLACK:
            return None
        if node < m:
            board.append(node)
        elif node < 2 * m:
            if node - m not in board:
                return None
            board.remove(node - m)
        elif board:
            return None
        else:
            trip, limit, trips = 0.0, v.limit_again, trips + 1
        if sum(v.load[j] for j in board) > v.capacity + SLACK:
            return None
        at = node
    return (length, t) if trips - 1 <= v.trips else None


def routes_of(v, tasks):
    """All orders of the stops of `tasks`, with stops at the end between any two where there may be trips."""
    m = len(v.load)
    stops = [j for j in tasks if not v.aboard[j]] + [m + j for j in tasks]
    for order in permutations(stops):
        for anew in product((False, True), repeat=len(order)) if v.trips > 1 else [()]:
            if sum(anew) < v.trips:
                yield [
                    n
                    for k, node in enumerate(order)
                    for n in ([2 * m + 1, node] if anew and anew[k] else [node])
                ]


def best_of_all(v, objective):
    """{tasks: (first, second)} over all routes."""
    m, found = len(v.load), {}
    for size in range(m + 1):
        for tasks in combinations(range(m), size):
            able = all(v.capable[j] or v.aboard[j] for j in tasks) and all(
                j in tasks for j in np.flatnonzero(v.aboard)
            )
            values = (
                [flown(v, route) for route in routes_of(v, tasks)]
                if able and tasks
                else []
            )
            values = [(length + v.fixed, t) for length, t in filter(None, values)]
            if values:
                found[tasks] = min(
                    x if objective[0] == "total" else x[::-1] for x in values
                )
    return found | ({} if v.aboard.any() else {(): (0.0, 0.0)})


def vehicle_of(seed, m, kind):
    """A random vehicle; kind: what is special about it."""
    draw = np.random.default_rng(seed)
    n = 2 * m + 2
    points = draw.uniform(0, 10, size=(n, 2))
    distance = np.linalg.norm(points[:, None] - points[None, :], axis=2)
    if "matrix" in kind:
        distance = draw.uniform(0, 10, size=(n, n))
    if "open" in kind:
        distance[:, n - 1] = 0.0
    duration = distance / draw.uniform(0.5, 2.0) + draw.uniform(0, 1, size=(n, 1)) * (
        draw.random() < 0.5
    )
    if "matrix" in kind:
        duration = duration * draw.uniform(0.5, 1.5, size=(n, n))
    earliest, latest = np.zeros(n), np.full(n, np.inf)
    if "windows" in kind:
        earliest = draw.uniform(0, 15, size=n) * (draw.random(n) < 0.7)
        latest = np.where(
            draw.random(n) < 0.8, earliest + draw.uniform(5, 40, size=n), np.inf
        )
        earliest[n - 1] = 0.0
        latest[2 * m] = np.inf
    if "release" in kind:
        earliest[:m] = draw.uniform(0, 30, size=m)
    aboard = draw.random(m) < 0.4 if "aboard" in kind else np.zeros(m, dtype=bool)
    load = draw.integers(1, 4, size=m).astype(float)
    return Vehicle(
        Legs.of(distance),
        Legs.of(duration),
        earliest,
        latest,
        load,
        max(float(draw.integers(3, 8)), load[aboard].sum()),
        draw.uniform(10, 40) if "limit" in kind else np.inf,
        draw.random(m) < 0.9,
        aboard,
        fixed=draw.uniform(-2, 5),
        trips=int(draw.integers(2, 4)) if "trips" in kind else 1,
        limit_again=draw.uniform(10, 40) if "limit" in kind else np.inf,
    )


KINDS = [
    "plain",
    "limit",
    "open limit",
    "matrix limit",
    "windows",
    "windows matrix limit",
    "aboard limit",
    "aboard windows open",
    "trips limit",
    "trips limit aboard windows",
    "trips matrix limit",
    "release",
    "trips release limit matrix",
]


@pytest.mark.parametrize("kind", KINDS)
@settings(max_examples=12, deadline=None)
@given(st.integers(0, 10**6), st.sampled_from(COMMON_OBJECTIVES))
def test_a_table_holds_exactly_the_feasible_sets_with_their_best_routes(
    kind, seed, objective
):
    v = vehicle_of(seed, 2 if "trips" in kind else 3, kind)
    table, expected = RouteTable(v, objective=objective), best_of_all(v, objective)
    found = {
        table.column(c).tasks: (table.length[c], table.second[c])
        for c in range(len(table))
    }
    assert set(found) == set(expected)
    assert table.complete
    for tasks, (first, second) in expected.items():
        assert found[tasks][0] == pytest.approx(first, abs=1e-8)
        if len(objective) == 2:
            assert found[tasks][1] == pytest.approx(second, abs=1e-8)


@pytest.mark.parametrize("kind", KINDS)
@settings(max_examples=6, deadline=None)
@given(st.integers(0, 10**6), st.sampled_from(COMMON_OBJECTIVES))
def test_the_route_of_each_set_is_feasible_and_what_its_column_says(
    kind, seed, objective
):
    v = vehicle_of(seed, 3, kind)
    table = RouteTable(v, objective=objective)
    for c in range(len(table)):
        tasks = table.column(c).tasks
        nodes, length = find_shortest_route(v, tasks, objective)
        if not tasks:
            assert nodes == []
            continue
        real, finish = flown(v, nodes)
        assert (length, finish) == pytest.approx((real, v.finish(nodes)), abs=1e-8)
        assert v.length(nodes) == pytest.approx(real)
        assert table.length[c] == pytest.approx(
            finish if objective[0] == "makespan" else real + v.fixed, abs=1e-8
        )


def test_goods_aboard_are_in_every_column_and_must_be_delivered():
    v = vehicle_of(3, 3, "plain")
    carrying = Vehicle(
        **{**vars(v), "aboard": np.array([False, True, False]), "capacity": 9.0}
    )
    table = RouteTable(carrying)
    assert all(1 in table.column(c).tasks for c in range(len(table)))
    nodes, _ = find_shortest_route(carrying, [1])
    assert nodes == [4]
    with pytest.raises(SolverError, match=r"infeasible: it carries \[1\]"):
        find_shortest_route(carrying, [0])


def test_a_robot_away_from_home_may_recharge_first():
    line = np.array([0.0, 1.0, 9.0, 10.0])  # pickup, delivery, start, end
    distance = np.abs(line[:, None] - line[None, :])
    v = Vehicle(
        Legs.of(distance),
        Legs.of(distance),
        np.zeros(4),
        np.full(4, np.inf),
        np.ones(1),
        1.0,
        2.0,
        np.array([True]),
        np.array([False]),
        trips=2,
        limit_again=20.0,
    )
    assert find_shortest_route(v, [0]) == ([3, 0, 1], 21.0)
