"""Share tasks by an auction of cheapest insertions, from any place and with any goods on board.

For each free task, each robot bids the length by which its route would grow. In each pass, every
robot that has the best bid for some tasks takes the cheapest of them, so that a few passes suffice.
Tasks that no robot can serve are returned. Robots send only bids. The plan is not optimal, but
takes only some tens of rounds.
"""

import math
from dataclasses import dataclass, field, replace
from itertools import pairwise

from crazychoir.optimization.rounds.agreement import find_highest_bids
from crazychoir.optimization.rounds.program import Exchange
from crazychoir.routing.instance.vehicle import ROUNDING_SLACK, Vehicle

Nodes = tuple[int, ...]
"""Nodes of a route without its start and its end."""


@dataclass
class Insertion:
    """Inserts tasks into routes of one vehicle, at the cheapest places. Time windows are ignored.

    A route is a tuple of nodes, without the start and the end of the vehicle. With m tasks, node j
    is the pickup of task j, and node m + j its delivery.
    """

    vehicle: Vehicle
    """The robot."""
    _d: list[list[float]] = field(init=False)

    def __post_init__(self) -> None:
        self._d = self.vehicle.distance.tolist()

    def length(self, route: Nodes) -> float:
        """Return the length in m from the start over the route to the end."""
        m = self.vehicle.tasks
        d = self._d
        way = (2 * m, *route, 2 * m + 1)
        return sum((d[v][w] for v, w in pairwise(way)), 0.0)

    def loads(self, route: Nodes) -> list[float]:
        """Return the load on board at the start and after each stop."""
        vehicle = self.vehicle
        m = self.vehicle.tasks
        now = float(vehicle.load[vehicle.aboard].sum())
        found = [now]
        for v in route:
            now += float(vehicle.load[v]) if v < m else -float(vehicle.load[v - m])
            found.append(now)
        return found

    def cheapest(self, route: Nodes, j: int) -> tuple[float, Nodes] | None:
        """Return the cheapest way to insert task j, as (growth in m, new route).

        Returns None if the task does not fit. A task that is on board at the start gets only a
        delivery.
        """
        vehicle = self.vehicle
        m = self.vehicle.tasks
        d = self._d
        way = (2 * m, *route, 2 * m + 1)
        room = vehicle.limit + ROUNDING_SLACK - self.length(route)
        load = float(vehicle.load[j])
        most = vehicle.capacity + ROUNDING_SLACK
        best: tuple[float, int, int] | None = None
        if vehicle.aboard[j]:
            extras = [d[v][m + j] + d[m + j][w] - d[v][w] for v, w in pairwise(way)]
            best = min((extra, b, b) for b, extra in enumerate(extras))
        elif vehicle.capable[j]:
            loads = self.loads(route)
            for a in range(len(route) + 1):
                v = way[a]
                after = way[a + 1]
                to = d[v][j]
                for b in range(a, len(route) + 1):
                    if loads[b] + load > most:
                        break
                    w = way[b]
                    x = way[b + 1]
                    if a == b:
                        extra = to + d[j][m + j] + d[m + j][x] - d[v][x]
                    else:
                        extra = (
                            to
                            + d[j][after]
                            - d[v][after]
                            + d[w][m + j]
                            + d[m + j][x]
                            - d[w][x]
                        )
                    if best is None or (extra, a, b) < best:
                        best = extra, a, b
        if best is None or best[0] > room:
            return None
        extra, a, b = best
        head = route[:a] if vehicle.aboard[j] else (*route[:a], j)
        return extra, (*head, *route[a:b], m + j, *route[b:])

    def first(self) -> Nodes:
        """Return the route that only delivers the goods on board, even if it exceeds the limit."""
        route: Nodes = ()
        free = Insertion(_remove_limit(self.vehicle))
        for j in self.vehicle.aboard.nonzero()[0].tolist():
            found = free.cheapest(route, j)
            route = found[1] if found else route
        return route

    def improved(self, route: Nodes) -> Nodes:
        """Return the route after moving each task to its cheapest place until it gets no shorter."""
        m = self.vehicle.tasks
        free = Insertion(_remove_limit(self.vehicle))
        length = free.length(route)
        gained = True
        while gained:
            gained = False
            for j in sorted({v % m for v in route}):
                found = free.cheapest(tuple(v for v in route if v % m != j), j)
                if (
                    found
                    and (shorter := free.length(found[1])) < length - ROUNDING_SLACK
                ):
                    route = found[1]
                    length = shorter
                    gained = True
        return route


def _remove_limit(vehicle: Vehicle) -> Vehicle:
    return replace(vehicle, limit=math.inf)


def run_parallel_auction(
    robot: int, vehicle: Vehicle, free: list[int], diameter: int
) -> Exchange[tuple[Nodes, tuple[int, ...]]]:
    """Return this robot's route and the tasks that no robot can serve.

    All robots run the same passes.

    robot: id of this robot.
    vehicle: its limits.
    free: the tasks to be shared out, the same at all robots.
    diameter: of the connected graph, hops.
    A task stays free if no robot has the capability, the capacity or the length left for it.
    """
    insertion = Insertion(vehicle)
    route = insertion.first()
    left = list(free)
    while left:
        found = {j: insertion.cheapest(route, j) for j in left}
        bids = {
            j: [-extra[0], robot] for j, extra in found.items() if extra is not None
        }
        best = yield from find_highest_bids(bids, diameter)
        if not best:
            break
        taken: dict[int, tuple[float, int]] = {}
        for j, (amount, winner) in best.items():
            taken[winner] = min(taken.get(winner, (math.inf, j)), (-amount, j))
        for winner, (_, j) in taken.items():
            left.remove(j)
            mine = found[j] if winner == robot else None
            route = mine[1] if mine else route
    return insertion.improved(route), tuple(left)
