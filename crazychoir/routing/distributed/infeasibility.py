"""Name the constraint that keeps a team from serving all tasks."""

import math
from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np

from crazychoir.routing.distributed.cluster_problem import reoptimize_cluster
from crazychoir.routing.distributed.clusters import Cluster, list_unserved_tasks
from crazychoir.routing.distributed.team_order import TeamOrder
from crazychoir.routing.instance.instance import LocalProblem
from crazychoir.types import Vec


def explain_missing_tasks(
    robots: Mapping[int, LocalProblem],
    order: TeamOrder,
    left_out: Vec,
    steps: int,
) -> str:
    """Return which constraint, if it were dropped, would leave the fewest tasks out.

    Each kind of constraint that the instance has is dropped alone, and a plan is searched from
    nothing. All robots find the same answer.

    robots: the problems of all robots.
    order: the order of robots and tasks.
    left_out: (M,) cost of leaving a task out.
    steps: search steps for each kind.
    """
    all_robots = Cluster(order.robots, order.tasks, ())
    m = len(order.tasks)

    def count_missing(problems: Mapping[int, LocalProblem]) -> int:
        routes = reoptimize_cluster(problems, {}, all_robots, left_out, steps, 0)
        return len(list_unserved_tasks(routes, m))

    present = count_missing(robots)
    found: list[tuple[int, str]] = []
    for name, drop in CONSTRAINT_RELAXATIONS.items():
        relaxed = {i: drop(robot) for i, robot in robots.items()}
        if all(relaxed[i] is robots[i] for i in robots):
            continue
        found.append((count_missing(relaxed), name))
    missing, name = min(found, key=_get_count, default=(present, ""))
    if missing >= present:
        return "no constraint alone is the cause"
    if missing:
        return f"without {name}, the constraint that matters most, {missing} would be left out"
    return f"without {name} all could be served"


def _get_count(entry: tuple[int, str]) -> int:
    return entry[0]


def _drop_windows(local: LocalProblem) -> LocalProblem:
    if not local.vehicle.timed:
        return local
    tasks = replace(local.tasks, latest=np.full_like(local.tasks.latest, math.inf))
    return replace(local, tasks=tasks, window=(local.window[0], math.inf))


def _drop_limit(local: LocalProblem) -> LocalProblem:
    if math.isinf(local.limit):
        return local
    return replace(local, limit=math.inf, left=None)


def _drop_capacity(local: LocalProblem) -> LocalProblem:
    total = local.initial_load + math.fsum(local.tasks.load)
    return local if local.capacity >= total else replace(local, capacity=total)


def _drop_capability(local: LocalProblem) -> LocalProblem:
    if local.capable.all():
        return local
    return replace(local, capable=np.ones_like(local.capable))


CONSTRAINT_RELAXATIONS: dict[str, Callable[[LocalProblem], LocalProblem]] = {
    "time_windows": _drop_windows,
    "route_length_limit": _drop_limit,
    "capacity": _drop_capacity,
    "capability": _drop_capability,
}
"""Kinds of constraints by their key in the instance file, and how each is dropped."""
