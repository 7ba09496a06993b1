"""One generation of a task table, as rounds.

The robots agree on the open tasks, fill the table up, and assign it.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import inf
from typing import Any

import numpy as np
from msgspec import ValidationError, convert

from crazychoir.errors import CodecError
from crazychoir.guidance.tasks.task_book import Count, Fate, Task, TaskBook
from crazychoir.guidance.tasks.task_source import FIRST_ADDED_ID
from crazychoir.optimization.assignment import assignment
from crazychoir.optimization.assignment.assignment import (
    AssignmentOutcome,
    TaskAssignment,
    TaskTable,
)
from crazychoir.optimization.rounds.agreement import flood_values
from crazychoir.optimization.rounds.program import Exchange, Program
from crazychoir.team.graph import Graph

Draw = Callable[[int], Sequence[Task]]
"""Returns the first n tasks that the team draws, the same at all robots."""
Cost = Callable[[Task], float]
"""Cost of a task for this robot; inf if it cannot do the task."""


@dataclass(frozen=True)
class TableProgress:
    """How far a robot has followed the task table."""

    number: int = 0
    """Number of the last generation that it has been part of, 0 before the first."""
    filled: int = 0
    """How often the table had been filled up then, 0 before the first."""


@dataclass(frozen=True)
class Generation:
    """One robot's part of a generation."""

    number: int
    """Number of the table, from 1 on."""
    filled: int
    """How often the table has been filled up so far."""
    tasks: tuple[Task, ...]
    """The tasks that were open, in the order of their ids."""
    costs: tuple[float, ...]
    """Cost of each task for this robot."""
    outcome: AssignmentOutcome
    """What the team agreed on."""
    book: TaskBook
    """The book from which the table was made, the same at all robots."""
    dropped: dict[int, CodecError]
    """By robot: why its message was ignored."""

    @property
    def progress(self) -> TableProgress:
        """How far a robot with this generation has followed the table."""
        return TableProgress(self.number, self.filled)

    @property
    def mine(self) -> int | None:
        """Id of this robot's task, or None."""
        return None if self.outcome.task is None else self.outcome.task.id

    @property
    def idle(self) -> bool:
        """No robot has a task."""
        return len(self.outcome.unserved) == len(self.tasks)


class NextGeneration(Program[Generation]):
    """A Round that gives each robot of `graph` its part of the same generation.

    All robots end it in the same round.

        flood of books  ->  fill the table up to as many open tasks as robots  ->  TaskAssignment

    No robot stores the table centrally: each computes the same table from all messages. The table
    is filled up at most `most` times, by `draw`. After that the open tasks are assigned until none
    is left. News that a robot receives after its first message counts for the next generation.

    robot: id of this robot.
    graph: of the members, connected and undirected.
    book: what this robot knows.
    progress: how far it has followed the table.
    draw: draws the tasks.
    most: how often the table may be filled up.
    cost: cost of a task for this robot.
    """

    def __init__(
        self,
        robot: int,
        graph: Graph,
        book: TaskBook,
        progress: TableProgress,
        draw: Draw,
        most: int,
        cost: Cost,
    ) -> None:
        self.robot = robot
        self.members = graph.ids
        self.draw = draw
        self.most = most
        self.cost = cost
        self.diameter = graph.diameter() if len(graph.ids) > 1 else 0
        self._mine = [book.wire(), progress.number, progress.filled]
        super().__init__()

    def run(self) -> Exchange[Generation]:
        """Agree on the open tasks, fill the table up, assign it."""
        said = yield from flood_values(self.robot, self._mine, self.diameter)
        book, progress, dropped = _merge_generation(said)
        number = progress.number + 1
        filled = progress.filled
        missing = len(self.members) - len(list_open_tasks(book, self.members))
        if filled < self.most and missing > 0:
            filled += 1
            drawn = sum(j < FIRST_ADDED_ID for j in book.tasks)
            for task in self.draw(drawn + missing)[drawn:]:
                book.learn(task)
        tasks = list_open_tasks(book, self.members)
        costs = tuple(
            self.cost(task) if self.robot in task.robots or not task.robots else inf
            for task in tasks
        )
        outcome = yield from self._assigned(
            number, tasks, dict(zip((t.id for t in tasks), costs, strict=True))
        )
        return Generation(number, filled, tasks, costs, outcome, book, dropped)

    def _assigned(
        self, number: int, tasks: tuple[Task, ...], costs: dict[int, float]
    ) -> Exchange[AssignmentOutcome]:
        """Return the cheapest assignment, by the distributed simplex. Without tasks it is empty."""
        if not tasks:
            return AssignmentOutcome(number, None, 0.0, (), "", 0)
        rows = tuple(assignment.Task(task.id, np.array(task.pickup)) for task in tasks)
        table = TaskTable(number, rows, last=True)
        solver = TaskAssignment(
            self.robot, lambda task: costs[task.id], self.members, self.diameter, table
        )
        while not solver.done:
            solver.step((yield solver.message()))
        assert solver.outcome is not None  # noqa: S101 - it is done
        return solver.outcome


def list_open_tasks(book: TaskBook, members: Sequence[int]) -> tuple[Task, ...]:
    """Return the tasks that are neither done nor cancelled, in the order of their ids."""
    standings = book.standings(members, recover=True)
    return tuple(
        book.tasks[j] for j, standing in standings.items() if standing.fate is Fate.OPEN
    )


def _merge_generation(
    said: dict[int, Any],
) -> tuple[TaskBook, TableProgress, dict[int, CodecError]]:
    """Combine the messages of all robots.

    Returns the book, how far any robot has followed the table, and by robot why its message was
    ignored.
    """
    book = TaskBook()
    progress = TableProgress()
    dropped = dict[int, CodecError]()
    for i, value in said.items():
        try:
            wire, number, filled = _read_generation(value)
            book.merge(TaskBook.of(wire))
            progress = TableProgress(
                max(progress.number, number), max(progress.filled, filled)
            )
        except CodecError as error:
            dropped[i] = error
    return book, progress, dropped


def _read_generation(value: Any) -> tuple[bytes, int, int]:
    try:
        return convert(value, tuple[bytes, Count, Count])
    except ValidationError as error:
        raise CodecError(f"generation: {error}") from error
