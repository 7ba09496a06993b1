"""The flight of a plan: trips, the begin of each service, the end of each robot, refused tasks."""

import math
from collections.abc import Iterable
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np

from crazychoir.routing.instance.checker import check_plan
from crazychoir.routing.instance.instance import Instance
from crazychoir.routing.instance.plan import Route, Stop
from crazychoir.routing.instance.vehicle import OBJECTIVE_NAMES


@dataclass(frozen=True)
class Trip:
    """The part of a route between two recharges.

    The first trip begins at home, the others at the robot's end point.
    """

    robot: int
    """Id of the robot."""
    number: int
    """Number of the trip, from 1."""
    stops: tuple[Stop, ...]
    """The stops in order, without recharges."""
    length: float
    """m."""
    begins: tuple[float, ...]
    """s: begin of the service at each stop, after waiting for its window."""
    end: float
    """s: when the trip is over."""

    def to_json(self) -> dict[str, Any]:
        """Return a JSON object; a stop is "+3" for the pickup of task 3, "-3" for its delivery."""
        stops = [
            f"{'+' if stop.kind == 'pickup' else '-'}{stop.task}" for stop in self.stops
        ]
        return {
            "robot": self.robot,
            "trip": self.number,
            "length_m": self.length,
            "end_s": self.end,
            "stops": stops,
            "begin_s": list(self.begins),
        }


def split_into_trips(instance: Instance, route: Route) -> list[Trip]:
    """Return the trips of a route in order: one, unless the robot recharges."""
    m = len(instance.tasks)
    vehicle = instance.local(route.robot).vehicle
    at = {"pickup": 0, "delivery": m, "recharge": 2 * m + 2}
    nodes = [at[stop.kind] + stop.task for stop in route.stops]
    begins = vehicle.begins(nodes)
    cuts = [
        -1,
        *(n for n, stop in enumerate(route.stops) if stop.kind == "recharge"),
        len(nodes),
    ]
    whole = [2 * m, *nodes, 2 * m + 1]
    found = []
    for number, (start, end) in enumerate(pairwise(cuts), 1):
        length = math.fsum(
            vehicle.ways.at(v, w) for v, w in pairwise(whole[start + 1 : end + 2])
        )
        stops = route.stops[start + 1 : end]
        found.append(
            Trip(
                route.robot,
                number,
                stops,
                length,
                tuple(begins[start + 1 : end]),
                begins[end],
            )
        )
    return found


def is_timed(instance: Instance) -> bool:
    """Return whether times matter: there is a window or a release, or the makespan is minimised."""
    tasks = instance.tasks
    windows = (
        tasks.earliest.any(),
        np.isfinite(tasks.latest).any(),
        instance.window[:, 0].any(),
        np.isfinite(instance.window[:, 1]).any(),
    )
    return OBJECTIVE_NAMES.makespan in instance.objective or any(windows)


def summarise_plan(instance: Instance, routes: Iterable[Route]) -> dict[str, Any]:
    """Return a summary of the plan as a JSON object.

    vehicles: number of robots that leave home.
    total_m: length of all tours with the fixed costs, m.
    makespan_s: when the last robot is done, s.
    refused: the tasks left out that may be refused, each with its penalty and priority.
    penalties: sum of these penalties.
    objective: what is minimised, in order.
    timed: result of `is_timed`.
    trips: the trips of all robots.
    violations: what is wrong with the plan, a sentence each.
    """
    plan = instance.plan(routes)
    flown = [
        trip for route in plan.routes for trip in split_into_trips(instance, route)
    ]
    served = {task for route in plan.routes for task in route.tasks}
    penalty = instance.tasks.penalty
    refused = [
        j for j in range(len(penalty)) if j not in served and math.isfinite(penalty[j])
    ]
    return {
        "vehicles": len(plan.routes),
        "total_m": plan.total,
        "makespan_s": max((trip.end for trip in flown), default=0.0),
        "refused": [
            {
                "task": j,
                "penalty": float(penalty[j]),
                "priority": int(instance.tasks.priority[j]),
            }
            for j in refused
        ],
        "penalties": math.fsum(float(penalty[j]) for j in refused),
        "objective": list(instance.objective),
        "timed": is_timed(instance),
        "trips": [trip.to_json() for trip in flown],
        "violations": check_plan(instance, plan),
    }
