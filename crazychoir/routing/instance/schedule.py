"""What becomes of a plan when it is flown: trips, when each service begins, who is done when, and what is refused."""

import math
from collections.abc import Iterable
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

from crazychoir.routing.instance.checker import check
from crazychoir.routing.instance.instance import Instance
from crazychoir.routing.instance.plan import Route, Stop
from crazychoir.routing.instance.vehicle import MAKESPAN


@dataclass(frozen=True)
class Trip:
    """A part of a route, from home (or, after a recharge, from where the robot ends) to the next recharge or the end.

    length: m;  begins: s, of the service at each stop, waiting for its window included;  end: s, when it is over.
    """

    robot: int
    number: int
    stops: tuple[Stop, ...]
    length: float
    begins: tuple[float, ...]
    end: float

    def to_json(self) -> dict[str, Any]:
        """A JSON object; stops as "+3" for the pickup of task 3, "-3" for its delivery."""
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


def trips(instance: Instance, route: Route) -> list[Trip]:
    """The trips of a route, in order: one, unless it recharges."""
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
            float(vehicle.distance[v, w])
            for v, w in pairwise(whole[start + 1 : end + 2])
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


def times_matter(instance: Instance) -> bool:
    """Whether a window, a release or the objective asks when something is done."""
    tasks = instance.tasks
    windows = (
        tasks.earliest.any(),
        math.isfinite(tasks.latest.min()),
        instance.window[:, 0].any(),
        math.isfinite(instance.window[:, 1].min()),
    )
    return MAKESPAN in instance.objective or any(windows)


def outcome(instance: Instance, routes: Iterable[Route]) -> dict[str, Any]:
    """What people ask of a plan, as a JSON object.

    vehicles: robots that leave home;  total_m: all tours, with fixed costs;  makespan_s: until the last robot is done;
    refused: tasks left out that may be, each with its penalty;  penalties: their sum;  timed: `times_matter`;
    trips: of all robots;  violations: what is wrong with the plan, a sentence each.
    """
    plan = instance.plan(routes)
    flown = [trip for route in plan.routes for trip in trips(instance, route)]
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
        "timed": times_matter(instance),
        "trips": [trip.to_json() for trip in flown],
        "violations": check(instance, plan),
    }
