"""TaskAssignmentGuidance: a team assigns the tasks of a table in flight.

It assigns them again whenever the table is refilled.
"""

import logging
import math
from collections.abc import Callable, Collection
from dataclasses import dataclass
from math import inf
from typing import Any

import numpy as np

from crazychoir.config.drone_room import shared_room
from crazychoir.config.swarm_config import SwarmConfig
from crazychoir.guidance.member import Interrupted, Member, describe_state
from crazychoir.guidance.tasks.generation import (
    Draw,
    Generation,
    NextGeneration,
    TableProgress,
    list_open_tasks,
)
from crazychoir.guidance.tasks.task_book import Deed, Place, Record, Task
from crazychoir.guidance.tasks.task_source import TaskSource
from crazychoir.guidance.tasks.team_mission import TeamMission, TeamRules
from crazychoir.guidance.tasks.team_news import Key
from crazychoir.guidance.tasks.together import run_together
from crazychoir.guidance.turns import TurnTaking
from crazychoir.safety.rules.modes import Mode
from crazychoir.team.graph import describe_ids
from crazychoir.types import Goto, State, Vec

log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class AssignmentLimits:
    """When a robot of the task assignment looks again, has reached a task, records its way, and
    goes on alone.
    """

    poll_interval: float = 0.05
    """s: interval at which the robot looks again, and sends its news."""
    reached_distance: float = 0.05
    """m, in the plane: a task is done at this distance."""
    way_interval: float = 0.2
    """s between two recorded places of a way."""
    reunion_time: float = 20.0
    """s: how long a robot waits for others before it goes on.

    It applies to a robot over its home, to a robot that is cut off, and to a robot that is out while
    all robots that it hears are out.
    """


ASSIGNMENT_LIMITS = AssignmentLimits()


MISSION_MODES = (Mode.TAKEOFF, Mode.HOVER, Mode.FOLLOW)
"""Modes in which the mission flies the drone."""

CostFunction = Callable[[State, Task], float]
"""Cost of a task for a robot in this state; inf if the robot cannot do it."""


def measure_distance(state: State, task: Task) -> float:
    """Return |task - p| in the plane, in m."""
    return math.dist(state.p[:2].tolist(), task.pickup)


@dataclass(frozen=True)
class TeamAssignment:
    """What all robots of a mission have in common."""

    draw: Draw
    """Draws the tasks, in their order."""
    generations: int
    """How often the table is filled up to as many open tasks as robots."""
    cost: CostFunction = measure_distance
    """Cost of a task for a robot."""


class TaskRoom:
    """Where tasks of operators may be, and which robots may serve them.

    ids: the robots of the swarm.
    low: (2,) m: lower corner of the area that drones fly to.
    high: (2,) m: upper corner of that area.
    """

    def __init__(self, config: SwarmConfig) -> None:
        self.ids = config.ids
        low, high = shared_room(config)
        self.low = np.array(low[:2])
        self.high = np.array(high[:2])

    def explain_bad_place(self, task: Task, pickup: Place) -> str:
        """Return why no robot can stand at the pickup. Empty if one can."""
        if np.all(self.low <= pickup) and np.all(pickup <= self.high):
            return ""
        room = f"{self.low.round(3).tolist()} to {self.high.round(3).tolist()} m"
        return (
            f"it is at {list(pickup)}, outside the fence, or at its edge: "
            f"drones are sent to {room}"
        )

    def explain_unservable(self, task: Task) -> str:
        """Return why no robot of this swarm can serve the task. Empty if one can."""
        strangers = [i for i in task.robots if i not in self.ids]
        return (
            f"there is no drone {describe_ids(strangers)}; this swarm has {describe_ids(self.ids)}"
            if strangers
            else ""
        )

    def explain_wait(self, task: Task, flying: Collection[int]) -> str:
        """Return why no flying robot can serve the task. Empty if one can."""
        if not task.robots or any(i in flying for i in task.robots):
            return ""
        return (
            f"drone {describe_ids(task.robots)}, which alone may serve it, does not fly"
        )


class TaskAssignmentGuidance(TeamMission):
    """Robot i flies to its task, and the team assigns the open tasks anew whenever they change.

    Each robot computes the table from the news that all have exchanged, so no robot stores it
    centrally. The loss of a robot affects only its own task, which another robot gets in the next
    generation. The robot flies on while the team plans.

    No task is done twice. From its first message of a planning until it has the next generation, a
    robot completes no task. Two robots that may complete a task therefore have the same generation.
    A part of the team that is cut off, with at most half of it, waits for the others, and goes home
    after ASSIGNMENT_LIMITS.reunion_time s. However, work that a robot did without telling any other
    robot, before it was lost or cut off, is done again.

    work: what all robots have in common.

    generation: the generation by which it flies. None: it has none.
    tables: this robot's part of each generation.
    way: rows of t s since the start, x m, y m, and m from its task or None.
    done: (task, generation) of each task that it has completed.
    """

    def __init__(self, work: TeamAssignment) -> None:
        rules = TeamRules(
            recover=True,
            news_period=ASSIGNMENT_LIMITS.poll_interval,
            reunion_time=ASSIGNMENT_LIMITS.reunion_time,
        )
        super().__init__(rules)
        self.work = work
        self.generation: Generation | None = None
        self.tables: list[dict[str, Any]] = []
        self.way: list[tuple[Any, ...]] = []
        self.done: list[tuple[int, int]] = []
        self._shares = True  # a planning runs: no task may be completed
        self._said = ""

    def bind(self, member: Member) -> None:
        """Connect this guidance to its drone."""
        super().bind(member)
        self._born = member.clock.now()
        self.source = TaskSource(
            self.news, TaskRoom(member.config), may_end=self._may_end
        )
        self._turns = TurnTaking(member.pilot)
        member.report = lambda: {
            "task": self._doing(),
            "cost": self.tables[-1]["cost"] if self.tables else None,
        }

    def outcome(self) -> dict[str, Any]:
        """Return this drone's part of the report."""
        left = [task.id for task in list_open_tasks(self.news.book, self.news.members)]
        return {
            "done": self.done,
            "tables": self.tables,
            "open": left,
            "way": self.way,
        }

    async def asked(self, verb: str, arguments: dict[str, Any]) -> Any:
        """Answer an operator: add a task at its pickup, cancel a task, or list the tasks.

        See TaskSource.
        """
        place = {"delivery": arguments.get("pickup")} if verb == "task_add" else {}
        said: dict[str, Any] = await super().asked(verb, {**arguments, **place})
        if verb == "task_list":
            return {"tasks": [task | {"delivery": None} for task in said["tasks"]]}
        return said

    def route(self) -> list[Vec]:
        """Return the place of its task, or its home when all tasks are done."""
        if self.member.pilot.mode not in MISSION_MODES:
            return []
        if self.is_over:
            return [self._home]
        return (
            []
            if (mine := self._mine) is None
            else [self.above(self.news.book.tasks[mine].pickup)]
        )

    def _may_end(self) -> bool:
        return self._shares

    def _doing(self) -> str:
        mine = None if self.generation is None else self.generation.mine
        return f"{len(self.done)} done, {'waits' if mine is None else f'task {mine}'}"

    # Planning -------------------------------------------------------------------------

    async def plan_once(self, key: Key) -> bool:
        """Plan the next generation with the team of this key, and fly by it from then on.

        Returns False if the team has changed meanwhile.
        """
        self._shares = True
        began = self.member.clock.now()
        generation = await self._next(key)
        if generation is None:
            return False
        self._adopt(generation, self.member.clock.now() - began)
        return True

    def needs_plan(self, alive: Collection[Record]) -> bool:
        """Return whether the open tasks have changed."""
        generation = self.generation
        return generation is None or self._open() != _list_ids(generation.tasks)

    def _open(self) -> list[int]:
        return _list_ids(list_open_tasks(self.news.book, self.news.members))

    async def _next(self, key: Key) -> Generation | None:
        """Plan the next generation with the team.

        Returns None if the team has changed meanwhile.
        """
        links = self.news.links(without=key[1])
        last = self.generation
        work = self.work
        progress = TableProgress() if last is None else last.progress
        state = self.state
        program = NextGeneration(
            self.id,
            links,
            self.news.book,
            progress,
            work.draw,
            work.generations,
            lambda task: work.cost(state, task),
        )
        return (
            program.result
            if await run_together(self.news, program, links, key)
            else None
        )

    def _adopt(self, generation: Generation, seconds: float) -> None:
        """Fly by this generation from now on."""
        outcome = generation.outcome
        self.generation = generation
        self._shares = False
        self.news.book.merge(generation.book)
        for j, error in generation.dropped.items():
            self.news.drop(j, error)
        costs = [None if cost == inf else cost for cost in generation.costs]
        self.tables.append(
            {
                "number": generation.number,
                "filled": generation.filled,
                "team": list(self.news.alive_ids()),
                "tasks": _list_ids(generation.tasks),
                "places": [task.pickup for task in generation.tasks],
                "costs": costs,
                "mine": generation.mine,
                "cost": outcome.cost,
                "infeasible": outcome.infeasible,
                "unserved": list(outcome.unserved),
                "rounds": outcome.rounds,
                "seconds": seconds,
            }
        )
        if outcome.infeasible not in ("", self._said) and self.speaks:
            log.warning(
                "drone %d: generation %d: %s",
                self.id,
                generation.number,
                outcome.infeasible,
            )
        self._said = outcome.infeasible
        if generation.idle:
            self.news.say(ended=True)

    def lose_quorum(self) -> None:
        """Wait in the air for the others, while too few robots are here to decide."""
        self._shares = True
        self.generation = None

    def end_alone(self, reason: str) -> None:
        """Go home without the others."""
        self.alone = True
        self.reason = reason
        self.leave()
        self.news.changed.set()  # also ends a round that waits for them

    # Flying ---------------------------------------------------------------------------

    async def fly_plan(self) -> None:
        """Take off, fly from task to task, go home, and land with the others."""
        await self.take_off()
        while not self.is_over:
            self._pursue()
            self._note()
            await self.sleep(ASSIGNMENT_LIMITS.poll_interval)
        await self._go_home()
        self._note()
        await self.land()

    @property
    def _home(self) -> Vec:
        """(3,) m: above the place where it stood."""
        return self.above(self.member.config.drone(self.id).home)

    def _pursue(self) -> None:
        """Fly to its own task, and complete the task there.

        Without a task it waits in the air, where no other robot wants to be.
        """
        pilot = self.member.pilot
        if pilot.mode not in MISSION_MODES:
            raise Interrupted(f"drone {self.id}: {describe_state(pilot)}")
        generation = self.generation
        mine = self._mine
        if generation is None or mine is None:
            if (away := self._turns.away()) is None:
                pilot.hover()
            else:
                self.follow(Goto(away))
            return
        place = self.news.book.tasks[mine].pickup
        self.follow(Goto(self._turns.to(self.above(place))))
        if (
            not self._shares
            and math.dist(self.here(), place) < ASSIGNMENT_LIMITS.reached_distance
        ):
            self.done.append((mine, generation.number))
            self.news.say(deeds=(*self.news.record.deeds, Deed(mine, "delivery", 1)))

    @property
    def _mine(self) -> int | None:
        """The task to fly to: its task of this generation, if that is still open."""
        mine = None if self.generation is None else self.generation.mine
        return mine if mine is not None and mine in self._open() else None

    def _note(self) -> None:
        """Record the way, every ASSIGNMENT_LIMITS.way_interval s."""
        t = self.member.clock.now() - self._born
        if self.way and t < float(self.way[-1][0]) + ASSIGNMENT_LIMITS.way_interval:
            return
        mine = self._mine
        left = (
            None
            if mine is None
            else round(math.dist(self.here(), self.news.book.tasks[mine].pickup), 3)
        )
        self.way.append((round(t, 2), *(round(x, 3) for x in self.here()), left))

    async def _go_home(self) -> None:
        """Fly above its own home. No robot lands while another robot still flies around."""
        await self.go_to(self._home)
        self.news.say(idle=True)
        ends = self.member.clock.now() + ASSIGNMENT_LIMITS.reunion_time
        while self.member.clock.now() < ends and not (self.alone or self._all_home()):
            await self.sleep(ASSIGNMENT_LIMITS.poll_interval)

    def _all_home(self) -> bool:
        return all(
            record.idle for record in self.news.book.alive(self.news.members).values()
        )


def _list_ids(tasks: Collection[Task]) -> list[int]:
    return [task.id for task in tasks]
