"""Exact route pricing: all feasible sets of tasks of one robot, with their shortest routes."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from crazychoir.errors import InstanceError, SolverError
from crazychoir.routing.instance.vehicle import (
    OBJECTIVE_NAMES,
    ROUNDING_SLACK,
    Vehicle,
)
from crazychoir.routing.pricing.label_setting import (
    FinalLabels,
    compute_final_labels,
    list_bits,
)
from crazychoir.routing.pricing.labels import MOST_TASKS, compute_reduced_costs
from crazychoir.types import Ints, Vec, Words

MOST_TABLE_LABELS = 3_000_000
"""Largest number of labels of one table.

It takes some 350 MB while it is computed. Of 20 robots with 40 tasks within 25 m, one may need
two million labels.
"""
TOO_MANY_LABELS = "more labels than allowed"


@dataclass(frozen=True, order=True)
class RouteColumn:
    """A set of tasks that one robot can serve, and the cost of its best route."""

    length: float
    """m, with the fixed cost of leaving. If the makespan comes first: s, when the robot is done."""
    tasks: tuple[int, ...]
    """The tasks, increasing."""


class RouteTable:
    """All columns of one robot, computed once; pricing is then a scalar product for each column.

        reduced cost of c at prices pi:   length_c - sum_{j in c} pi_j

    A column is a set of tasks with its best route. Label setting finds these routes exactly: a label
    is dropped only if it exceeds the capacity or a time window, cannot reach the end within the
    limits, or is dominated by a label with the same tasks picked up, tasks on board and last stop.

    Columns are sorted by (length, tasks). The first is the idle column, without tasks and with
    length 0. A robot with goods on board has no idle column, and all its columns contain these tasks.

    vehicle: the robot.
    most: largest number of labels.
    objective: names of the objectives, the most important first.
    `complete`: False if there were more than `most` labels. Columns of many tasks are then missing,
        and prices prove no bound.
    `length`: (n,), value of the first objective.
    `second`: (n,), least value of the other objective among the routes with this `length`; nan if
        times have no effect.
    Raises InstanceError if the robot could serve more than MOST_TASKS tasks.
    """

    def __init__(
        self,
        vehicle: Vehicle,
        most: int = MOST_TABLE_LABELS,
        objective: tuple[str, ...] = (OBJECTIVE_NAMES.total,),
    ) -> None:
        servable = vehicle.servable
        labels = compute_final_labels(
            restrict_vehicle(vehicle, servable), most, objective
        )
        self.complete = labels.complete
        first, second = _compute_amounts(labels, objective, vehicle.fixed)
        best = _select_best_labels(labels.picked, first, second)
        members = [
            tuple(servable[list_bits(row)].tolist()) for row in labels.picked[best]
        ]
        order = sorted(range(len(best)), key=lambda c: (first[best[c]], members[c]))
        idle = [] if vehicle.aboard.any() else [()]
        sets = [*idle, *(members[c] for c in order)]
        self.length: Vec = np.concatenate([np.zeros(len(idle)), first[best][order]])
        self.second: Vec = np.concatenate([np.zeros(len(idle)), second[best][order]])
        self.start: Ints = np.cumsum([0, *map(len, sets)], dtype=np.int64)
        self.task: Ints = np.array([j for tasks in sets for j in tasks], dtype=np.int64)
        self._where: dict[tuple[int, ...], int] | None = None

    def __len__(self) -> int:
        return len(self.length)

    def column(self, c: int) -> RouteColumn:
        """Return column number c."""
        return RouteColumn(
            float(self.length[c]),
            tuple(int(j) for j in self.task[self.start[c] : self.start[c + 1]]),
        )

    def reduced_costs(self, prices: Vec, reward: float = 0.0) -> Vec:
        """Return the reduced costs of all columns, (len(self),) m.

        prices: (M,) m, -inf forbids a task.
        reward: m, subtracted from all but the idle column.
        """
        cost = np.asarray(
            compute_reduced_costs(self.length, self.start, self.task, prices)
        )
        return cost - reward * (np.diff(self.start) > 0) if reward else cost

    def cheapest(
        self, prices: Vec, count: int, below: float, reward: float = 0.0
    ) -> list[RouteColumn]:
        """Return the columns with the least reduced costs, in increasing order.

        prices: (M,) m.
        count: largest number of columns.
        below: m; only columns with a reduced cost below this are returned.
        reward: m, subtracted from the cost of all columns but the idle one.
        Columns with equal costs are in the order of the table.
        """
        cost = self.reduced_costs(prices, reward)
        candidates = np.flatnonzero(cost < below)
        best = candidates[np.argsort(cost[candidates], kind="stable")[:count]]
        return [self.column(int(c)) for c in best]

    @property
    def size(self) -> int:
        """Number of columns without the idle one."""
        return int(np.count_nonzero(np.diff(self.start)))

    def within(
        self, prices: Vec, below: float, most: float = np.inf, reward: float = 0.0
    ) -> list[RouteColumn] | None:
        """Return all columns but the idle one with a reduced cost below `below`.

        Returns None if there are more than `most`.

        prices: (M,) m.
        below: m.
        most: columns, at most.
        reward: m, subtracted from the reduced cost of each column.
        """
        near = (self.reduced_costs(prices, reward) < below) & (np.diff(self.start) > 0)
        if np.count_nonzero(near) > most:
            return None
        return [self.column(int(c)) for c in np.flatnonzero(near)]

    def least(self, prices: Vec, reward: float = 0.0) -> float:
        """Return the least reduced cost; at most 0, which is that of the idle column."""
        return float(self.reduced_costs(prices, reward).min())

    def find(self, tasks: Sequence[int]) -> RouteColumn | None:
        """Return the column that serves exactly `tasks`, None if there is none."""
        if self._where is None:
            self._where = {self.column(c).tasks: c for c in range(len(self))}
        c = self._where.get(tuple(sorted(tasks)))
        return None if c is None else self.column(c)


def exceeds_label_limit(vehicle: Vehicle, most: int) -> bool:
    """Return whether a table needs more than `most` labels, as far as this is known without one.

    Without limits on length, time and trips, the robot can have any set A of tasks on board that it
    can carry, after the delivery of any other set D. The last stop is a pickup of A, or a delivery
    of D if A is empty:

        labels >= sum_A |A| 2^(m - |A|) + m 2^(m - 1),   m = number of tasks that it can serve

    Returns False if the robot has such limits or goods on board: then only a table can tell.
    """
    if vehicle.timed or np.isfinite(vehicle.farthest) or vehicle.aboard.any():
        return False
    loads = vehicle.load[vehicle.servable].tolist()
    loaded = {(0, 0.0): 1}  # number of sets A, by their size and load
    for done, load in enumerate(loads, 1):
        for (size, weight), count in list(loaded.items()):
            if weight + load <= vehicle.capacity + ROUNDING_SLACK:
                key = (size + 1, weight + load)
                loaded[key] = loaded.get(key, 0) + count
        labels = done * 2 ** (done - 1)
        for (size, _), count in loaded.items():
            labels += size * count * 2 ** (done - size)
        if labels > most:
            return True
    return False


def find_shortest_route(
    vehicle: Vehicle,
    tasks: Sequence[int],
    objective: tuple[str, ...] = (OBJECTIVE_NAMES.total,),
    most: int = MOST_TABLE_LABELS,
) -> tuple[list[int], float]:
    """Return nodes and length in m of the best route that serves exactly `tasks`.

    The best route is the shortest, or the route that ends first, by the objective. Exact.
    A node is j for the pickup of task j, M + j for its delivery, and 2M + 1 for a stop at the end
    between two trips; start and end are left out.

    vehicle: the robot.
    tasks: the set to serve.
    objective: what is minimised, in order.
    most: labels, at most.
    Raises SolverError if no route within its limits serves them, or if there are more than `most`
    labels.
    """
    chosen = np.array(sorted(tasks), dtype=np.int64)
    if not len(chosen) and not vehicle.aboard.any():
        return [], 0.0
    where = f"robot {vehicle.robot}: a tour of tasks {chosen.tolist()}"
    left = np.setdiff1d(np.flatnonzero(vehicle.aboard), chosen)
    if len(left) or not (vehicle.capable | vehicle.aboard)[chosen].all():
        raise SolverError(
            where,
            f"infeasible: it carries {left.tolist()}" if len(left) else "infeasible",
        )
    labels = compute_final_labels(restrict_vehicle(vehicle, chosen), most, objective)
    full = np.flatnonzero(labels.count == len(chosen))
    if not len(full):
        raise SolverError(where, "infeasible" if labels.complete else TOO_MANY_LABELS)
    first, second = _compute_amounts(labels, objective, 0.0)
    best = int(full[np.lexsort((second[full], first[full]))[0]])
    return labels.route(best, chosen, vehicle.tasks), float(labels.length[best])


def restrict_vehicle(vehicle: Vehicle, chosen: Ints) -> Vehicle:
    """Return the vehicle with the tasks `chosen` alone.

    Raises InstanceError if there are more than MOST_TASKS.
    """
    if len(chosen) > MOST_TASKS:
        where = f"robot {vehicle.robot}: tasks that it could serve"
        do = "Narrow capability or route_length_limit."
        raise InstanceError(where, len(chosen), f"at most {MOST_TASKS}", do)
    return vehicle.only(chosen)


def _compute_amounts(
    labels: FinalLabels, objective: tuple[str, ...], fixed: float
) -> tuple[Vec, Vec]:
    """Return the first objective and the other one, (n,) each; nan if time decides nothing."""
    cost = labels.length + fixed
    if objective[0] == OBJECTIVE_NAMES.makespan:
        return labels.finish, cost
    return cost, labels.finish


def _select_best_labels(picked: Words, first: Vec, second: Vec) -> Ints:
    """Return the best label of each set except the empty one."""
    order = np.lexsort((second, first, picked[:, 0], picked[:, 1]))
    order = order[picked[order].any(axis=1)]
    new = np.ones(len(order), dtype=bool)
    new[1:] = (picked[order[1:]] != picked[order[:-1]]).any(axis=1)
    return order[new]
