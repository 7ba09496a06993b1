"""The least reduced cost of a robot at given prices, without a table of all its routes."""

from typing import NamedTuple

import numpy as np

from crazychoir.routing.instance.vehicle import SLACK, Vehicle
from crazychoir.routing.pricing.label_setting_priced import grow_priced
from crazychoir.routing.pricing.route_table import Column, of_one_set, shortest_route
from crazychoir.types import Bools, Ints, Vec, Words

MOST_LABELS = 1_000_000
WIDTH = 200
"""Labels a number of stops in the quick search that comes first: what it finds is what the exact one is cut by."""
MOST_COLUMNS = 20
NEAR = 8


class Least(NamedTuple):
    """The least reduced cost in m that was found, at most 0 without goods aboard; columns below 0, the least first.

    exact: whether there is none below.
    """

    value: float
    columns: list[Column]
    exact: bool


def least_reduced_cost(
    vehicle: Vehicle, prices: Vec, most: int = MOST_LABELS, width: int = WIDTH
) -> Least:
    """The least of   fixed + length - sum_{j served} price_j   over all routes of the vehicle, and of 0 for none.

    prices: (M,) m, -inf forbids a task;  most: labels;  width: of the quick search. With most = 0 it is all there is.
    """
    problem = _Problem(vehicle, prices)
    quick = problem.search(problem.nothing, width * 2 * len(prices) + 1, width)
    found = [quick]
    if most and not quick.exact:
        found.append(problem.search(quick.value, most, most))
    sets = problem.sets([route for search in found for route in search.routes])
    columns = [
        Column(shortest_route(vehicle, tasks)[1] + vehicle.fixed, tasks)
        for tasks in list(sets)[:MOST_COLUMNS]
    ]
    columns.sort(key=lambda c: (c.length - float(prices[list(c.tasks)].sum()), c))
    return Least(found[-1].value, columns, found[-1].exact)


def relaxed_reduced_cost(
    vehicle: Vehicle,
    prices: Vec,
    below: float,
    near: int = NEAR,
    most: int = MOST_LABELS,
) -> float:
    """A lower bound of the least reduced cost: routes may serve a task again, but not while they are near it.

    below: m, a reduced cost that is known, as that of `least_reduced_cost`;  near: a stop at task k forgets all tasks
    but the `near` nearest to it.  -inf if there are more than `most` labels.
    Source: the ng-route relaxation of Baldacci, Mingozzi & Roberti 2011, Operations Research 59(5).
    """
    problem = _Problem(vehicle, prices, near)
    search = problem.search(min(below, problem.nothing), most, most)
    return search.value if search.exact else -np.inf


class _Search(NamedTuple):
    """What the kernel found: the least reduced cost, routes as (reduced cost, nodes), the least first, exact."""

    value: float
    routes: list[tuple[float, list[int]]]
    exact: bool


class _Problem:
    """A vehicle with those of its tasks that have a price, as the kernel takes it.

    Raises InstanceError if they are more than MOST_TASKS.
    """

    def __init__(self, vehicle: Vehicle, prices: Vec, near: int | None = None) -> None:
        able = [j for j in vehicle.servable if vehicle.aboard[j] or prices[j] > -np.inf]
        self._whole = vehicle
        self._chosen = np.array(able, dtype=np.int64)
        self._vehicle = of_one_set(vehicle, self._chosen)
        self._price = np.asarray(prices[self._chosen], dtype=float)
        self._memory = _memory(
            self._vehicle, len(self._chosen) if near is None else near
        )

    @property
    def nothing(self) -> float:
        """The reduced cost of no route: 0, or inf for a robot that has goods to deliver."""
        return np.inf if self._whole.aboard.any() else 0.0

    def search(self, below: float, most: int, width: int) -> _Search:
        """The best routes with a reduced cost less than `below`."""
        v = self._vehicle
        into = _into(v)
        by = np.array([True, v.timed, bool(np.isfinite(v.farthest)), v.trips > 1])
        with np.errstate(divide="ignore", invalid="ignore"):
            worth = np.nan_to_num(
                self._price / (into[: v.tasks] + into[v.tasks : 2 * v.tasks])
            )
        best, ends, costs, last, parent, again, exact = grow_priced(
            v.distance,
            v.duration,
            v.shortest,
            v.fastest,
            v.earliest,
            v.latest + SLACK,
            v.load,
            v.aboard,
            self._price,
            into,
            np.argsort(-worth, kind="stable"),
            self._memory,
            by,
            v.capacity + SLACK,
            v.limit + SLACK,
            v.limit_again + SLACK,
            v.trips,
            below - v.fixed,
            most,
            width,
        )
        order = np.argsort(costs, kind="stable")[: 10 * MOST_COLUMNS]
        routes = [
            (float(costs[r]) + v.fixed, self._nodes(int(ends[r]), last, parent, again))
            for r in order
        ]
        return _Search(min(below, best + v.fixed), routes, bool(exact))

    def sets(
        self, routes: list[tuple[float, list[int]]]
    ) -> dict[tuple[int, ...], list[int]]:
        """The sets of tasks with the nodes of their best route, the least reduced cost first."""
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


def _into(v: Vehicle) -> Vec:
    """(2m + 2,) m, the shortest way into each node from any that may be before it."""
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


def _memory(v: Vehicle, near: int) -> Words:
    """(m, 2) words: of each task, the `near` nearest, itself first."""
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
