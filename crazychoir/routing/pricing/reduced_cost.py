"""The least reduced cost of a robot at given prices, without a table of all its routes."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from crazychoir.routing.instance.vehicle import ROUNDING_SLACK, Vehicle
from crazychoir.routing.pricing.label_setting_priced import grow_priced_labels
from crazychoir.routing.pricing.route_table import (
    RouteColumn,
    find_shortest_route,
    restrict_vehicle,
)
from crazychoir.types import Bools, Ints, Vec, Words


@dataclass(frozen=True, slots=True)
class PricingLimits:
    """Default limits of a search for the least reduced cost."""

    most_labels: int = 1_000_000
    """Largest number of labels of a search."""
    quick_width: int = 200
    """Labels for each number of stops in the quick first search; its result bounds the exact
    search.
    """
    most_columns: int = 20
    """Largest number of columns that are returned."""
    remembered_tasks: int = 8
    """Number of tasks that an ng-route remembers at a stop."""


PRICING_LIMITS = PricingLimits()


class LeastReducedCost(NamedTuple):
    """Result of a search for the least reduced cost."""

    value: float
    """m: the least reduced cost that was found, at most 0 without goods aboard."""
    columns: list[RouteColumn]
    """Columns with a reduced cost below 0, the least first."""
    exact: bool
    """Whether it is proven that no route has a smaller reduced cost."""


def find_least_reduced_cost(
    vehicle: Vehicle,
    prices: Vec,
    most: int = PRICING_LIMITS.most_labels,
    width: int = PRICING_LIMITS.quick_width,
) -> LeastReducedCost:
    """Find the least reduced cost over all routes of the vehicle, and 0 for no route.

        fixed + length - sum_{j served} price_j

    vehicle: the robot.
    prices: (M,) m, -inf forbids a task.
    most: labels, at most; with 0 only the quick search runs.
    width: labels for each number of stops in the quick search.
    """
    problem = _PricedProblem(vehicle, prices)
    quick = problem.search(problem.nothing, width * 2 * len(prices) + 1, width)
    found = [quick]
    if most and not quick.exact:
        found.append(problem.search(quick.value, most, most))
    sets = problem.sets([route for search in found for route in search.routes])
    columns = [
        RouteColumn(find_shortest_route(vehicle, tasks)[1] + vehicle.fixed, tasks)
        for tasks in list(sets)[: PRICING_LIMITS.most_columns]
    ]
    columns.sort(key=lambda c: (c.length - float(prices[list(c.tasks)].sum()), c))
    return LeastReducedCost(found[-1].value, columns, found[-1].exact)


def bound_reduced_cost(
    vehicle: Vehicle,
    prices: Vec,
    below: float,
    near: int = PRICING_LIMITS.remembered_tasks,
    most: int = PRICING_LIMITS.most_labels,
) -> float:
    """Return a lower bound on the least reduced cost.

    Routes may serve a task again, but not while they are near it.

    below: m, a known reduced cost, such as that of `find_least_reduced_cost`.
    near: a stop at task k forgets all tasks except the `near` nearest to it.
    most: labels, at most.
    Returns -inf if there are more than `most` labels.
    Source: the ng-route relaxation of Baldacci, Mingozzi & Roberti 2011, Operations Research 59(5).
    """
    problem = _PricedProblem(vehicle, prices, near)
    search = problem.search(min(below, problem.nothing), most, most)
    return search.value if search.exact else -np.inf


class _SearchResult(NamedTuple):
    """Result of the kernel."""

    value: float
    """m: the least reduced cost."""
    routes: list[tuple[float, list[int]]]
    """Routes as (reduced cost in m, nodes), the least first."""
    exact: bool
    """Whether no label was dropped because there were too many."""


class _PricedProblem:
    """A vehicle with its priced tasks, as the kernel needs it.

    Raises InstanceError if there are more than MOST_TASKS tasks.
    """

    def __init__(self, vehicle: Vehicle, prices: Vec, near: int | None = None) -> None:
        able = [j for j in vehicle.servable if vehicle.aboard[j] or prices[j] > -np.inf]
        self._whole = vehicle
        self._chosen = np.array(able, dtype=np.int64)
        self._vehicle = restrict_vehicle(vehicle, self._chosen)
        self._price = np.asarray(prices[self._chosen], dtype=float)
        self._memory = _build_memory(
            self._vehicle, len(self._chosen) if near is None else near
        )

    @property
    def nothing(self) -> float:
        """The reduced cost of no route: 0, or inf for a robot that has goods to deliver."""
        return np.inf if self._whole.aboard.any() else 0.0

    def search(self, below: float, most: int, width: int) -> _SearchResult:
        """Return the best routes with a reduced cost less than `below`."""
        v = self._vehicle
        into = _compute_ways_into(v)
        by = np.array([True, v.timed, bool(np.isfinite(v.farthest)), v.trips > 1])
        with np.errstate(divide="ignore", invalid="ignore"):
            worth = np.nan_to_num(
                self._price / (into[: v.tasks] + into[v.tasks : 2 * v.tasks])
            )
        best, ends, costs, last, parent, again, exact = grow_priced_labels(
            v.distance,
            v.duration,
            v.shortest,
            v.fastest,
            v.earliest,
            v.latest + ROUNDING_SLACK,
            v.load,
            v.aboard,
            self._price,
            into,
            np.argsort(-worth, kind="stable"),
            self._memory,
            by,
            v.capacity + ROUNDING_SLACK,
            v.limit + ROUNDING_SLACK,
            v.limit_again + ROUNDING_SLACK,
            v.trips,
            below - v.fixed,
            most,
            width,
        )
        order = np.argsort(costs, kind="stable")[: 10 * PRICING_LIMITS.most_columns]
        routes = [
            (float(costs[r]) + v.fixed, self._nodes(int(ends[r]), last, parent, again))
            for r in order
        ]
        return _SearchResult(min(below, best + v.fixed), routes, bool(exact))

    def sets(
        self, routes: list[tuple[float, list[int]]]
    ) -> dict[tuple[int, ...], list[int]]:
        """Return the sets of tasks with the nodes of their best routes, the best first."""
        m = self._whole.tasks
        best: dict[tuple[int, ...], list[int]] = {}
        for _, nodes in sorted(routes):
            best.setdefault(
                tuple(sorted(v - m for v in nodes if m <= v < 2 * m)), nodes
            )
        return best

    def _nodes(self, label: int, last: Ints, parent: Ints, again: Bools) -> list[int]:
        m = self._whole.tasks
        nodes = []
        while label > 0:
            part, at = divmod(int(last[label]), len(self._chosen))
            nodes.append(m * part + int(self._chosen[at]))
            if again[label]:
                nodes.append(2 * m + 1)
            label = int(parent[label])
        return nodes[::-1]


def _compute_ways_into(v: Vehicle) -> Vec:
    """Return (2m + 2,) m: the shortest way into each node from any node that may come before it."""
    m = v.tasks
    way = v.distance.copy()
    np.fill_diagonal(way, np.inf)
    j = np.arange(m)
    way[m + j, j] = np.inf  # no pickup after its own delivery
    way[2 * m, m : 2 * m][~v.aboard] = np.inf
    way[:m, 2 * m + 1] = np.inf  # a route ends after a delivery
    way[2 * m, 2 * m + 1] = np.inf if v.trips == 1 else way[2 * m, 2 * m + 1]
    if v.trips == 1:
        way[2 * m + 1] = np.inf
    least = way.min(axis=0)
    return np.where(np.isfinite(least), least, 0.0)


def _build_memory(v: Vehicle, near: int) -> Words:
    """Return (m, 2) words: for each task the set of the `near` nearest tasks, with itself."""
    m = v.tasks
    apart = v.distance[: 2 * m, : 2 * m]
    stops = np.minimum(
        np.minimum(apart[:m, :m], apart[m:, m:]),
        np.minimum(apart[:m, m:], apart[m:, :m]),
    )
    stops = stops.copy()
    np.fill_diagonal(stops, -1.0)
    words = np.zeros((m, 2), np.uint64)
    for k in range(m):
        for j in np.argsort(stops[k], kind="stable")[:near]:
            words[k, j >> 6] |= np.uint64(1) << np.uint64(j & 63)
    return words
