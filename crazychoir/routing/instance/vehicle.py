"""One robot as the routing kernels see it: matrices over nodes, windows and limits."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from math import inf

import numpy as np
import numpy.typing as npt

from crazychoir.routing.instance.legs import Legs
from crazychoir.types import Mat, Vec


@dataclass(frozen=True, slots=True)
class ObjectiveNames:
    """Names of what a plan minimises."""

    total: str = "total"
    """The sum of costs in m."""
    makespan: str = "makespan"
    """The time in s when the last robot is done."""
    vehicles: str = "vehicles"
    """The number of robots that leave home; it comes before the total."""


OBJECTIVE_NAMES = ObjectiveNames()


ROUNDING_SLACK = 1e-9
"""Tolerance for the rounding of sums: loads, lengths and times may exceed their limits by this."""


@dataclass(frozen=True, eq=False)
class Vehicle:
    """A robot and M tasks in the form that searches and kernels use.

    Nodes: 0..M-1 pickups, M..2M-1 deliveries, 2M the start, 2M + 1 the end.
    A route is the list of the nodes between start and end. The node 2M + 1 inside a route is a stop
    at the end point, with nothing on board, where a new trip begins. Distances and durations need
    not be symmetric and need not satisfy the triangle inequality.
    """

    ways: Legs
    """m: cost of each leg; legs to the end are 0 in an open tour."""
    times: Legs
    """s: from the begin of service at v to the arrival at w.

    It is the service time at v plus the flight time.
    """
    earliest: Vec
    """(2M + 2,) s: earliest begin of each service, 0 without a window.

    A robot that arrives early waits. It leaves the start no sooner than earliest[2M].
    """
    latest: Vec
    """(2M + 2,) s: latest begin of each service, inf without a window.

    The robot is at the end no later than latest[2M + 1].
    """
    load: Vec
    """(M,) units of load."""
    capacity: float
    """Units of load that remain beside the goods that stay on board."""
    limit: float
    """m: limit on the distance of a route, or of its first trip."""
    capable: npt.NDArray[np.bool_]
    """(M,): tasks that the robot may serve."""
    aboard: npt.NDArray[np.bool_]
    """(M,): tasks with goods on board from the start.

    Their pickup is not a stop, no other robot can serve them, and their load counts from the start.
    """
    fixed: float = 0.0
    """m: cost of leaving home, added to the distance of a route that is not empty.

    For a robot in flight it is negative: minus the way to its end, which it flies in any case.
    """
    trips: int = 1
    """Largest number of trips, at least 1. Between trips the robot recharges at its end point."""
    limit_again: float = inf
    """m: limit on the distance of each trip after the first."""
    robot: int = 0
    """Id of the robot, for messages."""
    metric: bool = False
    """Whether distances and durations satisfy the triangle inequality, which makes bounds fast to compute."""

    @property
    def tasks(self) -> int:
        """M, the number of tasks."""
        return len(self.load)

    @property
    def distance(self) -> Mat:
        """(2M + 2, 2M + 2) m: `ways` as one matrix."""
        return self.ways.whole

    @property
    def duration(self) -> Mat:
        """(2M + 2, 2M + 2) s: `times` as one matrix."""
        return self.times.whole

    @cached_property
    def timed(self) -> bool:
        """Whether a time window can close; if not, routes differ only by their distances."""
        return bool(np.isfinite(self.latest).any())

    @cached_property
    def servable(self) -> npt.NDArray[np.int64]:
        """Indices, increasing, of the tasks that it carries or that one of its routes could hold.

        Bounds exclude the other tasks: the shortest ways over any nodes, without waiting.
        """
        m = self.tasks
        alone = (
            self.capable
            & (self.load <= self.capacity + ROUNDING_SLACK)
            & (self.shortest_trip <= self.farthest + ROUNDING_SLACK)
        )
        return np.flatnonzero(
            self.aboard
            | (
                alone
                & (
                    self.soonest <= self.latest[: 2 * m].reshape(2, m) + ROUNDING_SLACK
                ).all(0)
                & (self.soonest_end <= self.latest[2 * m + 1] + ROUNDING_SLACK)
            )
        )

    @property
    def shortest(self) -> Mat:
        """(2M + 2, 2M + 2) m: `shortest_ways` as one matrix."""
        return self.shortest_ways.whole

    @property
    def fastest(self) -> Mat:
        """(2M + 2, 2M + 2) s: `fastest_ways` as one matrix."""
        return self.fastest_ways.whole

    @cached_property
    def shortest_ways(self) -> Legs:
        """The shortest ways over any nodes of one trip, m."""
        if self.metric:
            return self.ways
        return Legs.of(compute_shortest_ways(self.distance, range(2 * self.tasks)))

    @cached_property
    def fastest_ways(self) -> Legs:
        """The fastest ways over any nodes, without waiting, s.

        The ways may pass the end point if a further trip may follow.
        """
        if self.metric:
            return self.times
        m = self.tasks
        over = range(2 * m) if self.trips == 1 else [*range(2 * m), 2 * m + 1]
        return Legs.of(compute_shortest_ways(self.duration, over))

    @property
    def farthest(self) -> float:
        """m: limit on the longest trip."""
        return max(self.limit, self.limit_again) if self.trips > 1 else self.limit

    @cached_property
    def shortest_trip(self) -> Vec:
        """(M,) m: a lower bound on the distance of any trip with task j.

        It takes the shortest ways from the start to the pickup, the delivery and the end.
        """
        m = self.tasks
        way = self.shortest_ways
        j = np.arange(m)
        out = np.atleast_2d(way.to_stops[0 if self.trips == 1 else slice(None), :m])
        return np.asarray(
            out.min(axis=0) + way.between[j, m + j] + way.from_stops[m + j, 1]
        )

    @cached_property
    def soonest(self) -> Mat:
        """(2, M) s: lower bounds on the begin of service at each pickup and each delivery."""
        m = self.tasks
        way = self.fastest_ways
        j = np.arange(m)
        pickup = np.maximum(
            self.earliest[:m], self.earliest[2 * m] + way.to_stops[0, :m]
        )
        return np.vstack(
            [
                pickup,
                np.maximum(self.earliest[m : 2 * m], pickup + way.between[j, m + j]),
            ]
        )

    @cached_property
    def soonest_end(self) -> Vec:
        """(M,) s: a lower bound on the end of any route with task j."""
        m = self.tasks
        return np.asarray(self.soonest[1] + self.fastest_ways.from_stops[m : 2 * m, 1])

    def length(self, route: Sequence[int]) -> float:
        """Return the length of a route in m, added from its start to its end."""
        m = self.tasks
        return sum(
            (self.ways.at(v, w) for v, w in pairwise([2 * m, *route, 2 * m + 1])),
            0.0,
        )

    def finish(self, route: Sequence[int]) -> float:
        """Return the time in s when a route is over; 0 for a route without stops.

        Each service begins as soon as its window allows.
        """
        return self.begins(route)[-1] if len(route) else 0.0

    def begins(self, route: Sequence[int]) -> list[float]:
        """Return the times in s when each service of a route begins, and when the route is over."""
        m = self.tasks
        times = [float(self.earliest[2 * m])]
        for v, w in pairwise([2 * m, *route, 2 * m + 1]):
            times.append(max(times[-1] + self.times.at(v, w), float(self.earliest[w])))
        return times[1:]

    def only(self, chosen: npt.NDArray[np.int64]) -> "Vehicle":
        """Return the same robot with the tasks `chosen` (K,) alone."""
        m = self.tasks
        stops = np.concatenate([chosen, m + chosen])
        nodes = np.concatenate([stops, [2 * m, 2 * m + 1]])
        return Vehicle(
            ways=self.ways.only(stops),
            times=self.times.only(stops),
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


def compute_shortest_ways(length: Mat, over: Iterable[int]) -> Mat:
    """Return the (n, n) lengths of the shortest ways over the nodes `over`, by Floyd and Warshall.

    w_ab <- min(w_ab, w_ak + w_kb)   for every node k in `over`
    """
    way = np.array(length)
    for k in over:
        np.minimum(way, way[:, k, None] + way[k], out=way)
    return way
