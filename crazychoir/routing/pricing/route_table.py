"""Exact route pricing: every feasible set of tasks of one robot with the length of its shortest tour."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from crazychoir.errors import InstanceError, SolverError
from crazychoir.routing.instance.vehicle import MAKESPAN, TOTAL, Vehicle
from crazychoir.routing.pricing.label_setting import FinalLabels, bits_of, final_labels
from crazychoir.routing.pricing.labels import MOST_TASKS, reduced_costs
from crazychoir.types import Ints, Vec, Words

MOST_LABELS = 3_000_000
"""Of one table, some 350 MB while it is made; of 20 robots with 40 tasks within 25 m one may need two millions."""
TOO_MANY = "more labels than allowed"


@dataclass(frozen=True, order=True)
class Column:
    """A set of tasks that one robot can serve, and what its best route adds to the first objective.

    length: m, with the fixed cost of leaving; or, where the makespan comes first, the time in s when it is done.
    """

    length: float
    tasks: tuple[int, ...]


class RouteTable:
    """All columns of one robot, made once; pricing is then a scalar product a column.

        reduced cost of c at prices pi:   length_c - sum_{j in c} pi_j

    The labels behind it are exact: their key is (picked set, set on board, last stop), they are cut only by
    capacity, windows and lower bounds of the way home. `complete` is False if there were more than `most` labels: then
    columns of many tasks are missing, and no bound follows from a price.
    length: (n,), of the first objective;  second: (n,), of the other one, for the shortest, or soonest, route of the
    set: of those with the least `length` it has the least `second`; nan where time decides nothing.
    Columns are in the order (length, tasks), but the idle column, no task and length 0, is the first; a robot with
    goods aboard has none, and all its columns hold those goods.
    Raises InstanceError if the robot could serve more than MOST_TASKS tasks.
    """

    def __init__(
        self,
        vehicle: Vehicle,
        most: int = MOST_LABELS,
        objective: tuple[str, ...] = (TOTAL,),
    ) -> None:
        servable = vehicle.servable
        labels = final_labels(of_one_set(vehicle, servable), most, objective)
        self.complete = labels.complete
        first, second = _amounts(labels, objective, vehicle.fixed)
        best = _best_of_each(labels.picked, first, second)
        members = [
            tuple(servable[bits_of(row)].tolist()) for row in labels.picked[best]
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

    def column(self, c: int) -> Column:
        """Column number c."""
        return Column(
            float(self.length[c]),
            tuple(int(j) for j in self.task[self.start[c] : self.start[c + 1]]),
        )

    def reduced_costs(self, prices: Vec, reward: float = 0.0) -> Vec:
        """(len(self),) m, of all columns, of all but the idle one less `reward`; prices: (M,) m, -inf forbids."""
        cost = np.asarray(reduced_costs(self.length, self.start, self.task, prices))
        return cost - reward * (np.diff(self.start) > 0) if reward else cost

    def cheapest(
        self, prices: Vec, count: int, below: float, reward: float = 0.0
    ) -> list[Column]:
        """At most `count` columns with a reduced cost under `below`, the least first, ties in the table's order."""
        cost = self.reduced_costs(prices, reward)
        candidates = np.flatnonzero(cost < below)
        best = candidates[np.argsort(cost[candidates], kind="stable")[:count]]
        return [self.column(int(c)) for c in best]

    def least(self, prices: Vec, reward: float = 0.0) -> float:
        """The least reduced cost; at most 0, that of the idle column."""
        return float(self.reduced_costs(prices, reward).min())

    def find(self, tasks: Sequence[int]) -> Column | None:
        """The column that serves exactly `tasks`, if there is one."""
        if self._where is None:
            self._where = {self.column(c).tasks: c for c in range(len(self))}
        c = self._where.get(tuple(sorted(tasks)))
        return None if c is None else self.column(c)


def shortest_route(
    vehicle: Vehicle,
    tasks: Sequence[int],
    objective: tuple[str, ...] = (TOTAL,),
    most: int = MOST_LABELS,
) -> tuple[list[int], float]:
    """Nodes and length in m of the best route of `vehicle` that serves exactly `tasks`: the shortest, or the soonest.

    A node is j for the pickup of task j, M + j for its delivery, and 2M + 1 for a stop at the end between two trips;
    start and end are left out. Exact.
    Raises SolverError if no route within its limits serves them, or if there are more than `most` labels.
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
    labels = final_labels(of_one_set(vehicle, chosen), most, objective)
    full = np.flatnonzero(labels.count == len(chosen))
    if not len(full):
        raise SolverError(where, "infeasible" if labels.complete else TOO_MANY)
    first, second = _amounts(labels, objective, 0.0)
    best = int(full[np.lexsort((second[full], first[full]))[0]])
    return labels.route(best, chosen, vehicle.tasks), float(labels.length[best])


def of_one_set(vehicle: Vehicle, chosen: Ints) -> Vehicle:
    """With the tasks `chosen` alone; InstanceError if no set can hold them."""
    if len(chosen) > MOST_TASKS:
        where = f"robot {vehicle.robot}: tasks that it could serve"
        do = "Narrow capability or route_length_limit."
        raise InstanceError(where, len(chosen), f"at most {MOST_TASKS}", do)
    return vehicle.only(chosen)


def _amounts(
    labels: FinalLabels, objective: tuple[str, ...], fixed: float
) -> tuple[Vec, Vec]:
    """(n,) of the first objective and of the other one; the latter is 0 where only one is known."""
    cost = labels.length + fixed
    if objective[0] == MAKESPAN:
        return labels.finish, cost
    return cost, labels.finish


def _best_of_each(picked: Words, first: Vec, second: Vec) -> Ints:
    """Of each set but the empty one, the label that is best."""
    order = np.lexsort((second, first, picked[:, 0], picked[:, 1]))
    order = order[picked[order].any(axis=1)]
    new = np.ones(len(order), dtype=bool)
    new[1:] = (picked[order[1:]] != picked[order[:-1]]).any(axis=1)
    return order[new]
