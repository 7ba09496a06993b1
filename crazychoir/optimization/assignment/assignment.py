"""Who does which task: exact assignment by the distributed simplex, with tables of tasks that come while it runs."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from math import inf
from typing import Any

import numpy as np

from crazychoir.errors import ConfigError, SolverError
from crazychoir.optimization.algorithms.simplex import BasisExchange
from crazychoir.optimization.problems.lexicographic import Columns, union
from crazychoir.team.graph import span
from crazychoir.types import Vec, Wire


class Task(Wire, frozen=True, array_like=True, gc=False):
    """One thing to do. id: unique in its table;  p: (3,) m, world, where."""

    id: int
    p: Vec


class Table(Wire, frozen=True, array_like=True, gc=False):
    """The tasks of one generation. label: of newer tables higher;  last: no other comes, the robots end with it."""

    label: int
    tasks: tuple[Task, ...]
    last: bool = False


@dataclass(frozen=True)
class Outcome:
    """What the team agreed on for one table.

    task: of this robot, None if it has none;  cost: sum of all robots' costs;  unserved: ids of tasks that nobody does;
    infeasible: why not all that should be served are, "" if they are;  rounds: since this robot knew of the table.
    """

    label: int
    task: Task | None
    cost: float
    unserved: tuple[int, ...]
    infeasible: str
    rounds: int


class TaskAssignment:
    """Robot i's part of the assignment problem, for one table after the other: a Round.

        min  sum_ik c_ik x_ik   s.t.  sum_k x_ik = 1 (each robot),  sum_i x_ik = 1 (each task),  x >= 0

    x_ik only where robot i may do task k. Where there are fewer tasks than robots, "= 1" is "<= 1" for robots: all
    tasks are done, at the least cost; where there are more, for tasks: all robots have one. Costs stay with the robots,
    but for those of a basis, N + M columns at most, that travel. The optimal basis of this program is integral.
    Where some must stay without (a task that nobody may do, two robots that may do the same one task), as many as
    possible are served, at the least cost, and `infeasible` names a set of tasks that too few robots may do
    (Hall's condition), from the certificate of the linear program.
    A newer table, told to any robot by `post`, spreads with the messages and starts all anew; `outcome` is the last one
    agreed upon, by all robots in the same round. The team is done with the outcome of a table that is the last.
    cost: c_i of a task, inf if the robot may not do it;  robots: ids of all;  diameter: as in DistributedSimplex.
    Raises ConfigError for a cost that is not a number, and if two tables have one label.
    Source: Buerger, Notarstefano, Bullo & Allgoewer 2012, Automatica 48, 2298-2304.
    """

    heavy = True
    connected = True

    def __init__(
        self,
        robot: int,
        cost: Callable[[Task], float],
        robots: Sequence[int],
        diameter: int,
        table: Table | None = None,
    ) -> None:
        self._where = f"robot {robot}: task assignment"
        if robot not in robots:
            raise ConfigError(self._where, f"robot {robot}", span(robots))
        self._robot = robot
        self._cost = cost
        self._robots = sorted(robots)
        self.diameter = diameter
        self._table: Table | None = None
        self.outcome: Outcome | None = None
        if table is not None:
            self.post(table)

    def post(self, table: Table) -> None:
        """Tell this robot of a table; what it has already heard of, or of a newer one, is nothing new."""
        if (
            self._table is not None
            and table.label == self._table.label
            and _ids(table) != _ids(self._table)
        ):
            do = "Number the tables in one place."
            raise ConfigError(
                f"{self._where}: table {table.label}",
                _ids(table),
                f"tasks {_ids(self._table)}",
                do,
            )
        if self._table is None or table.label > self._table.label:
            self._table = table
            self._age = 0
            self._program = _Program(
                self._robot, self._robots, table.tasks, self._costs(table.tasks)
            )
            self._bases = self._program.exchange(self.diameter)

    @property
    def label(self) -> int | None:
        """Of the table that is being worked on, or that was last."""
        return None if self._table is None else self._table.label

    @property
    def settled(self) -> bool:
        """Whether `outcome` is that of the newest table that this robot knows of."""
        return self.outcome is not None and self.outcome.label == self.label

    @property
    def done(self) -> bool:
        """Whether the last table is agreed upon."""
        return self._table is not None and self._table.last and self.settled

    def message(self) -> Any:
        """Label and basis, with the table itself as long as it may be news; the label alone once all agree."""
        if self._table is None:
            return None
        if self.settled:
            return [self._table.label]
        news = (
            [[task.id, task.p] for task in self._table.tasks]
            if self._age < self.diameter
            else None
        )
        return [self._table.label, self._table.last, news, *self._bases.message()]

    def step(self, heard: Mapping[int, Any]) -> None:
        """Take up a newer table; else improve the basis."""
        for message in heard.values():
            if message is not None and len(message) > 1 and message[2] is not None:
                label, last, tasks = message[:3]
                self.post(
                    Table(
                        label, tuple(Task(id_, np.asarray(p)) for id_, p in tasks), last
                    )
                )
        if self._table is None or self.settled:
            return
        self._age += 1
        self._bases.step({j: self._same(message) for j, message in heard.items()})
        if self._bases.settled:
            self.outcome = self._program.outcome(
                self._table.label, self._bases, self._age
            )

    def _same(self, message: Any) -> Any:
        """A neighbour's basis, if it is of our table."""
        known = message is not None and len(message) > 1 and message[0] == self.label
        return message[3:] if known else None

    def _costs(self, tasks: Sequence[Task]) -> Vec:
        costs = np.array([self._cost(task) for task in tasks], dtype=float)
        for task, value in zip(tasks, costs, strict=True):
            if np.isnan(value) or value == -inf:
                raise ConfigError(
                    f"{self._where}: cost of task {task.id}",
                    f"{value}",
                    "a number, or inf: not allowed",
                )
        return costs

    @property
    def solution(self) -> Outcome:
        """The outcome; SolverError while there is none, and where the table is infeasible."""
        if self.outcome is None:
            raise SolverError(self._where, "not agreed upon yet")
        if self.outcome.infeasible:
            raise SolverError(
                f"{self._where}: table {self.outcome.label}",
                f"infeasible: {self.outcome.infeasible}",
            )
        return self.outcome


class _Program:
    """The linear program of one table.

    Rows: robots, then tasks. Columns: those of single rows, which all robots know and which are dealt out to be named,
    then own allowed pairs. Those of single rows say that a row may stay below 1, at no cost, or that one must stay
    without: a first cost of 1, so that as many as possible are served, before c counts.
    """

    def __init__(
        self, robot: int, robots: Sequence[int], tasks: Sequence[Task], costs: Vec
    ) -> None:
        self._robot = robot
        self._robots = robots
        self._tasks = sorted(tasks, key=lambda task: task.id)
        ids = [task.id for task in tasks]
        if len(dict.fromkeys(ids)) < len(ids):
            raise ConfigError(
                f"robot {robot}: task table", f"ids {ids}", "each id once"
            )
        cost_of = dict(zip(ids, costs, strict=True))
        self._allowed = [
            k for k, task in enumerate(self._tasks) if cost_of[task.id] < inf
        ]
        self._c = np.array([cost_of[self._tasks[k].id] for k in self._allowed])

    def exchange(self, diameter: int) -> BasisExchange:
        """The part of this robot."""
        n = len(self._robots)
        m = len(self._tasks)
        pairs = len(self._allowed)
        must = range(n, n + m) if m <= n else range(n)
        singles = [self._singles(i) for i in range(n)]
        common = union(
            [
                Columns.own(
                    robot,
                    np.zeros(len(rows)),
                    np.eye(n + m)[:, rows],
                    np.isin(rows, must).astype(float),
                )
                for robot, rows in zip(self._robots, singles, strict=True)
            ]
        )
        i = self._robots.index(self._robot)
        entries = np.zeros((n + m, pairs))
        entries[i] = 1.0
        entries[[n + k for k in self._allowed], range(pairs)] = 1.0
        entries = np.hstack([np.eye(n + m)[:, singles[i]], entries])
        first = np.concatenate([np.isin(singles[i], must), np.zeros(pairs)])
        c = np.concatenate([np.zeros(len(singles[i])), self._c])
        return BasisExchange(
            self._robot, c, entries, np.ones(n + m), diameter, first, common
        )

    def _singles(self, i: int) -> list[int]:
        """Return the rows that have a column of the i-th robot alone: its own, and tasks that are dealt in turn."""
        n = len(self._robots)
        return [i, *(n + k for k in range(i, len(self._tasks), n))]

    def outcome(self, label: int, bases: BasisExchange, rounds: int) -> Outcome:
        """What the common basis says."""
        n = len(self._robots)
        pairs = bases.x[len(self._singles(self._robots.index(self._robot))) :]
        mine = [k for k, x in zip(self._allowed, pairs, strict=True) if x > 0.5]
        columns = bases.basis.columns
        level = bases.basis.level
        pair = (
            (columns.ids[:, 0] >= 0) & (columns.entries[:n].any(axis=0)) & (level > 0.5)
        )
        pair &= columns.entries[n:].any(axis=0)
        served = columns.entries[n:, pair].sum(axis=1) > 0.5
        without = float(columns.cost[0] @ level)
        infeasible = "" if without < 0.5 else self._why(bases.certificate)
        if bases.failure is not None:
            infeasible = bases.failure
        return Outcome(
            label=label,
            task=self._tasks[mine[0]] if mine else None,
            cost=bases.cost,
            unserved=tuple(
                task.id
                for task, done in zip(self._tasks, served, strict=True)
                if not done
            ),
            infeasible=infeasible,
            rounds=rounds,
        )

    def _why(self, y: Vec) -> str:
        """Hall's condition, broken: y = 1 at those who compete, -1 at all that is open to them."""
        robots, tasks = (
            np.array(names)
            for names in (self._robots, [task.id for task in self._tasks])
        )
        of_robots = np.round(y[: len(robots)])
        of_tasks = np.round(y[len(robots) :])
        if len(tasks) <= len(robots):
            few = robots[of_robots < 0]
            many = tasks[of_tasks > 0]
            return f"task(s) {_names(many)} may be done by {_only(few, 'robot')}"
        few = tasks[of_tasks < 0]
        many = robots[of_robots > 0]
        return f"robot(s) {_names(many)} may do {_only(few, 'task')}"


def _names(ids: Any) -> str:
    return ", ".join(str(i) for i in ids)


def _only(ids: Any, what: str) -> str:
    return f"{len(ids)} {what}(s) only: {_names(ids)}" if len(ids) else f"no {what}"


def _ids(table: Table) -> list[int]:
    return [task.id for task in table.tasks]
