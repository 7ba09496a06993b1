"""TaskAssignmentGuidance: a team assigns the tasks of a table in flight.

It assigns them again whenever the table is refilled.
"""

import asyncio
import logging
import math
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from math import inf
from typing import Any

import numpy as np

from crazychoir.errors import CrazyChoirError, RosterChanged, error_text, reason_or
from crazychoir.guidance.guidance import FLIGHT_LIMITS, CFGuidance
from crazychoir.guidance.member import (
    Interrupted,
    Member,
    describe_state,
    wait_for_touchdown,
)
from crazychoir.guidance.tasks.generation import (
    Draw,
    Generation,
    NextGeneration,
    list_open_tasks,
)
from crazychoir.guidance.tasks.room import TaskRoom
from crazychoir.guidance.tasks.task_book import Deed, Place, Task
from crazychoir.guidance.tasks.task_source import TaskSource
from crazychoir.guidance.tasks.team_news import UNREACHED_REASON, Key, TeamNews
from crazychoir.guidance.tasks.together import run_together
from crazychoir.guidance.turns import TurnTaking
from crazychoir.safety.rules.modes import Mode
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


class TaskAssignmentGuidance(CFGuidance):
    """Robot i flies to its task, and the team assigns the open tasks anew whenever they change.

    Each robot computes the table from the news that all have exchanged, so no robot stores it
    centrally. The loss of a robot affects only its own task, which another robot gets in the next
    generation. The robot flies on while the team plans.

    No task is done twice. From its first message of a planning until it has the next generation, a
    robot completes no task. Two robots that may complete a task therefore have the same generation.
    A part of the team that is cut off, with at most half of it, waits for the others, and goes home
    after REUNION s. However, work that a robot did without telling any other robot, before it was
    lost or cut off, is done again.
    """

    def __init__(self, work: TeamAssignment) -> None:
        self.work = work
        self.generation: Generation | None = None
        self.tables: list[dict[str, Any]] = []
        self.way: list[
            tuple[Any, ...]
        ] = []  # rows t s since the start, x, y m, m from its task or None
        self.done: list[tuple[int, int]] = []
        self.reason = ""
        self._shares = True  # a planning runs: no task may be completed
        self._alone = False
        self._said = ""

    def bind(self, member: Member) -> None:
        """Connect this guidance to its drone."""
        super().bind(member)
        self._born = self._now
        self.news = TeamNews(
            member.communicator,
            (),
            self._here,
            recover=True,
            period=ASSIGNMENT_LIMITS.poll_interval,
        )
        self.source = TaskSource(
            self.news, TaskRoom(member.config), may_end=self._may_end
        )
        self._turns = TurnTaking(member.pilot)
        member.report = lambda: {
            "task": self._doing(),
            "cost": self.tables[-1]["cost"] if self.tables else None,
        }

    async def mission(self) -> dict[str, Any]:
        """Fly, gossip and plan until no work is left. Then fly home and land."""
        try:
            async with asyncio.TaskGroup() as group:
                jobs = [
                    group.create_task(job)
                    for job in (self.news.gossip(), self._fly(), self._left_alone())
                ]
                await self._plan()
                jobs[2].cancel()
                if not self._alone:
                    await self.news.farewell()
                await asyncio.wait(jobs[1:])
                jobs[0].cancel()
        except BaseException as error:
            cause = (
                error.exceptions[0] if isinstance(error, BaseExceptionGroup) else error
            )
            self.member.pilot.land(
                ""
                if isinstance(cause, asyncio.CancelledError)
                else f"mission failed: {reason_or(cause, error_text(cause))}"
            )
            await wait_for_touchdown(self.member.pilot, FLIGHT_LIMITS.touchdown_time)
            await self.news.last_words()
            if cause is error:
                raise
            raise cause from error
        return self.outcome()

    def outcome(self) -> dict[str, Any]:
        """Return this drone's part of the report."""
        failed = {"success": False, "reason": self.reason} if self.reason else {}
        left = [task.id for task in list_open_tasks(self.news.book, self.news.members)]
        return {
            "done": self.done,
            "tables": self.tables,
            "open": left,
            "way": self.way,
        } | failed

    async def asked(self, verb: str, arguments: dict[str, Any]) -> Any:
        """Answer an operator: add a task at its pickup, cancel a task, or list the tasks.

        See TaskSource.
        """
        place = {"delivery": arguments.get("pickup")} if verb == "task_add" else {}
        said: dict[str, Any] = await self.source.asked(verb, {**arguments, **place})
        if verb == "task_list":
            return {"tasks": [task | {"delivery": None} for task in said["tasks"]]}
        return said

    def route(self) -> list[Vec]:
        """Return the place of its task, or its home when all tasks are done."""
        if self.member.pilot.mode not in MISSION_MODES:
            return []
        if self.news.ended or self._alone:
            return [self._home]
        return (
            []
            if (mine := self._mine) is None
            else [self._above(self.news.book.tasks[mine].pickup)]
        )

    def _may_end(self) -> bool:
        return self._shares

    def _doing(self) -> str:
        mine = None if self.generation is None else self.generation.mine
        return f"{len(self.done)} done, {'waits' if mine is None else f'task {mine}'}"

    @property
    def _now(self) -> float:
        return self.member.clock.now()

    def _here(self) -> Place:
        return float(self.state.p[0]), float(self.state.p[1])

    # Planning -------------------------------------------------------------------------

    async def _plan(self) -> None:
        """Plan one generation after the other, with each team in turn, until the team has ended."""
        while not (self.news.ended or self._alone):
            key = self.news.key()
            self.news.changed.clear()
            try:
                if not self.news.count():
                    await self._cut_off(key)
                elif self.id in key[1]:
                    await self.sleep(
                        ASSIGNMENT_LIMITS.poll_interval
                    )  # out: the others continue without this robot
                else:
                    await self._generations(key)
            except RosterChanged:
                continue

    async def _generations(self, key: Key) -> None:
        """Plan the generations of one team.

        When a robot begins a generation, all others begin it too.
        """
        n = 0
        while self.news.key() == key and not (self.news.ended or self._alone):
            if n and not self._wanted(key, n):
                await self.sleep(ASSIGNMENT_LIMITS.poll_interval)
                continue
            n = n + 1
            self._shares = True
            self.news.say(run=(key[0], len(key[1]), n))
            began = self._now
            generation = await self._next(key)
            if generation is None:
                return
            self._adopt(generation, self._now - began)

    def _wanted(self, key: Key, n: int) -> bool:
        """Return whether a planning is due.

        It is due if a robot plans already, or if the open tasks have changed.
        """
        alive = self.news.book.alive(self.graph.ids).values()
        begun = any(r.run[:2] == (key[0], len(key[1])) and r.run[2] > n for r in alive)
        return (
            begun
            or self.generation is None
            or self._open() != _list_ids(self.generation.tasks)
        )

    def _open(self) -> list[int]:
        return _list_ids(list_open_tasks(self.news.book, self.news.members))

    async def _next(self, key: Key) -> Generation | None:
        """Plan the next generation with the team.

        Returns None if the team has changed meanwhile.
        """
        links = self.news.links(without=key[1])
        last = self.generation
        work = self.work
        number, filled = (0, 0) if last is None else (last.number, last.filled)
        state = self.state
        program = NextGeneration(
            self.id,
            links,
            self.news.book,
            number,
            filled,
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
        speaks = self.id == min(self.news.alive_ids(), default=self.id)
        if outcome.infeasible not in ("", self._said) and speaks:
            log.warning(
                "drone %d: generation %d: %s",
                self.id,
                generation.number,
                outcome.infeasible,
            )
        self._said = outcome.infeasible
        if generation.idle:
            self.news.say(ended=True)

    async def _cut_off(self, key: Key) -> None:
        """Wait in the air for the others, while too few robots are here to decide."""
        log.warning("drone %d: %s", self.id, UNREACHED_REASON)
        self._shares = True
        self.generation = None
        while self.news.key() == key and not (self.news.ended or self._alone):
            await self.sleep(ASSIGNMENT_LIMITS.poll_interval)

    async def _left_alone(self) -> None:
        """End the mission if it waits for robots that are lost."""
        why = await self.news.left_alone(ASSIGNMENT_LIMITS.reunion_time)
        self._alone = True
        self.reason = (
            f"{self.reason}; then {why}" if self.reason else f"drone {self.id}: {why}"
        )
        self.news.say(out=True)
        self.news.changed.set()  # also ends a round that waits for them

    # Flying ---------------------------------------------------------------------------

    async def _fly(self) -> None:
        """Take off, fly from task to task, go home, and land with the others.

        A robot that cannot fly on says so, and continues to pass messages on.
        """
        try:
            await self.take_off()
            while not (self.news.ended or self._alone):
                self._pursue()
                self._note()
                await self.sleep(ASSIGNMENT_LIMITS.poll_interval)
            await self._go_home()
            self._note()
            await self.land()
        except CrazyChoirError as error:
            log.warning("drone %d: %s", self.id, error)
            self.reason = str(error)
            self.member.pilot.land()
            await wait_for_touchdown(self.member.pilot, FLIGHT_LIMITS.touchdown_time)
            self.news.say(out=True)

    def _above(self, place: Sequence[float]) -> Vec:
        flight = self.member.config.flight
        return np.array([*place[0:2], flight.ground + flight.takeoff_height])

    @property
    def _home(self) -> Vec:
        """(3,) m: above the place where it stood."""
        return self._above(self.member.config.drone(self.id).home)

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
        self.follow(Goto(self._turns.to(self._above(place))))
        if (
            not self._shares
            and math.dist(self._here(), place) < ASSIGNMENT_LIMITS.reached_distance
        ):
            self.done.append((mine, generation.number))
            self.news.say(deeds=(*self.news.record.deeds, Deed(mine, "delivery", 1)))

    @property
    def _mine(self) -> int | None:
        """The task to fly to: its task of this generation, if that is still open."""
        mine = None if self.generation is None else self.generation.mine
        return mine if mine is not None and mine in self._open() else None

    def _note(self) -> None:
        """Record the way, every NOTED s."""
        t = self._now - self._born
        if self.way and t < float(self.way[-1][0]) + ASSIGNMENT_LIMITS.way_interval:
            return
        mine = self._mine
        left = (
            None
            if mine is None
            else round(math.dist(self._here(), self.news.book.tasks[mine].pickup), 3)
        )
        self.way.append((round(t, 2), *(round(x, 3) for x in self._here()), left))

    async def _go_home(self) -> None:
        """Fly above its own home. No robot lands while another robot still flies around."""
        await self.go_to(self._home)
        self.news.say(idle=True)
        ends = self._now + ASSIGNMENT_LIMITS.reunion_time
        while self._now < ends and not (self._alone or self._all_home()):
            await self.sleep(ASSIGNMENT_LIMITS.poll_interval)

    def _all_home(self) -> bool:
        return all(
            record.idle for record in self.news.book.alive(self.news.members).values()
        )


def _list_ids(tasks: Collection[Task]) -> list[int]:
    return [task.id for task in tasks]
