"""Exact route pricing: every feasible set of tasks of one robot with the length of its shortest tour."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from crazychoir.errors import InstanceError, SolverError
from crazychoir.routing.instance import LocalProblem
from crazychoir.routing.labels import MOST_TASKS, Ints, Problem, Words, grow_labels, reduced_costs
from crazychoir.routing.vehicle import SLACK
from crazychoir.types import Vec

MOST_LABELS = 4_000_000


@dataclass(frozen=True, order=True)
class Column:
    """A set of tasks that one robot can serve, with the length in m of its shortest closed tour."""

    length: float
    tasks: tuple[int, ...]


class RouteTable:
    """All columns of one robot, made once; pricing is then a scalar product a column.

        reduced cost of c at prices pi:   length_c - sum_{j in c} pi_j

    The labels behind it are exact: their key is (picked set, set on board, last stop), they are cut only by
    capacity and by the shortest way home. `complete` is False if there were more than `most` labels: then
    columns of many tasks are missing, and no bound follows from a price.
    Columns are in the order (length, tasks); the idle column, no task and length 0, is the first.
    Raises InstanceError if the robot could serve more than MOST_TASKS tasks.
    """

    def __init__(self, local: LocalProblem, most: int = MOST_LABELS) -> None:
        servable = local.servable
        problem = _restricted(local, servable)
        keys, last, length, _, self.complete = grow_labels(problem, most)
        home = (keys[:, 2] == 0) & (keys[:, 3] == 0)
        total = length[home] + problem[0][last[home], 2 * len(servable)]
        sets, total = _shortest_of_each(keys[home, :2], total)
        members = [servable[_bits(row)] for row in sets]
        order = sorted(range(len(members)), key=lambda c: (total[c], tuple(members[c])))
        self.length: Vec = total[order]
        self.start: Ints = np.concatenate([[0], np.cumsum([len(members[c]) for c in order])]).astype(np.int64)
        self.task: Ints = np.concatenate([members[c] for c in order]).astype(np.int64)
        self._where: dict[tuple[int, ...], int] | None = None

    def __len__(self) -> int:
        return len(self.length)

    def column(self, c: int) -> Column:
        """Column number c."""
        return Column(float(self.length[c]), tuple(int(j) for j in self.task[self.start[c] : self.start[c + 1]]))

    def reduced_costs(self, prices: Vec) -> Vec:
        """(len(self),) m, of all columns; prices: (M,) m, -inf forbids a task."""
        return np.asarray(reduced_costs(self.length, self.start, self.task, prices))

    def cheapest(self, prices: Vec, count: int, below: float) -> list[Column]:
        """At most `count` columns with a reduced cost under `below`, the least first, ties in the table's order."""
        cost = self.reduced_costs(prices)
        candidates = np.flatnonzero(cost < below)
        best = candidates[np.argsort(cost[candidates], kind="stable")[:count]]
        return [self.column(int(c)) for c in best]

    def least(self, prices: Vec) -> float:
        """The least reduced cost; at most 0, that of the idle column."""
        return float(self.reduced_costs(prices).min())

    def find(self, tasks: Sequence[int]) -> Column | None:
        """The column that serves exactly `tasks`, if there is one."""
        if self._where is None:
            self._where = {self.column(c).tasks: c for c in range(len(self))}
        c = self._where.get(tuple(sorted(tasks)))
        return None if c is None else self.column(c)


def shortest_route(local: LocalProblem, tasks: Sequence[int]) -> tuple[list[int], float]:
    """Stops and length in m of the shortest tour of `local` serving exactly `tasks`.

    A stop is j for the pickup of task j and M + j for its delivery; home is left out.
    Raises SolverError if no tour within capacity and limit serves them.
    """
    chosen = np.array(sorted(tasks), dtype=np.int64)
    if not len(chosen):
        return [], 0.0
    problem = _restricted(local, chosen)
    keys, last, length, parent, _ = grow_labels(problem, np.iinfo(np.int64).max)
    everything = (1 << len(chosen)) - 1
    target = np.array([everything & (1 << 64) - 1, everything >> 64, 0, 0], dtype=np.uint64)
    full = np.flatnonzero((keys == target).all(axis=1))
    if not len(full) or not local.capable[chosen].all():
        raise SolverError(f"robot {local.robot}: a tour of tasks {chosen.tolist()}", "infeasible")
    total = length[full] + problem[0][last[full], 2 * len(chosen)]
    label = int(full[np.argmin(total)])
    return _stops(label, last, parent, chosen, len(local.tasks)), float(total.min())


def _stops(label: int, last: Ints, parent: Ints, chosen: Ints, m: int) -> list[int]:
    stops = []
    while parent[label] >= 0:
        at = int(last[label])
        stops.append(int(chosen[at]) if at < len(chosen) else m + int(chosen[at - len(chosen)]))
        label = int(parent[label])
    return stops[::-1]


def _restricted(local: LocalProblem, chosen: Ints) -> Problem:
    """Distances, loads, capacity and limit for the tasks `chosen` alone; InstanceError if no set can hold them."""
    if len(chosen) > MOST_TASKS:
        where, do = f"robot {local.robot}: tasks that it could serve", "Narrow capability or route_length_limit."
        raise InstanceError(where, len(chosen), f"at most {MOST_TASKS}", do)
    m = len(local.tasks)
    nodes = np.concatenate([chosen, m + chosen, [2 * m]])
    distance = np.ascontiguousarray(local.vehicle.distance[np.ix_(nodes, nodes)])
    return distance, local.tasks.load[chosen], local.capacity + SLACK, local.limit + SLACK


def _shortest_of_each(sets: Words, total: Vec) -> tuple[Words, Vec]:
    order = np.lexsort((total, sets[:, 0], sets[:, 1]))
    sets, total = sets[order], total[order]
    first = np.concatenate([[True], (sets[1:] != sets[:-1]).any(axis=1)])
    return sets[first], total[first]


def _bits(words: Words) -> list[int]:
    value = int(words[0]) | int(words[1]) << 64
    return [b for b in range(value.bit_length()) if value >> b & 1]
