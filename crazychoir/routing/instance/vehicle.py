"""One robot as the kernels of routing see it: matrices over nodes, windows, limits."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from math import inf

import numpy as np
import numpy.typing as npt

from crazychoir.types import Mat, Vec

TOTAL, MAKESPAN = "total", "makespan"
"""What a team minimises: the sum of costs in m, or the time in s when the last robot is done."""
VEHICLES = "vehicles"
"""What a team minimises before the total: the number of robots that leave home."""
SLACK = 1e-9
"""Loads, lengths and times may exceed their limits by this much: rounding of a sum, not a licence."""


@dataclass(frozen=True, eq=False)
class Vehicle:
    """A robot and M tasks. Nodes: 0..M-1 pickups, M..2M-1 deliveries, 2M where it starts, 2M + 1 where it ends.

    A route is the list of the nodes between start and end; the node 2M + 1 inside it is a stop there, with nothing on
    board, to begin a new trip. Matrices need be neither symmetric nor satisfy the triangle inequality.

    distance: (2M + 2, 2M + 2) m, what a route costs; column 2M + 1 is 0 in an open tour;
    duration: (2M + 2, 2M + 2) s from the beginning of service at v to the arrival at w: service at v, then the way;
    earliest, latest: (2M + 2,) s, when service may begin, 0 and inf where there are no windows; who is early waits;
    it leaves the start no sooner than earliest[2M], and is at the end no later than latest[2M + 1];
    load: (M,), capacity: what is left of it beside the goods that stay on board;  limit: m, of the distance of a route,
    or of its first trip;
    capable: (M,) bool, tasks that it may serve;  aboard: (M,) bool, tasks whose goods it carries from the start:
    their pickup is no stop, nobody else can serve them, and their load counts from the start;
    fixed: cost in m of leaving at all, added to the distance of a route that is not empty; below 0 for a robot that is
    away already: the way to its end that it flies in any case;  trips: how often it may start anew from where it
    ends, plus one (a robot that recharges there), at least 1;  limit_again: m, of each trip but the first;
    robot: its id, for messages;  metric: both matrices satisfy the triangle inequality, so bounds are quick.
    """

    distance: Mat
    duration: Mat
    earliest: Vec
    latest: Vec
    load: Vec
    capacity: float
    limit: float
    capable: npt.NDArray[np.bool_]
    aboard: npt.NDArray[np.bool_]
    fixed: float = 0.0
    trips: int = 1
    limit_again: float = inf
    robot: int = 0
    metric: bool = False

    @property
    def tasks(self) -> int:
        """M."""
        return len(self.load)

    @cached_property
    def timed(self) -> bool:
        """Whether a window can close: else routes differ by their distances alone."""
        return bool(np.isfinite(self.latest).any())

    @cached_property
    def servable(self) -> npt.NDArray[np.int64]:
        """Indices, increasing, of the tasks that it carries or that could be in one of its routes.

        Those that no route can hold are left out by bounds: the shortest ways over any nodes, without waiting.
        """
        m = self.tasks
        alone = (
            self.capable
            & (self.load <= self.capacity + SLACK)
            & (self.shortest_trip <= self.farthest + SLACK)
        )
        return np.flatnonzero(
            self.aboard
            | (
                alone
                & (self.soonest <= self.latest[: 2 * m].reshape(2, m) + SLACK).all(0)
                & (self.soonest_end <= self.latest[2 * m + 1] + SLACK)
            )
        )

    @cached_property
    def shortest(self) -> Mat:
        """(2M + 2, 2M + 2) m, the shortest ways over any nodes of one trip."""
        return (
            self.distance
            if self.metric
            else shortest_ways(self.distance, range(2 * self.tasks))
        )

    @cached_property
    def fastest(self) -> Mat:
        """(2M + 2, 2M + 2) s, the fastest ways over any nodes, the end too where a trip may follow, without waiting."""
        m = self.tasks
        over = range(2 * m) if self.trips == 1 else [*range(2 * m), 2 * m + 1]
        return self.duration if self.metric else shortest_ways(self.duration, over)

    @property
    def farthest(self) -> float:
        """m, of the longest trip."""
        return max(self.limit, self.limit_again) if self.trips > 1 else self.limit

    @cached_property
    def shortest_trip(self) -> Vec:
        """(M,) m, at least the distance of any trip with task j: start, pickup, delivery, end by the shortest ways."""
        m = self.tasks
        way = self.shortest
        j = np.arange(m)
        out = (
            way[2 * m, :m]
            if self.trips == 1
            else np.minimum(way[2 * m, :m], way[2 * m + 1, :m])
        )
        return np.asarray(out + way[j, m + j] + way[m + j, 2 * m + 1])

    @cached_property
    def soonest(self) -> Mat:
        """(2, M) s: no service at pickup or delivery j begins sooner."""
        m = self.tasks
        way = self.fastest
        j = np.arange(m)
        pickup = np.maximum(self.earliest[:m], self.earliest[2 * m] + way[2 * m, :m])
        return np.vstack(
            [pickup, np.maximum(self.earliest[m : 2 * m], pickup + way[j, m + j])]
        )

    @cached_property
    def soonest_end(self) -> Vec:
        """(M,) s: no route with task j ends sooner."""
        m = self.tasks
        return np.asarray(self.soonest[1] + self.fastest[m : 2 * m, 2 * m + 1])

    def length(self, route: Sequence[int]) -> float:
        """m, of a route, added from its start to its end."""
        m = self.tasks
        return sum(
            (
                float(self.distance[v, w])
                for v, w in pairwise([2 * m, *route, 2 * m + 1])
            ),
            0.0,
        )

    def finish(self, route: Sequence[int]) -> float:
        """s, when a route is over that begins each service as soon as its window allows; 0 for one without stops."""
        return self.begins(route)[-1] if len(route) else 0.0

    def begins(self, route: Sequence[int]) -> list[float]:
        """s, when each service of such a route begins, and when it is over."""
        m = self.tasks
        times = [float(self.earliest[2 * m])]
        for v, w in pairwise([2 * m, *route, 2 * m + 1]):
            times.append(
                max(times[-1] + float(self.duration[v, w]), float(self.earliest[w]))
            )
        return times[1:]

    def only(self, chosen: npt.NDArray[np.int64]) -> "Vehicle":
        """The same robot with the tasks `chosen` (K,) alone."""
        m = self.tasks
        nodes = np.concatenate([chosen, m + chosen, [2 * m, 2 * m + 1]])
        square = np.ix_(nodes, nodes)
        return Vehicle(
            distance=np.ascontiguousarray(self.distance[square]),
            duration=np.ascontiguousarray(self.duration[square]),
            earliest=self.earliest[nodes],
            latest=self.latest[nodes],
            load=self.load[chosen],
            capacity=self.capacity,
            limit=self.limit,
            capable=self.capable[chosen],
            aboard=self.aboard[chosen],
            fixed=self.fixed,
            trips=self.trips,
            limit_again=self.limit_again,
            robot=self.robot,
            metric=self.metric,
        )


def shortest_ways(length: Mat, over: Iterable[int]) -> Mat:
    """(n, n): lengths of the shortest ways over the nodes `over`, by Floyd and Warshall.

    w_ab <- min(w_ab, w_ak + w_kb)   for every node k in `over`
    """
    way = np.array(length)
    for k in over:
        np.minimum(way, way[:, k, None] + way[k], out=way)
    return way
