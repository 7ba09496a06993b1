"""The joint problem of a cluster, solved by one of its leaders; and the cost of a route."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from crazychoir.routing.distributed.clusters import Cluster, Stops, list_served_tasks
from crazychoir.routing.instance.instance import LocalProblem, Tasks
from crazychoir.routing.instance.vehicle import OBJECTIVE_NAMES
from crazychoir.routing.search.search import (
    SEARCH_DEFAULTS,
    SearchOptions,
    search_plan,
)
from crazychoir.types import Ints, Vec


def reoptimize_cluster(
    robots: Mapping[int, LocalProblem],
    routes: Stops,
    cluster: Cluster,
    penalty: Vec,
    steps: int,
    seed: int,
    options: SearchOptions = SEARCH_DEFAULTS,
) -> dict[int, list[int]]:
    """Search for better routes of the cluster's robots, starting from the present routes.

    robots: the problems of all robots.
    routes: the present routes.
    cluster: robots and tasks of the joint problem.
    penalty: (M,) cost of leaving a task out.
    steps: search steps.
    seed: of the search.
    options: parameters of the search.
    """
    chosen = np.array(cluster.tasks, dtype=np.int64)
    first = robots[cluster.robots[0]]
    few = first.tasks.only(chosen)
    fleet = [restrict_problem(robots[i], chosen, few).vehicle for i in cluster.robots]
    inner = _map_into_part(chosen, len(penalty))
    present = [[inner[s] for s in routes.get(i, ())] for i in cluster.robots]
    found = search_plan(
        fleet,
        present,
        penalty[chosen],
        steps,
        seed,
        objective=first.objective,
        options=options,
    )
    return {
        i: rename_nodes(stops, chosen, len(penalty))
        for i, stops in zip(cluster.robots, found.routes, strict=True)
    }


def restrict_problem(
    local: LocalProblem, chosen: Ints, few: Tasks | None = None
) -> LocalProblem:
    """Return the problem of the same robot with the tasks `chosen` alone, (K,) in any order.

    few: these tasks, if they are already at hand: robots with the same object share its distances.
    """
    m = len(local.tasks)
    nodes = np.concatenate([chosen, m + chosen, [2 * m]])
    return replace(
        local,
        tasks=local.tasks.only(chosen) if few is None else few,
        capable=local.capable[chosen],
        aboard=None if local.aboard is None else local.aboard[chosen],
        distance=None
        if local.distance is None
        else local.distance[np.ix_(nodes, nodes)],
    )


def bound_saving(robots: Mapping[int, LocalProblem], reach: float) -> float:
    """Return more than any plan of these robots could save by leaving a task out.

    It is an upper bound on the cost of the most expensive plan:

        1 + (3M + 2N) reach + N fixed + sum of refusals
        if finish times count, plus
            the last opening + all service + (3M + 2N) reach / the least speed

    reach: m, upper bound on the distance between two places. Each trip serves a task, so there are
        at most 3M + N legs. A robot in flight that stays there saves its way home, at most reach.
    """
    one = next(iter(robots.values()))
    n = len(robots)
    tasks = one.tasks
    ways = (3 * len(one.tasks) + 2 * n) * reach
    saved = 1.0 + ways + n * max(r.fixed for r in robots.values())
    saved += math.fsum(tasks.refusal[np.isfinite(tasks.refusal)])
    if OBJECTIVE_NAMES.makespan in one.objective:
        opens = max(
            float(tasks.earliest.max(initial=0.0)),
            *(max(r.window[0], r.start_time) for r in robots.values()),
        )
        saved += (
            opens
            + math.fsum(tasks.service)
            + ways / min(r.speed for r in robots.values())
        )
    return saved


def measure_route(local: LocalProblem, stops: Sequence[int]) -> tuple[float, float]:
    """Return the distance with the fixed cost in m, and the finish time in s, of a route.

    If vehicles are counted first, the distance excludes the fixed cost. Only the tasks of the route
    are looked at.
    """
    if not len(stops):
        return 0.0, 0.0
    m = len(local.tasks)
    chosen = np.array(list_served_tasks(stops, m), dtype=np.int64)
    inner = _map_into_part(chosen, m)
    vehicle = restrict_problem(local, chosen).vehicle
    route = [inner[s] for s in stops]
    fixed = 0.0 if OBJECTIVE_NAMES.vehicles in local.objective else vehicle.fixed
    return vehicle.length(route) + fixed, vehicle.finish(route)


def rename_nodes(stops: Sequence[int], chosen: Ints, m: int) -> list[int]:
    """Return nodes of the problem of the tasks `chosen` as nodes of the problem of m tasks."""
    outer = _map_into_whole(chosen, m)
    return [outer[s] for s in stops]


def _map_into_part(chosen: Ints, m: int) -> dict[int, int]:
    """Return the map from nodes of the whole problem to nodes of the part."""
    return {v: k for k, v in _map_into_whole(chosen, m).items()}


def _map_into_whole(chosen: Ints, m: int) -> dict[int, int]:
    """Return the map from nodes of the part to nodes of the whole problem."""
    return dict(enumerate([*chosen.tolist(), *(m + chosen).tolist(), 2 * m, 2 * m + 1]))
