"""Exact assignment of tasks to robots by the distributed simplex.

New tables of tasks may come while it runs.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from math import inf
from typing import Any

import numpy as np

from crazychoir.errors import ConfigError, SolverError
from crazychoir.optimization.algorithms.simplex import BasisExchange
from crazychoir.optimization.problems.lexicographic import ProgramColumns, unite_columns
from crazychoir.team.graph import describe_ids
from crazychoir.types import Vec, Wire


class Task(Wire, frozen=True, array_like=True, gc=False):
    """One thing to do."""

    id: int
    """Id, unique in its table."""
    p: Vec
    """(3,) m, world: position of the task."""


class TaskTable(Wire, frozen=True, array_like=True, gc=False):
    """The tasks of one generation."""

    label: int
    """Number of the table; newer tables have higher labels."""
    tasks: tuple[Task, ...]
    """The tasks, in any order."""
    last: bool = False
    """True if no other table comes, so that the robots end after this one."""


@dataclass(frozen=True)
class AssignmentOutcome:
    """The agreement of the team on one table."""

    label: int
    """Label of the table."""
    task: Task | None
    """Task of this robot, or None."""
    cost: float
    """Sum of the costs of all robots."""
    unserved: tuple[int, ...]
    """Ids of the tasks without a robot."""
    infeasible: str
    """Reason why not all that should be served are served, or ""."""
    rounds: int
    """Number of rounds since this robot learned of the table."""


class TaskAssignment:
    """Robot i's part of the assignment problem, for one table after the other: a Round.

        min  sum_ik c_ik x_ik
        s.t. sum_k x_ik = 1 (each robot),  sum_i x_ik = 1 (each task),  x >= 0

    There is an x_ik only if robot i may do task k. If there are fewer tasks than robots, the rows
    of the robots are "<= 1": all tasks are done, at the least cost. If there are more tasks than
    robots, the rows of the tasks are "<= 1": all robots have a task.
    The optimal basis of this program is integral. Costs stay with the robots, except those of a
    basis, which has at most N + M columns and travels.
    If not all can be served (a task that no robot may do, or two robots that may do only the same
    task), as many as possible are served, at the least cost. `infeasible` then names a set of tasks
    that too few robots may do (Hall's condition). It comes from the certificate of the linear
    program.
    `post` gives any robot a newer table. The table spreads with the messages, and the assignment
    starts again. `outcome` is the last agreement, reached by all robots in the same round. The team
    is done after the outcome of a table marked as the last.

    robot: id of this robot
    cost: returns c_ik of a task, inf if the robot may not do it
    robots: ids of all robots
    diameter: D, see DistributedSimplex
    table: first table, or None
    Raises ConfigError if a cost is not a number, or if two tables have the same label.
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
        table: TaskTable | None = None,
    ) -> None:
        self._where = f"robot {robot}: task assignment"
        if robot not in robots:
            raise ConfigError(self._where, f"robot {robot}", describe_ids(robots))
        self._robot = robot
        self._cost = cost
        self._robots = sorted(robots)
        self.diameter = diameter
        self._table: TaskTable | None = None
        self.outcome: AssignmentOutcome | None = None
        if table is not None:
            self.post(table)

    def post(self, table: TaskTable) -> None:
        """Give this robot a table; ignore it unless it is newer than all known tables.

        Raises ConfigError if a known table has the same label and other tasks.
        """
        if (
            self._table is not None
            and table.label == self._table.label
            and _list_task_ids(table) != _list_task_ids(self._table)
        ):
            do = "Number the tables in one place."
            raise ConfigError(
                f"{self._where}: table {table.label}",
                _list_task_ids(table),
                f"tasks {_list_task_ids(self._table)}",
                do,
            )
        if self._table is None or table.label > self._table.label:
            self._table = table
            self._age = 0
            self._program = _AssignmentProgram(
                self._robot, self._robots, table.tasks, self._costs(table.tasks)
            )
            self._bases = self._program.exchange(self.diameter)

    @property
    def label(self) -> int | None:
        """Label of the newest table that this robot knows, or None."""
        return None if self._table is None else self._table.label

    @property
    def settled(self) -> bool:
        """True if `outcome` belongs to the newest table that this robot knows."""
        return self.outcome is not None and self.outcome.label == self.label

    @property
    def done(self) -> bool:
        """True if the robots have agreed on the last table."""
        return self._table is not None and self._table.last and self.settled

    def message(self) -> Any:
        """Return the label, the flag of the last table, the tasks, and the basis.

        The tasks are included only for the first D rounds of a table. After the agreement the
        message is the label alone.
        """
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
        """Start a newer table if one has arrived, then improve the basis."""
        for message in heard.values():
            if message is not None and len(message) > 1 and message[2] is not None:
                label, last, tasks = message[:3]
                self.post(
                    TaskTable(
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
        """Return the basis of a neighbour, or None if it is of another table."""
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
    def solution(self) -> AssignmentOutcome:
        """The outcome; raises SolverError if there is none yet, or if the table is infeasible."""
        if self.outcome is None:
            raise SolverError(self._where, "not agreed upon yet")
        if self.outcome.infeasible:
            raise SolverError(
                f"{self._where}: table {self.outcome.label}",
                f"infeasible: {self.outcome.infeasible}",
            )
        return self.outcome


class _AssignmentProgram:
    """The linear program of one table.

    Rows: robots, then tasks.
    Columns: first columns with a single row, then the allowed pairs of this robot. All robots know
    the columns with a single row; they are dealt out to the robots so that each has a name. Such a
    column says that its row may stay below 1, at no cost. If the row should be served, the column
    has a first cost of 1. So as many rows as possible are served, before c counts.
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
        """Return this robot's part of the exchange of bases."""
        n = len(self._robots)
        m = len(self._tasks)
        pairs = len(self._allowed)
        must = range(n, n + m) if m <= n else range(n)
        singles = [self._singles(i) for i in range(n)]
        common = unite_columns(
            [
                ProgramColumns.own(
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
        """Return the rows with a single-row column of the i-th robot.

        They are the robot's own row, and its share of the tasks.
        """
        n = len(self._robots)
        return [i, *(n + k for k in range(i, len(self._tasks), n))]

    def outcome(
        self, label: int, bases: BasisExchange, rounds: int
    ) -> AssignmentOutcome:
        """Return the outcome that the common basis describes."""
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
        return AssignmentOutcome(
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
        """Name a set that violates Hall's condition.

        y: the certificate. It is 1 at rows that compete, and -1 at all rows that are open to them
        """
        robots, tasks = (
            np.array(names)
            for names in (self._robots, [task.id for task in self._tasks])
        )
        of_robots = np.round(y[: len(robots)])
        of_tasks = np.round(y[len(robots) :])
        if len(tasks) <= len(robots):
            few = robots[of_robots < 0]
            many = tasks[of_tasks > 0]
            return f"task(s) {_format_ids(many)} may be done by {_describe_only(few, 'robot')}"
        few = tasks[of_tasks < 0]
        many = robots[of_robots > 0]
        return f"robot(s) {_format_ids(many)} may do {_describe_only(few, 'task')}"


def _format_ids(ids: Any) -> str:
    return ", ".join(str(i) for i in ids)


def _describe_only(ids: Any, what: str) -> str:
    return (
        f"{len(ids)} {what}(s) only: {_format_ids(ids)}" if len(ids) else f"no {what}"
    )


def _list_task_ids(table: TaskTable) -> list[int]:
    return [task.id for task in table.tasks]
