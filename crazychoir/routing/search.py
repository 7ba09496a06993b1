"""Ruin and recreate: a search for good plans of many vehicles and tasks that can be stopped at any time."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np

from crazychoir.routing.annealing import Best, anneal
from crazychoir.routing.fleet import fleet_of
from crazychoir.routing.pool import Pool
from crazychoir.routing.recreation import Memory
from crazychoir.routing.ruin import Step
from crazychoir.routing.tours import Fleet, Tours
from crazychoir.routing.vehicle import TOTAL, Vehicle
from crazychoir.types import Vec

HOT = 0.05
"""First temperature, as a share of the median distance of a task alone."""
AVERAGE = 10.0
"""Stops that a step takes out, about."""


@dataclass(frozen=True)
class Seen:
    """A route that a search has seen: vehicle, cost in m with its fixed cost, stops."""

    vehicle: int
    cost: float
    stops: list[int]


@dataclass(frozen=True)
class Found:
    """A plan. routes: the stops of each vehicle;  unserved: tasks that no route serves, increasing;

        total = sum of distances and fixed costs of the vehicles that leave + penalties of the unserved, m

    finish: s, when the last of them is done.
    """

    routes: list[list[int]]
    unserved: list[int]
    total: float
    finish: float
    pool: Pool = field(repr=False)

    def seen(self) -> list[Seen]:
        """The routes that the search has been at, of each set of tasks and each kind of vehicle the cheapest."""
        pool, end = self.pool, 2 * (len(self.pool.sign) - len(self.routes)) + 1
        return [
            Seen(int(pool.vehicle[p]), float(pool.cost[p]), np.minimum(pool.stop[p, : pool.stops[p]], end).tolist())
            for p in np.flatnonzero(pool.vehicle >= 0)
        ]


def search(
    vehicles: Sequence[Vehicle],
    routes: Sequence[Sequence[int]],
    penalty: Vec,
    steps: int,
    seed: int,
    *,
    objective: Sequence[str] = (TOTAL,),
    fleet_steps: int = 0,
    hot: float = HOT,
    average: float = AVERAGE,
) -> Found:
    """The best plan that `steps` of ruin and recreate find from `routes`, empty ones or infeasible ones too.

    routes: stops of each vehicle, as Vehicle says;  penalty: (M,) m, of a task that is not served, inf where it must
    be;  seed: the same one gives the same plan on every machine;  objective: TOTAL, MAKESPAN, or both in their order;
    fleet_steps: before, at most so many to leave vehicles out, whatever that costs;  hot: first temperature, as a share
    of the median distance of a task alone;  average: stops that a step takes out, about.
    Tasks that must be served can be in `unserved`: then the search has found no place for them.
    Source: Christiaens & Vanden Berghe 2020, Transportation Science 54(2), "Slack induction by string removals".
    """
    return Search(vehicles, penalty, objective).run(
        routes, steps, seed, fleet_steps=fleet_steps, hot=hot, average=average
    )


class Search:
    """As `search`, for several runs on the same vehicles."""

    def __init__(self, vehicles: Sequence[Vehicle], penalty: Vec, objective: Sequence[str] = (TOTAL,)) -> None:
        self._fleet = fleet_of(vehicles, penalty, objective)
        self._scale = float(np.median(self._fleet.traits[:, 1])) if vehicles[0].tasks else 0.0

    def run(
        self,
        routes: Sequence[Sequence[int]],
        steps: int,
        seed: int,
        *,
        fleet_steps: int = 0,
        hot: float = HOT,
        average: float = AVERAGE,
        closed: Sequence[int] = (),
    ) -> Found:
        """A plan; closed: vehicles that are not to leave."""
        fleet, random = self._fleet, np.array([seed], np.uint64)
        tours = Tours.of(fleet, routes)
        pool, m = Pool.of(fleet, tours), len(fleet.load)
        for number, fewer in ((fleet_steps, True), (steps, False)):
            step, memory, best, absence = Step.of(tours), Memory.of(tours, closed), Best.of(tours), np.zeros(m)
            heat = hot * self._scale
            anneal(fleet, tours, step, memory, best, pool, random, absence, number, heat, average, fewer)
            tours = Tours.of(fleet, [row[1 : n + 1] for row, n in zip(best.stop, best.stops, strict=True)])
        return _found(fleet, tours, pool)


def _found(fleet: Fleet, tours: Tours, pool: Pool) -> Found:
    m = len(fleet.load)
    routes = [np.minimum(row[1 : n + 1], 2 * m + 1) for row, n in zip(tours.stop, tours.stops, strict=True)]
    unserved = np.flatnonzero(tours.at < 0).tolist()
    total, finish = _values(fleet, tours)
    total += sum(float(fleet.penalty[j]) for j in unserved)
    return Found([route.tolist() for route in routes], unserved, total, finish, pool)


def _values(fleet: Fleet, tours: Tours) -> tuple[float, float]:
    """Total without penalties, and finish."""
    total, finish = 0.0, 0.0
    for k in np.flatnonzero(tours.stops):
        u, nodes = fleet.kind[k], tours.stop[k, : tours.stops[k] + 2]
        t = float(fleet.earliest[u, nodes[0]])
        total += float(fleet.fixed[k])
        for v, w in pairwise(nodes):
            total += float(fleet.distance[u, v, w])
            t = max(float(fleet.earliest[u, w]), t + float(fleet.duration[u, v, w]))
        finish = max(finish, t)
    return total, finish
