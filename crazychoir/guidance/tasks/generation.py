"""One generation of a task table, as rounds: agree on what is open, fill the table up, assign it."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import inf
from typing import Any

import numpy as np
from msgspec import ValidationError, convert

from crazychoir.errors import CodecError
from crazychoir.guidance.tasks.task_book import Count, Fate, Task, TaskBook
from crazychoir.guidance.tasks.task_source import ADDED
from crazychoir.optimization.assignment import assignment
from crazychoir.optimization.assignment.assignment import Outcome, Table, TaskAssignment
from crazychoir.optimization.rounds.agreement import flood
from crazychoir.optimization.rounds.program import Exchange, Program
from crazychoir.team.graph import Graph

Draw = Callable[[int], Sequence[Task]]
"""The first n tasks that the team draws, the same at all robots."""
Cost = Callable[[Task], float]
"""Of this robot for a task, inf if it cannot do it."""


@dataclass(frozen=True)
class Generation:
    """What one robot has of a generation.

    number: of the table, from 1 on;  filled: how often the table has been filled up so far;  tasks: that were open, in
    the order of their ids;  costs: of this robot for each;  outcome: what the team agreed on;  book: what it was made
    with, the same at all robots;  dropped: why, by robot, what it said counts for nothing.
    """

    number: int
    filled: int
    tasks: tuple[Task, ...]
    costs: tuple[float, ...]
    outcome: Outcome
    book: TaskBook
    dropped: dict[int, CodecError]

    @property
    def mine(self) -> int | None:
        """The id of this robot's task."""
        return None if self.outcome.task is None else self.outcome.task.id

    @property
    def idle(self) -> bool:
        """Whether nobody has a task."""
        return len(self.outcome.unserved) == len(self.tasks)


class NextGeneration(Program[Generation]):
    """A Round: all robots of `graph` end it in the same round, each with its part of the same generation.

        flood of books  ->  fill the table up to as many open tasks as robots  ->  TaskAssignment

    There is no table but this: each robot makes the same one of what all have said. It is filled up at most `most`
    times, by `draw`; from then on the open tasks are assigned until none is left. What a robot hears after its first
    message is for the next generation.
    graph: of the members, connected and undirected;  book: what this robot knows;  number, filled: of the last
    generation that it has been part of, 0 before the first;  cost: of this robot.
    """

    def __init__(
        self,
        robot: int,
        graph: Graph,
        book: TaskBook,
        number: int,
        filled: int,
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
        self._mine = [book.wire(), number, filled]
        super().__init__()

    def run(self) -> Exchange[Generation]:
        """Agree, fill up, assign."""
        said = yield from flood(self.robot, self._mine, self.diameter)
        book, number, filled, dropped = _merged(said)
        missing = len(self.members) - len(open_tasks(book, self.members))
        if filled < self.most and missing > 0:
            filled += 1
            drawn = sum(j < ADDED for j in book.tasks)
            for task in self.draw(drawn + missing)[drawn:]:
                book.learn(task)
        tasks = open_tasks(book, self.members)
        costs = tuple(
            self.cost(task) if self.robot in task.robots or not task.robots else inf
            for task in tasks
        )
        outcome = yield from self._assigned(
            number + 1, tasks, dict(zip((t.id for t in tasks), costs, strict=True))
        )
        return Generation(number + 1, filled, tasks, costs, outcome, book, dropped)

    def _assigned(
        self, number: int, tasks: tuple[Task, ...], costs: dict[int, float]
    ) -> Exchange[Outcome]:
        """The cheapest assignment, by the distributed simplex; of nothing there is none."""
        if not tasks:
            return Outcome(number, None, 0.0, (), "", 0)
        rows = tuple(assignment.Task(task.id, np.array(task.pickup)) for task in tasks)
        table = Table(number, rows, last=True)
        solver = TaskAssignment(
            self.robot, lambda task: costs[task.id], self.members, self.diameter, table
        )
        while not solver.done:
            solver.step((yield solver.message()))
        assert solver.outcome is not None  # noqa: S101 - it is done
        return solver.outcome


def open_tasks(book: TaskBook, members: Sequence[int]) -> tuple[Task, ...]:
    """The tasks that are neither done nor cancelled, in the order of their ids."""
    standings = book.standings(members, recover=True)
    return tuple(
        book.tasks[j] for j, standing in standings.items() if standing.fate is Fate.OPEN
    )


def _merged(said: dict[int, Any]) -> tuple[TaskBook, int, int, dict[int, CodecError]]:
    """What all know together; the newest generation that anybody has been part of; what was no book."""
    book = TaskBook()
    number = 0
    filled = 0
    dropped = dict[int, CodecError]()
    for i, value in said.items():
        try:
            wire, its_number, its_filled = _read(value)
            book.merge(TaskBook.of(wire))
            number = max(number, its_number)
            filled = max(filled, its_filled)
        except CodecError as error:
            dropped[i] = error
    return book, number, filled, dropped


def _read(value: Any) -> tuple[bytes, int, int]:
    try:
        return convert(value, tuple[bytes, Count, Count])
    except ValidationError as error:
        raise CodecError(f"generation: {error}") from error
