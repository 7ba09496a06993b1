"""One planning of a team in flight, as rounds.

The robots agree on what is known, then share out the free tasks.

Each robot plans from where it will be.
"""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from crazychoir.errors import CodecError
from crazychoir.guidance.tasks.attempt import attempt_work
from crazychoir.guidance.tasks.task_book import Fate, Place, Task, TaskBook
from crazychoir.optimization.rounds.agreement import flood_values
from crazychoir.optimization.rounds.program import Exchange, Program
from crazychoir.routing.distributed.pickup_delivery import (
    PLANNING_METHODS,
    PickupDelivery,
)
from crazychoir.routing.instance.instance import LocalProblem, Tasks
from crazychoir.routing.instance.plan import Stop
from crazychoir.routing.search.parallel_auction import run_parallel_auction
from crazychoir.team.graph import Graph

AUCTION_METHOD = "parallel-auction"
"""The method that uses the auction alone."""
REPLANNING_METHODS = (AUCTION_METHOD, *PLANNING_METHODS)
"""Methods to share out tasks in flight.

The auction alone, or a method of PickupDelivery after the auction.
"""
Mark = tuple[tuple[int, int, bool], ...]
"""The tasks that a plan was made for: (id, version, cancelled) of each."""
Dropped = dict[int, CodecError]
"""By robot: why its message was ignored."""


@dataclass(frozen=True)
class TaskBonds:
    """The tasks to which a robot is bound when it plans."""

    bound: tuple[int, ...] = ()
    """Tasks that it is about to serve, or to deliver, before its start. No other robot gets them."""
    carried: tuple[int, ...] = ()
    """Tasks that are aboard at its start."""


@dataclass(frozen=True)
class PlanShare:
    """One robot's part of a plan."""

    stops: tuple[Stop, ...]
    """The stops after those to which the robot is bound."""
    unserved: tuple[int, ...]
    """Tasks that no robot can serve."""
    book: TaskBook
    """The book from which the plan was made, the same at all robots."""
    ended: bool
    """No work is left, and all robots have landed."""
    dropped: Dropped
    """By robot: why its message was ignored."""
    trouble: dict[str, str] = field(default_factory=dict)
    """By method: why it has found no plan, the same at all robots."""


@dataclass(frozen=True)
class PlannedGoods:
    """The tasks of one planning, in the order of their ids.

    These are the free tasks, and the tasks aboard a robot that continues with them.
    """

    tasks: tuple[Task, ...]
    """The tasks."""
    pickup: tuple[Place, ...]
    """(2,) m of each: where it lies."""
    mine: tuple[bool, ...]
    """For each: it is aboard this robot at its start."""
    free: tuple[bool, ...]
    """For each: it is to be shared out."""
    left_by: tuple[int | None, ...]
    """For each: the lost robot with which it lies there. None: it lies at its first place."""

    def public(self, service: float) -> Tasks:
        """Return the tasks in the form that the solvers use; service: s at each stop."""
        return Tasks(
            np.array(self.pickup, dtype=float).reshape(-1, 2),
            np.array([task.delivery for task in self.tasks], dtype=float).reshape(
                -1, 2
            ),
            np.array([task.load for task in self.tasks], dtype=float),
            np.full(2 * len(self.tasks), service),
        )


class Replanning(Program[PlanShare]):
    """A Round: all robots of `members` end it in the same round, each with its share of one plan.

        flood of books and bonds
        ->  auction of the free tasks
        ->  a better plan of the sold tasks

    If a method raises an error, at one robot or at all, the plan of the auction holds. If the
    auction raises an error, there is no plan: what is aboard is delivered, and the free tasks are
    left.

    A robot plans with what it knows in the first round. What it learns later is for the next
    planning. A message that is not a valid book is ignored, by all robots alike, since all receive
    the same message.

    robot: id of this robot.
    graph: of the members, connected and undirected.
    book: what this robot knows.
    bonds: the tasks to which it is bound.
    problem: returns this robot's problem of these goods.
    recover: see TaskBook.standings.
    method: of REPLANNING_METHODS. The auction alone takes some tens of rounds and milliseconds. The others find
        shorter plans and compute for seconds.
    """

    def __init__(
        self,
        robot: int,
        graph: Graph,
        book: TaskBook,
        bonds: TaskBonds,
        problem: Callable[[PlannedGoods], LocalProblem],
        recover: bool = False,
        method: str = AUCTION_METHOD,
    ) -> None:
        self.robot = robot
        self.graph = graph
        self.members = graph.ids
        self.recover = recover
        self.method = method
        self.diameter = graph.diameter() if len(graph.ids) > 1 else 0
        self._mine = [book.wire(), list(bonds.bound), list(bonds.carried)]
        self._problem = problem
        super().__init__()

    def run(self) -> Exchange[PlanShare]:
        """Agree on what is known, then share out the free tasks."""
        said = yield from flood_values(self.robot, self._mine, self.diameter)
        book, bound, carried, dropped = _merge_messages(said)
        goods = self._goods(book, bound, carried)
        stops, left, trouble = yield from self._shared_out(goods)
        idle = all(record.idle for record in book.alive(self.members).values())
        return PlanShare(
            stops,
            unserved=tuple(goods.tasks[n].id for n in left),
            book=book,
            ended=idle and len(left) == sum(goods.free) and not (bound or carried),
            dropped=dropped,
            trouble=trouble,
        )

    def _shared_out(
        self, goods: PlannedGoods
    ) -> Exchange[tuple[tuple[Stop, ...], tuple[int, ...], dict[str, str]]]:
        """Return this robot's stops, the tasks left, and the methods without a plan.

        The tasks are given as indices.
        """
        m = len(goods.tasks)
        trouble = dict[str, str]()
        found, why = yield from attempt_work(
            self.robot, self._auction(goods), self.diameter
        )
        if found is None:
            aboard = [
                task.id
                for task, mine in zip(goods.tasks, goods.mine, strict=True)
                if mine
            ]
            left = tuple(n for n, free in enumerate(goods.free) if free)
            return (
                tuple(Stop(j, "delivery") for j in aboard),
                left,
                {AUCTION_METHOD: why},
            )
        local, route, left = found
        sold = [n for n in range(m) if n not in left]
        if self.method != AUCTION_METHOD and sold and self.diameter:
            better, why = yield from attempt_work(
                self.robot, self._better(local, route, sold), self.diameter
            )
            if better is None:
                trouble[self.method] = why
            else:
                route = better
        return (
            tuple(
                Stop(goods.tasks[v % m].id, "pickup" if v < m else "delivery")
                for v in route
            ),
            left,
            trouble,
        )

    def _auction(
        self, goods: PlannedGoods
    ) -> Exchange[tuple[LocalProblem, tuple[int, ...], tuple[int, ...]]]:
        """Return this robot's problem, its route as nodes, and the tasks left as indices."""
        local = self._problem(goods)
        free = [n for n, is_free in enumerate(goods.free) if is_free]
        route, left = yield from run_parallel_auction(
            self.robot, local.vehicle, free, self.diameter
        )
        return local, route, left

    def _better(
        self, local: LocalProblem, route: tuple[int, ...], sold: list[int]
    ) -> Exchange[tuple[int, ...]]:
        """Return this robot's route, as nodes, in a plan of PickupDelivery.

        PickupDelivery counts robots and tasks from 0. Goods aboard must be delivered however long
        the way is, so a plan as long as the present route is allowed.

        local: this robot's problem.
        route: its route from the auction, as nodes.
        sold: the tasks that the auction has sold, as indices.
        """
        index = {i: n for n, i in enumerate(self.members)}
        chosen = np.array(sold)
        m = len(local.tasks)
        both = np.concatenate([chosen, m + chosen])
        tasks = Tasks(
            local.tasks.pickup[chosen],
            local.tasks.delivery[chosen],
            local.tasks.load[chosen],
            local.tasks.service[both],
        )
        aboard = None if local.aboard is None else local.aboard[chosen]
        neighbors = self.graph.neighbors(self.robot)
        solver = PickupDelivery(
            replace(
                local,
                robot=index[self.robot],
                robots=len(index),
                tasks=tasks,
                capable=local.capable[chosen],
                aboard=aboard,
                left=max(local.vehicle.limit, local.vehicle.length(route)),
            ),
            neighbors=[index[j] for j in neighbors],
            n=len(index),
            diameter=self.diameter,
            degree_of={index[j]: len(self.graph.neighbors(j)) for j in neighbors},
            method=self.method,
        )
        while not solver.done:
            heard = yield solver.message()
            solver.step({index[j]: message for j, message in heard.items()})
        stops = [
            stop
            for route in solver.solution.routes
            for stop in route.stops
            if route.robot == index[self.robot]
        ]
        return tuple(
            sold[stop.task] + (0 if stop.kind == "pickup" else m) for stop in stops
        )

    def _goods(
        self, book: TaskBook, bound: dict[int, None], carried: dict[int, int]
    ) -> PlannedGoods:
        standings = book.standings(self.members, self.recover)
        free = [
            j
            for j, s in standings.items()
            if s.fate is Fate.OPEN and j not in bound and j not in carried
        ]
        ids = sorted([*free, *carried])
        return PlannedGoods(
            tuple(book.tasks[j] for j in ids),
            tuple(standings[j].pickup for j in ids),
            mine=tuple(carried.get(j) == self.robot for j in ids),
            free=tuple(j not in carried for j in ids),
            left_by=tuple(standings[j].robot for j in ids),
        )


def identify_tasks(book: TaskBook) -> Mark:
    """Return the tasks that a plan made with this book was made for."""
    return tuple(
        (task.id, task.version, task.cancelled)
        for _, task in sorted(book.tasks.items())
    )


def _merge_messages(
    said: dict[int, Any],
) -> tuple[TaskBook, dict[int, None], dict[int, int], Dropped]:
    """Combine the messages of all robots.

    The bonds of a message hold even if its book is not valid. Else two robots would serve a task to
    which one of them is bound.
    Returns the book, the bound tasks, the robot that carries each task, and by robot why its
    message was ignored.
    """
    book = TaskBook()
    bound = dict[int, None]()
    carried = dict[int, int]()
    dropped = Dropped()
    for i, value in said.items():
        try:
            wire, bonds, aboard = _read_message(value)
            bound.update(dict.fromkeys(bonds))
            for j in aboard:
                carried.setdefault(j, i)
            book.merge(TaskBook.of(wire))
        except CodecError as error:
            dropped[i] = error
    return book, bound, {j: i for j, i in carried.items() if j in book.tasks}, dropped


def _read_message(value: Any) -> tuple[Any, list[int], list[int]]:
    """Return the book (as a message), the bonds and the goods aboard of one robot's message.

    Raises CodecError.
    """
    try:
        wire, bonds, aboard = value
        return wire, list(map(int, bonds)), list(map(int, aboard))
    except (TypeError, ValueError, OverflowError) as error:
        raise CodecError(
            f"planning: no task book and no commitments: {error}"
        ) from error
