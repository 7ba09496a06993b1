"""The arc-flow model and route tables agree on the optimum of instances with every field."""

import math
from dataclasses import replace
from itertools import product

import numpy as np
import pytest

from crazychoir.routing.instance.checker import check_plan
from crazychoir.routing.instance.generate import InstanceShape, random_instance
from crazychoir.routing.instance.instance import Instance
from crazychoir.routing.pricing.arc_flow import solve_compact
from crazychoir.routing.pricing.route_table import RouteTable


def best_of(instance, vehicles, objective):
    """(first, second) of the best choice of one column a robot, each task once or refused; second nan where unknown."""
    m, refusal = len(instance.tasks), instance.tasks.refusal
    tables = [RouteTable(v, objective=objective) for v in vehicles]
    best = (math.inf, math.inf)
    for choice in product(*(range(len(table)) for table in tables)):
        served = [
            j
            for table, c in zip(tables, choice, strict=True)
            for j in table.column(c).tasks
        ]
        left = [j for j in range(m) if j not in served]
        if len(set(served)) < len(served) or not all(
            np.isfinite(refusal[j]) for j in left
        ):
            continue
        first = [
            float(table.length[c]) for table, c in zip(tables, choice, strict=True)
        ]
        second = [
            float(table.second[c]) for table, c in zip(tables, choice, strict=True)
        ]
        fold = (sum, max) if objective[0] == "total" else (max, sum)
        best = min(
            best, (fold[0](first) + sum(refusal[j] for j in left), fold[1](second))
        )
    return best


def optimum(instance):
    """The values of the best plan, from tables alone."""
    vehicles = [instance.local(i).vehicle for i in range(instance.robots)]
    first, second = best_of(instance, vehicles, instance.objective)
    if instance.objective != ("makespan", "total"):
        return (first, second)[: len(instance.objective)]
    assert not np.isfinite(
        instance.tasks.refusal
    ).any()  # else the time that is left would depend on the refusals
    in_time = [
        replace(v, latest=np.array([*v.latest[:-1], min(v.latest[-1], first + 1e-7)]))
        for v in vehicles
    ]
    return first, best_of(instance, in_time, ("total",))[0]


def drawn(seed, robots, tasks, fields, **options):
    """A random instance with more fields, each made by a function of a random generator, N and M."""
    draw = np.random.default_rng(seed)
    raw = random_instance(robots, tasks, seed, InstanceShape(**options)).to_json()
    return Instance.parse(
        raw | {key: make(draw, robots, tasks) for key, make in fields.items()},
        f"drawn {seed}",
    )


def windows(draw, n, m):
    opened = draw.uniform(0, 20, size=(2, m))
    spans = [
        [[a, a + w] for a, w in zip(row, draw.uniform(8, 30, size=m), strict=True)]
        for row in opened
    ]
    return {
        "pickup": spans[0],
        "delivery": [[a, b + 25] for a, b in spans[1]],
        "home": [[0, 120]] * n,
    }


def matrix(draw, n, m):
    return draw.uniform(1, 12, size=(n + 2 * m, n + 2 * m)).tolist()


def matrices(draw, n, m):
    return [matrix(draw, n, m) for _ in range(n)]


def some_penalties(draw, n, m):
    return [None if j % 2 else float(draw.uniform(3, 15)) for j in range(m)]


CASES = {
    "plain": ({}, {}),
    "three dimensions, capability": ({}, {"room": (4, 4, 2), "capable": 0.6}),
    "clusters": ({"home": lambda d, n, m: [[0.1 * i, 5.0] for i in range(n)]}, {}),
    "open tours": ({"open_tours": lambda d, n, m: True}, {"capable": 0.7}),
    "ends": (
        {"end": lambda d, n, m: [None, *d.uniform(0, 10, size=(n - 1, 2)).tolist()]},
        {"route_length_limit": 45.0},
    ),
    "matrix": ({"distance": matrix}, {"route_length_limit": 40.0}),
    "matrices": ({"distance": matrices, "open_tours": lambda d, n, m: True}, {}),
    "windows": (
        {
            "time_windows": windows,
            "service_time": lambda d, n, m: 1.5,
            "penalty": some_penalties,
        },
        {},
    ),
    "windows in matrices": (
        {
            "time_windows": windows,
            "distance": matrices,
            "penalty": lambda d, n, m: [12.0] * m,
        },
        {"route_length_limit": 50.0},
    ),
    "releases and speeds": (
        {
            "release": lambda d, n, m: d.uniform(0, 30, size=m).tolist(),
            "speed": lambda d, n, m: d.uniform(0.5, 2, size=n).tolist(),
            "objective": lambda d, n, m: "makespan",
        },
        {},
    ),
    "total, then makespan": (
        {
            "objective": lambda d, n, m: ["total", "makespan"],
            "release": lambda d, n, m: d.uniform(0, 30, size=m).tolist(),
        },
        {},
    ),
    "makespan, then total": (
        {
            "objective": lambda d, n, m: ["makespan", "total"],
            "service_time": lambda d, n, m: {
                "pickup": d.uniform(0, 3, size=m).tolist()
            },
        },
        {},
    ),
    "loaded": (
        {
            "initial_load": lambda d, n, m: [1.0, *[0.0] * (n - 1)],
            "penalty": some_penalties,
        },
        {},
    ),
    "priorities": (
        {
            "penalty": lambda d, n, m: [4.0] * m,
            "priority": lambda d, n, m: [j % 3 for j in range(m)],
            "time_windows": lambda d, n, m: {"home": [[0, 22]] * n},
        },
        {},
    ),
    "penalised makespan": (
        {"penalty": lambda d, n, m: [5.0] * m, "objective": lambda d, n, m: "makespan"},
        {},
    ),
    "trips": (
        {"recharge": lambda d, n, m: 2},
        {"route_length_limit": 30.0, "capable": 0.5},
    ),
    "trips in windows": (
        {
            "recharge": lambda d, n, m: 2,
            "time_windows": windows,
            "penalty": lambda d, n, m: [20.0] * m,
        },
        {"route_length_limit": 32.0},
    ),
    "fixed cost": ({"fixed_cost": lambda d, n, m: 9.0}, {}),
}


@pytest.mark.parametrize("seed", [1, pytest.param(2, marks=pytest.mark.slow)])
@pytest.mark.parametrize(
    "case",
    [
        pytest.param(case, marks=pytest.mark.slow)
        if case == "makespan, then total"
        else case
        for case in CASES
    ],
)
def test_the_arc_flow_model_and_route_tables_have_the_same_optimum(case, seed):
    fields, options = CASES[case]
    instance = drawn(seed, 2, 3, fields, **options)
    plan = solve_compact(instance)
    assert check_plan(instance, plan) == []
    tasks = instance.tasks
    weighed = plan.values[0] + sum(
        tasks.refusal[j] - tasks.penalty[j] for j in refused(plan, instance)
    )
    assert (weighed, *plan.values[1:]) == pytest.approx(optimum(instance), abs=2e-5)


def refused(plan, instance):
    served = [j for route in plan.routes for j in route.tasks]
    return [j for j in range(len(instance.tasks)) if j not in served]


def test_tasks_are_refused_by_increasing_priority():
    """Time for one task alone: the one of the highest priority is served, however cheap it is to refuse."""
    points = {
        "pickup": [[1.0, 0.0], [-1.0, 0.0], [0.0, 1.0]],
        "delivery": [[2.0, 0.0], [-2.0, 0.0], [0.0, 2.0]],
    }
    raw = {
        "home": [[0.0, 0.0]],
        **points,
        "load": [1.0] * 3,
        "capacity": [1.0],
        "route_length_limit": 5.0,
    }
    plan = solve_compact(
        Instance.parse(raw | {"penalty": [9.0, 1.0, 5.0], "priority": [0, 2, 1]})
    )
    assert [route.tasks for route in plan.routes] == [(1,)]
    assert plan.cost == 4.0 + 9.0 + 5.0
    cheap = solve_compact(Instance.parse(raw | {"penalty": [3.0, 1.0, 2.0]}))
    assert cheap.routes == ()
    assert cheap.cost == 6.0
