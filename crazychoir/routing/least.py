"""The least reduced cost of a robot at given prices, without a table of all its routes."""

from typing import NamedTuple

import numpy as np

from crazychoir.routing.labels import Ints, Words
from crazychoir.routing.priced import grow_priced
from crazychoir.routing.pricing import Column, shortest_route
from crazychoir.routing.vehicle import SLACK, Vehicle
from crazychoir.types import Vec

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


def least_reduced_cost(vehicle: Vehicle, prices: Vec, most: int = MOST_LABELS, width: int = WIDTH) -> Least:
    """The least of   fixed + length - sum_{j served} price_j   over all routes of the vehicle, and of 0 for none.

    prices: (M,) m, -inf forbids a task;  most: labels;  width: of the quick search. With most = 0 it is all there is.
    """
    problem = _Problem(vehicle, prices)
    value, rows, exact = problem.search(problem.nothing, most=width * 2 * len(prices) + 1, width=width)
    if most and not exact:
        best, more, exact = problem.search(value, most, most)
        value, rows = min(best, value), rows + more
    return Least(value, problem.columns(rows), exact)


def relaxed_reduced_cost(
    vehicle: Vehicle, prices: Vec, below: float, near: int = NEAR, most: int = MOST_LABELS
) -> float:
    """A lower bound of the least reduced cost: routes may serve a task again, but not while they are near it.

    below: m, a reduced cost that is known, as that of `least_reduced_cost`;  near: a stop at task k forgets all tasks
    but the `near` nearest to it.  -inf if there are more than `most` labels.
    Source: the ng-route relaxation of Baldacci, Mingozzi & Roberti 2011, Operations Research 59(5).
    """
    problem = _Problem(vehicle, prices, near)
    value, _, exact = problem.search(min(below, problem.nothing), most, most)
    return value if exact else -np.inf


class _Problem:
    """A vehicle with those of its tasks that have a price, as the kernel takes it."""

    def __init__(self, vehicle: Vehicle, prices: Vec, near: int | None = None) -> None:
        self._whole, self._prices = vehicle, prices
        self._chosen = np.array([j for j in vehicle.servable if vehicle.aboard[j] or prices[j] > -np.inf], dtype=np.int64)
        self._vehicle = vehicle.only(self._chosen)
        self._price = np.asarray(prices[self._chosen], dtype=float)
        self._memory = _memory(self._vehicle, len(self._chosen) if near is None else near)

    @property
    def nothing(self) -> float:
        """The reduced cost of no route: 0, or inf for a robot that has goods to deliver."""
        return np.inf if self._whole.aboard.any() else 0.0

    def search(self, below: float, most: int, width: int) -> tuple[float, list[tuple[float, list[int]]], bool]:
        """The least reduced cost, if less than `below`; the routes found, as reduced cost and tasks; exact."""
        v = self._vehicle
        into = _into(v)
        limited, many = bool(np.isfinite(v.farthest)), v.trips > 1
        with np.errstate(divide="ignore", invalid="ignore"):
            worth = self._price / (into[: v.tasks] + into[v.tasks : 2 * v.tasks])
        best, ends, costs, last, parent, exact = grow_priced(
            v.distance, v.duration, v.shortest, v.fastest, v.earliest, v.latest + SLACK, v.load, v.aboard,
            self._price, into, np.argsort(-np.nan_to_num(worth), kind="stable"), self._memory,
            np.array([True, v.timed, limited, many]), v.capacity + SLACK, v.limit + SLACK, v.limit_again + SLACK, v.trips,
            below - v.fixed, most, width,
        )  # fmt: skip
        order = np.argsort(costs, kind="stable")[: 10 * MOST_COLUMNS]
        found = [(float(costs[r]) + v.fixed, self._tasks(int(ends[r]), last, parent)) for r in order]
        return min(below, best + v.fixed), found, bool(exact)

    def columns(self, rows: list[tuple[float, list[int]]]) -> list[Column]:
        """The best sets, each with its shortest route."""
        sets = dict.fromkeys(tuple(tasks) for cost, tasks in sorted(rows) if cost < 0.0)
        columns = []
        for tasks in list(sets)[:MOST_COLUMNS]:
            length = shortest_route(self._whole, tasks)[1] + self._whole.fixed
            columns.append((length - float(self._prices[list(tasks)].sum()), Column(length, tasks)))
        return [column for _, column in sorted(columns)]

    def _tasks(self, label: int, last: Ints, parent: Ints) -> list[int]:
        m, tasks = self._vehicle.tasks, [int(self._chosen[j]) for j in np.flatnonzero(self._vehicle.aboard)]
        while label > 0:
            if last[label] < m:
                tasks.append(int(self._chosen[last[label]]))
            label = int(parent[label])
        return sorted(tasks)


def _into(v: Vehicle) -> Vec:
    """(2m + 2,) m, the shortest way into each node from any that may be before it."""
    m, way = v.tasks, v.distance.copy()
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
    stops = np.minimum(np.minimum(apart[:m, :m], apart[m:, m:]), np.minimum(apart[:m, m:], apart[m:, :m]))
    stops = stops.copy()
    np.fill_diagonal(stops, -1.0)
    words = np.zeros((m, 2), np.uint64)
    for k in range(m):
        for j in np.argsort(stops[k], kind="stable")[:near]:
            words[k, j >> 6] |= np.uint64(1) << np.uint64(j & 63)
    return words
