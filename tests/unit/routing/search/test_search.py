"""The search against a checker of simple loops, and against all ways to share the tasks."""

from dataclasses import replace
from itertools import product
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from crazychoir.routing.instance.generate import InstanceShape, random_instance
from crazychoir.routing.instance.instance import COMMON_OBJECTIVES, Instance
from crazychoir.routing.instance.legs import Legs
from crazychoir.routing.instance.vehicle import Vehicle
from crazychoir.routing.pricing.route_table import RouteTable
from crazychoir.routing.search.search import PlanSearch, SearchOptions, search_plan

SLACK = 1e-6
LI_LIM = Path(__file__).parents[5] / "shared" / "data" / "lilim"


def flown(v, route, left=()):
    """(length, finish) of a route; the assertions say what it breaks. left: tasks that it could not deliver."""
    m = len(v.load)
    at, t, length, trip, limit, trips = 2 * m, v.earliest[2 * m], 0.0, 0.0, v.limit, 1
    board = set(np.flatnonzero(v.aboard).tolist())
    for node in [*route, 2 * m + 1]:
        length, trip = length + v.distance[at, node], trip + v.distance[at, node]
        t = max(t + v.duration[at, node], v.earliest[node])
        assert t <= v.latest[node] + SLACK, "too late"
        assert trip <= limit + SLACK, "too far"
        if node < m:
            assert v.capable[node], "not capable"
            assert node not in board, "twice"
            board.add(node)
        elif node < 2 * m:
            board.remove(node - m)
        else:
            assert board <= set(left), "goods on board at the end of a trip"
            trip, limit, trips = 0.0, v.limit_again, trips + 1
        assert sum(v.load[j] for j in board) <= v.capacity + SLACK, "too heavy"
        at = node
    assert trips - 1 <= v.trips, "too many trips"
    return length, t


def check(vehicles, penalty, found):
    """Every task once, or unserved; the values are those of the routes. What is aboard must be delivered."""
    penalty = np.where(np.any([v.aboard for v in vehicles], axis=0), np.inf, penalty)
    m, served, cost, finish = len(penalty), [], 0.0, 0.0
    for v, route in zip(vehicles, found.routes, strict=True):
        if route:
            length, t = flown(v, route, found.unserved)
            cost, finish = cost + length + v.fixed, max(finish, t)
            served += [node - m for node in route if m <= node < 2 * m]
    assert sorted([*served, *found.unserved]) == list(range(m))
    assert found.total == pytest.approx(cost + sum(penalty[found.unserved]))
    assert found.finish == pytest.approx(finish)


def team_of(seed, robots, m, kind):
    """Random vehicles of one instance; kind: what is special about them."""
    draw = np.random.default_rng(seed)
    stops, team = draw.uniform(0, 10, size=(2 * m, 2)), []
    opening = np.where(draw.random(2 * m) < 0.7, draw.uniform(0, 15, size=2 * m), 0.0)
    closing = np.where(
        draw.random(2 * m) < 0.8, opening + draw.uniform(10, 40, size=2 * m), np.inf
    )
    load, carrier = draw.integers(1, 4, size=m).astype(float), np.full(m, -1)
    if "aboard" in kind:
        carrier[: min(m, robots) // 2 + 1] = draw.permutation(robots)[
            : min(m, robots) // 2 + 1
        ]
    for i in range(robots):
        points = np.vstack([stops, draw.uniform(0, 10, size=(2, 2))])
        distance = np.linalg.norm(points[:, None] - points[None, :], axis=2)
        if "matrix" in kind:
            distance = draw.uniform(0, 10, size=distance.shape)
        if "open" in kind:
            distance[:, -1] = 0.0
        duration = distance / draw.uniform(0.5, 2.0) + draw.uniform(0, 1)
        earliest, latest = np.zeros(2 * m + 2), np.full(2 * m + 2, np.inf)
        if "windows" in kind:
            earliest[: 2 * m], latest[: 2 * m] = opening, closing
            earliest[2 * m], latest[2 * m + 1] = (
                draw.uniform(0, 5),
                draw.uniform(40, 80),
            )
        team.append(
            Vehicle(
                Legs.of(distance),
                Legs.of(duration),
                earliest,
                latest,
                load,
                max(float(draw.integers(3, 7)), load[carrier == i].sum()),
                draw.uniform(20, 40) if "limit" in kind else np.inf,
                draw.random(m) < 0.8,
                carrier == i,
                fixed=draw.uniform(-2, 8),
                trips=int(draw.integers(1, 4)) if "trips" in kind else 1,
                limit_again=draw.uniform(20, 40) if "limit" in kind else np.inf,
                robot=i,
            )
        )
    return team


def optimum(team, penalty, objective):
    """The least values, in the order of the objective, over all ways to give each task to a robot or to none."""
    tables, m = [RouteTable(v, objective=objective) for v in team], len(penalty)
    worth = [
        {
            c.tasks: (c.length, table.second[n])
            for n, c in enumerate(map(table.column, range(len(table))))
        }
        for table in tables
    ]
    best = (np.inf, np.inf)
    for share in product(range(len(team) + 1), repeat=m):
        parts = [
            worth[i].get(tuple(j for j in range(m) if share[j] == i))
            for i in range(len(team))
        ]
        if None not in parts:
            refused = sum(penalty[j] for j in range(m) if share[j] == len(team))
            first, second = (np.array(values) for values in zip(*parts, strict=True))
            added = objective[0] == "total"
            best = min(
                best,
                (first.sum() + refused, second.max())
                if added
                else (first.max() + refused, second.sum()),
            )
    return best


KINDS = [
    "",
    "open limit",
    "windows",
    "windows limit",
    "aboard limit",
    "aboard windows open",
    "trips limit",
    "trips windows limit aboard",
]


@pytest.mark.parametrize(
    "kind", [*KINDS, "matrix limit", "matrix windows trips aboard"]
)
@settings(max_examples=8, deadline=None)
@given(st.integers(0, 10**6), st.sampled_from(COMMON_OBJECTIVES), st.booleans())
def test_plans_keep_all_limits(kind, seed, objective, refusable):
    team = team_of(seed, 5, 9, kind)
    penalty = (
        np.random.default_rng(seed).uniform(0, 30, size=9)
        if refusable
        else np.full(9, np.inf)
    )
    found = search_plan(team, [[]] * 5, penalty, 300, seed, objective=objective)
    check(team, penalty, found)
    if refusable:
        assert all(not v.aboard[j] for v in team for j in found.unserved) or np.isinf(
            found.total
        )


@pytest.mark.parametrize("kind", KINDS)
@settings(max_examples=6, deadline=None)
@given(st.integers(0, 10**6), st.sampled_from(COMMON_OBJECTIVES), st.booleans())
def test_small_plans_are_optimal(kind, seed, objective, refusable):
    team = team_of(seed, 3, 4, kind)
    penalty = (
        np.random.default_rng(seed).uniform(0, 30, size=4)
        if refusable
        else np.full(4, np.inf)
    )
    found, best = (
        search_plan(team, [[]] * 3, penalty, 2000, 1, objective=objective),
        optimum(team, penalty, objective),
    )
    if np.isinf(best[0]):
        assert np.isinf(found.total)
        return
    check(team, penalty, found)
    value = (
        found.total
        if objective[0] == "total"
        else found.finish + sum(penalty[found.unserved])
    )
    assert value == pytest.approx(best[0])


def test_ten_robots_are_near_the_proven_optimum(small):
    instance, best = small("limited")
    team = [instance.local(i).vehicle for i in range(instance.robots)]
    found = search_plan(team, [[]] * len(team), instance.tasks.penalty, 4000, 0)
    assert best - 1e-9 <= found.total <= 1.005 * best


def big():
    instance = random_instance(12, 24, 3, InstanceShape(route_length_limit=25.0))
    return [instance.local(i).vehicle for i in range(12)], instance.tasks.penalty


def seen(found):
    """(vehicle, cost, stops) of the routes in the pool."""
    pool, end = found.pool, 2 * 24 + 1
    return [
        (
            int(pool.vehicle[p]),
            float(pool.cost[p]),
            tuple(np.minimum(pool.stop[p, : pool.stops[p]], end).tolist()),
        )
        for p in np.flatnonzero(pool.vehicle >= 0)
    ]


def test_equal_seeds_give_equal_plans_and_another_seed_another_search():
    team, penalty = big()
    one, two, other = (
        search_plan(team, [[]] * 12, penalty, 2000, seed) for seed in (5, 5, 6)
    )
    assert one.routes == two.routes
    assert seen(one) == seen(two)
    assert seen(one) != seen(other)


def test_a_search_goes_on_from_a_plan_and_never_gives_back_a_worse_one():
    team, penalty = big()
    first = search_plan(team, [[]] * 12, penalty, 500, 1)
    assert search_plan(team, first.routes, penalty, 0, 1).routes == first.routes
    assert search_plan(team, first.routes, penalty, 500, 2).total <= first.total


def test_routes_that_break_a_limit_are_begun_anew():
    team, penalty = big()
    everything = [*range(24), *range(24, 48)]
    check(team, penalty, search_plan(team, [everything, *[[]] * 11], penalty, 0, 1))


def test_routes_seen_hold_the_plan_and_each_set_once():
    team, penalty = big()
    found = search_plan(team, [[]] * 12, penalty, 1000, 1)
    routes = seen(found)
    sets = [
        (vehicle, tuple(sorted(node for node in stops if node < 24)))
        for vehicle, _, stops in routes
    ]
    assert len(sets) == len(set(sets)) > 100
    for vehicle, cost, stops in routes:
        assert flown(team[vehicle], stops)[0] == pytest.approx(cost)
    assert {tuple(route) for route in found.routes if route} <= {
        stops for _, _, stops in routes
    }


def test_putting_routes_together_finds_more_than_the_same_steps_alone():
    team, penalty = big()
    alone = [
        search_plan(
            team, [[]] * 12, penalty, 1000, seed, options=SearchOptions(combines=False)
        ).total
        for seed in range(12)
    ]
    together = [
        search_plan(
            team, [[]] * 12, penalty, 1000, seed, options=SearchOptions(rounds=2)
        ).total
        for seed in range(12)
    ]
    assert np.mean(together) < np.mean(alone)


def test_a_task_that_no_vehicle_can_serve_is_reported_as_unserved():
    team, penalty = big()
    lame = [replace(v, capable=np.arange(24) != 7) for v in team]
    found = search_plan(lame, [[]] * 12, penalty, 100, 1)
    assert found.unserved == [7]
    assert np.isinf(found.total)


def identical(k):
    instance = random_instance(1, 8, 1, InstanceShape(capacities=(6, 6)))
    return [instance.local(0).vehicle] * k, instance.tasks.penalty


def test_fleet_steps_leave_out_what_is_not_needed():
    team, penalty = identical(5)
    spread = [[j, 8 + j, j + 4, 12 + j] if j < 4 else [] for j in range(5)]
    found = search_plan(
        team, spread, penalty, 100, 1, options=SearchOptions(fleet_steps=200)
    )
    check(team, penalty, found)
    assert sum(map(bool, found.routes)) == 1


def test_vehicles_that_cost_much_are_left_out_but_no_task_that_costs_more():
    team, _ = identical(5)
    penalty = np.where(np.arange(8) == 3, 0.5, 5000.0)
    dear = [replace(v, fixed=1000.0) for v in team]
    spread = [[j, 8 + j, j + 4, 12 + j] if j < 4 else [] for j in range(5)]
    found = search_plan(dear, spread, penalty, 200, 1)
    check(dear, penalty, found)
    assert sum(map(bool, found.routes)) == 1
    assert found.unserved == [3]


def test_vehicles_that_are_closed_stay():
    team, penalty = big()
    found = PlanSearch(team, penalty).run([[]] * 12, 500, 1, closed=[0, 3])
    check(team, penalty, found)
    assert found.routes[0] == found.routes[3] == []


def test_nothing_to_do():
    team, _ = big()
    none = [v.only(np.array([], np.int64)) for v in team]
    found = search_plan(none, [[]] * 12, np.array([]), 10, 1)
    assert (found.routes, found.unserved, found.total) == ([[]] * 12, [], 0.0)


@pytest.mark.skipif(
    not LI_LIM.exists(), reason="the instances of Li & Lim are not here"
)
@pytest.mark.parametrize(
    ("name", "vehicles", "distance"),
    [("lc101", 10, 828.94), ("lr101", 19, 1650.80), ("lrc101", 14, 1708.80)],
)
def test_the_best_known_plans_of_li_and_lim(name, vehicles, distance):
    instance = Instance.load(LI_LIM / f"{name}.txt")
    team, penalty = (
        [instance.local(i).vehicle for i in range(instance.robots)],
        instance.tasks.penalty,
    )
    found = search_plan(
        team,
        [[]] * len(team),
        penalty,
        20_000,
        1,
        options=SearchOptions(fleet_steps=20_000),
    )
    check(team, penalty, found)
    assert sum(map(bool, found.routes)) == vehicles
    assert (
        found.total
        - sum(v.fixed for v, route in zip(team, found.routes, strict=True) if route)
        < 1.01 * distance
    )
