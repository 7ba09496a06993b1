"""The values by which a team compares plans."""

import math
from collections.abc import Mapping, Sequence

import numpy as np

from crazychoir.routing.distributed.cluster_problem import measure_route
from crazychoir.routing.distributed.clusters import Stops, list_unserved_tasks
from crazychoir.routing.distributed.member import EQUAL_COST_TOLERANCE
from crazychoir.routing.instance.instance import LocalProblem
from crazychoir.routing.instance.vehicle import OBJECTIVE_NAMES


class PlanMeasure:
    """Measures plans by the objectives of the team, and remembers the cost of each route.

    The worth of a plan is a list of values, compared in order: first the number of missing tasks
    that must be served, then the objectives in order. The first objective includes the refusals.

    robots: the problems of all robots, with the same tasks and objectives.
    vehicle_weight: m, cost of a vehicle in the relaxations; 0 if vehicles are not counted first.
    """

    def __init__(
        self, robots: Mapping[int, LocalProblem], vehicle_weight: float
    ) -> None:
        one = next(iter(robots.values()))
        self._robots = robots
        self._vehicle_weight = vehicle_weight
        self._m = len(one.tasks)
        self._refusal = one.tasks.refusal
        self._objective = one.objective
        self._costs: dict[tuple[int, tuple[int, ...]], tuple[float, float]] = {}
        self._last: tuple[object, list[float]] = (None, [])

    def compute_worth(
        self, routes: Stops, tasks: Sequence[int] | None = None
    ) -> list[float]:
        """Return the worth of a plan.

        routes: nodes of each robot's stops.
        tasks: only these tasks count as left out; all if None.
        The last worth is kept: the robots of a process measure the same plan, one after the other.
        """
        plan = tuple((i, tuple(routes[i])) for i in sorted(routes))
        key = (plan, None if tasks is None else tuple(tasks))
        last = self._last
        if last[0] != key:
            last = (key, self._compute_worth_anew(routes, tasks))
            self._last = last
        return list(last[1])

    def _compute_worth_anew(
        self, routes: Stops, tasks: Sequence[int] | None
    ) -> list[float]:
        left = [
            j
            for j in list_unserved_tasks(routes, self._m)
            if tasks is None or j in tasks
        ]
        flights = [
            self.measure_flight(i, tuple(stops))
            for i, stops in sorted(routes.items())
            if len(stops)
        ]
        value = {
            OBJECTIVE_NAMES.total: math.fsum(length for length, _ in flights),
            OBJECTIVE_NAMES.makespan: max(
                (finish for _, finish in flights), default=0.0
            ),
            OBJECTIVE_NAMES.vehicles: float(len(flights)),
        }
        first, *rest = (value[name] for name in self._objective)
        refusals = self._refusal[left]
        refused = np.isfinite(refusals)
        return [
            float(np.count_nonzero(~refused)),
            first + math.fsum(refusals[refused]),
            *rest,
        ]

    def convert_cost(self, weighed: float, vehicles: int) -> list[float]:
        """Return the worth of a plan without missing tasks.

        weighed: m, its cost, as the relaxations count it.
        vehicles: number of robots that fly.
        """
        if self._vehicle_weight:
            return [0, vehicles, weighed - self._vehicle_weight * vehicles]
        return [0, weighed]

    def compute_weighed_cost(self, routes: Stops) -> float:
        """Return the cost of a plan in m, as the relaxations count it.

        If vehicles are counted first it includes their weight.
        """
        worth = self.compute_worth(routes)
        weight = self._vehicle_weight
        return weight * worth[1] + worth[2] if weight else worth[1]

    def compute_shown_cost(self, routes: Stops) -> float:
        """Return the cost of a plan in m, without the weight of vehicles."""
        worth = self.compute_worth(routes)
        return worth[2] if self._vehicle_weight else worth[1]

    def list_missing_tasks(self, routes: Stops) -> list[int]:
        """Return the tasks that must be served and are not."""
        return [
            j
            for j in list_unserved_tasks(routes, self._m)
            if np.isinf(self._refusal[j])
        ]

    def measure_flight(self, i: int, stops: tuple[int, ...]) -> tuple[float, float]:
        """Return the cost in m and the finish time in s of a route of robot i."""
        if (i, stops) not in self._costs:
            self._costs[i, stops] = measure_route(self._robots[i], stops)
        return self._costs[i, stops]


def is_better(new: Sequence[float], old: Sequence[float]) -> bool:
    """Return whether the worth `new` is less than `old` at the first place where they differ."""
    return next(
        (
            a < b
            for a, b in zip(new, old, strict=True)
            if abs(a - b) > EQUAL_COST_TOLERANCE
        ),
        False,
    )
