"""The joint problem of a cluster, solved by one of its leaders; and what a route costs."""

import math
from collections.abc import Mapping, Sequence

import numpy as np

from crazychoir.routing.distributed.clusters import Cluster, Stops, tasks_of
from crazychoir.routing.distributed.robot_profile import restricted
from crazychoir.routing.instance.instance import LocalProblem
from crazychoir.routing.instance.vehicle import MAKESPAN, VEHICLES
from crazychoir.routing.search.search import search
from crazychoir.types import Ints, Vec


def reoptimize(
    robots: Mapping[int, LocalProblem],
    routes: Stops,
    cluster: Cluster,
    penalty: Vec,
    steps: int,
    seed: int,
) -> dict[int, list[int]]:
    """The routes of the cluster's robots that the search finds from the present ones.

    penalty: (M,) cost of leaving a task out.
    """
    chosen = np.array(cluster.tasks, dtype=np.int64)
    fleet = [restricted(robots[i], chosen).vehicle for i in cluster.robots]
    inner = _inner(chosen, len(penalty))
    present = [[inner[s] for s in routes.get(i, ())] for i in cluster.robots]
    objective = robots[cluster.robots[0]].objective
    found = search(fleet, present, penalty[chosen], steps, seed, objective=objective)
    return {
        i: renamed(stops, chosen, len(penalty))
        for i, stops in zip(cluster.robots, found.routes, strict=True)
    }


def most_saved(robots: Mapping[int, LocalProblem], reach: float) -> float:
    """More than a plan of these robots could save by leaving a task out: what the dearest one costs.

        1 + (3M + 2N) reach + N fixed + sum of refusals;   where finishes count, also the last opening + all service
                                                          + (3M + 2N) reach / the least speed

    reach: m, at least any way. Each trip serves a task, so that there are at most 3M + N ways; a robot in flight that
    stays there saves its way home, at most reach.
    """
    one = next(iter(robots.values()))
    n = len(robots)
    tasks = one.tasks
    ways = (3 * len(one.tasks) + 2 * n) * reach
    saved = 1.0 + ways + n * max(r.fixed for r in robots.values())
    saved += math.fsum(tasks.refusal[np.isfinite(tasks.refusal)])
    if MAKESPAN in one.objective:
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


def flown(local: LocalProblem, stops: Sequence[int]) -> tuple[float, float]:
    """m and s: distance with the fixed cost, and when it is done, of a route; only what it touches is looked at.

    Where vehicles are counted first, the distance alone.
    """
    if not len(stops):
        return 0.0, 0.0
    m = len(local.tasks)
    chosen = np.array(tasks_of(stops, m), dtype=np.int64)
    inner = _inner(chosen, m)
    vehicle = restricted(local, chosen).vehicle
    route = [inner[s] for s in stops]
    fixed = 0.0 if VEHICLES in local.objective else vehicle.fixed
    return vehicle.length(route) + fixed, vehicle.finish(route)


def renamed(stops: Sequence[int], chosen: Ints, m: int) -> list[int]:
    """Nodes of the part with the tasks `chosen` as nodes of the whole problem of m tasks."""
    outer = _outer(chosen, m)
    return [outer[s] for s in stops]


def _inner(chosen: Ints, m: int) -> dict[int, int]:
    """Nodes of the whole problem -> nodes of the part."""
    return {v: k for k, v in _outer(chosen, m).items()}


def _outer(chosen: Ints, m: int) -> dict[int, int]:
    """Nodes of the part -> nodes of the whole problem."""
    return dict(enumerate([*chosen.tolist(), *(m + chosen).tolist(), 2 * m, 2 * m + 1]))
