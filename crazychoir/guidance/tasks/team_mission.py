"""TeamMission: a mission in which a team plans in flight, again and again, as robots come and go.

Each robot does four things at the same time: it flies, it gossips its task book, it learns of new
tasks, and it plans with the team whenever a planning is due. A subclass says how to plan once, and
how to fly by a plan.
"""

import asyncio
import logging
from abc import abstractmethod
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from crazychoir.errors import CrazyChoirError, RosterChanged, error_text, reason_or
from crazychoir.guidance.flights import FLIGHT_LIMITS
from crazychoir.guidance.guidance import CFGuidance
from crazychoir.guidance.member import Interrupted, Member, wait_for_touchdown
from crazychoir.guidance.tasks.task_book import (
    LARGEST_TASK_NUMBER,
    Place,
    Record,
    Task,
)
from crazychoir.guidance.tasks.task_source import TaskSource
from crazychoir.guidance.tasks.team_news import UNREACHED_REASON, Key, TeamNews
from crazychoir.types import Vec

log = logging.getLogger(__name__)

PLAN_LOOK_INTERVAL = 0.05
"""s: interval at which a robot looks whether a planning is due."""


@dataclass(frozen=True, slots=True)
class TeamRules:
    """Settings that all robots of a mission share."""

    recover: bool
    """Work of a lost robot is done by others, see TaskBook.standings."""
    news_period: float
    """s between two messages of a robot."""
    reunion_time: float
    """s for which a robot may be left alone before it ends its mission."""


class TeamMission(CFGuidance):
    """The mission of one robot: it runs the gossip, the plannings, the flight and the end.

    rules: settings that all robots of the team share.
    tasks: the tasks that are known at the start.

    news: what this robot knows about its team. Set by `bind`.
    source: where its tasks come from. The `bind` of a subclass sets it.
    reason: why the robot flies no more, or why its mission has failed. Empty: neither.
    alone: the robot has been left alone, and ends its mission without the team.
    """

    news: TeamNews
    source: TaskSource

    def __init__(self, rules: TeamRules, tasks: Sequence[Task] = ()) -> None:
        self.rules = rules
        self.tasks = tuple(tasks)
        self.reason = ""
        self.alone = False
        self._seen: Place = (0.0, 0.0)

    def bind(self, member: Member) -> None:
        """Connect this guidance to its drone, and begin its news."""
        super().bind(member)
        self._seen = project_to_plane(member.config.drone(member.id).home)
        self.news = TeamNews(
            member.communicator,
            self.tasks,
            self.here,
            self.rules.recover,
            self.rules.news_period,
        )

    # What a mission adds --------------------------------------------------------------

    @abstractmethod
    async def plan_once(self, key: Key) -> bool:
        """Plan once with the team of this key, and fly by the new plan from then on.

        Returns False if the team has changed meanwhile.
        """

    @abstractmethod
    def needs_plan(self, alive: Collection[Record]) -> bool:
        """Return whether there is a reason for the next planning.

        alive: the records of the robots that fly.
        """

    @abstractmethod
    async def fly_plan(self) -> None:
        """Fly the current plan, and each newer one from its adoption on, until the robot is out."""

    @abstractmethod
    def outcome(self) -> dict[str, Any]:
        """Return this drone's part of the report."""

    def lose_quorum(self) -> None:
        """Change the plan of a robot that is cut off, with too few others to decide."""

    def is_busy(self) -> bool:
        """Return whether the robot has work to do even if it has been left alone."""
        return False

    def end_alone(self, reason: str) -> None:
        """End the mission of a robot that has been left alone. Raises Interrupted."""
        raise Interrupted(reason)

    async def end_flight(self, flight: "asyncio.Task[None]") -> None:
        """Bring `fly_plan` to its end after the team has ended: wait for it."""
        await asyncio.wait({flight})

    def leave(self) -> None:
        """Tell the team that this robot flies no more."""
        self.news.say(out=True)

    # The mission ----------------------------------------------------------------------

    async def mission(self) -> dict[str, Any]:
        """Fly, gossip, listen and plan, until the team agrees that no work is left."""
        try:
            async with asyncio.TaskGroup() as group:
                listening = [
                    group.create_task(self.news.gossip()),
                    group.create_task(self.source.hear()),
                ]
                flight = group.create_task(self._fly())
                waiting = group.create_task(self._wait_for_others())
                await self._plan()
                waiting.cancel()
                if not self.alone:
                    await self.news.farewell()
                await self.end_flight(flight)
                for task in listening:
                    task.cancel()
        except BaseException as error:
            cause = (
                error.exceptions[0] if isinstance(error, BaseExceptionGroup) else error
            )
            await self._come_down(_describe_failure(cause))
            await self.news.last_words()
            if cause is error:
                raise
            raise cause from error
        failed = {"success": False, "reason": self.reason} if self.reason else {}
        return self.outcome() | failed

    async def asked(self, verb: str, arguments: dict[str, Any]) -> Any:
        """Answer an operator: add a task, cancel a task, or list the tasks. See TaskSource."""
        return await self.source.asked(verb, arguments)

    async def _fly(self) -> None:
        """Fly by the plans. A robot that cannot fly on lands, and passes messages on."""
        try:
            await self.fly_plan()
        except CrazyChoirError as error:
            log.warning("drone %d: %s", self.id, error)
            self.reason = str(error)
            await self._come_down("")
            self.leave()

    async def _come_down(self, reason: str) -> None:
        """Land before the others learn that the robot is out: they then fly to it for its goods."""
        self.member.pilot.land(reason)
        await wait_for_touchdown(self.member.pilot, FLIGHT_LIMITS.touchdown_time)

    async def _wait_for_others(self) -> None:
        """End the mission if it waits for robots that are lost."""
        why = await self.news.left_alone(self.rules.reunion_time, self.is_busy)
        self.end_alone(
            f"{self.reason}; then {why}" if self.reason else f"drone {self.id}: {why}"
        )

    # Planning -------------------------------------------------------------------------

    async def _plan(self) -> None:
        """Plan with each team in turn, until the mission is over."""
        while not self.is_over:
            key = self.news.key()
            self.news.changed.clear()
            try:
                if not self.news.count():
                    await self._cut_off(key)
                elif self.id in key[1]:
                    # out: the others continue without this robot
                    await self.sleep(self.news.period)
                else:
                    await self._plan_with(key)
            except RosterChanged:
                continue

    async def _plan_with(self, key: Key) -> None:
        """Plan at the start of a team, and whenever a planning is due.

        When a robot begins a planning, all others begin it too.
        """
        n = 0
        while self.news.key() == key and not self.is_over:
            if n and not self._is_planning_due(key, n):
                await self.sleep(PLAN_LOOK_INTERVAL)
                continue
            n += 1
            self.news.say(run=(key[0], len(key[1]), n))
            if not await self.plan_once(key):
                return

    def _is_planning_due(self, key: Key, n: int) -> bool:
        """Return whether a robot plans already, or there is a reason to plan."""
        alive = self.news.book.alive(self.graph.ids).values()
        begun = any(r.run[:2] == (key[0], len(key[1])) and r.run[2] > n for r in alive)
        return begun or self.needs_plan(alive)

    async def _cut_off(self, key: Key) -> None:
        """Wait for the others, while too few robots are here to decide."""
        log.warning("drone %d: %s", self.id, UNREACHED_REASON)
        self.lose_quorum()
        while self.news.key() == key and not self.is_over:
            await self.sleep(self.news.period)

    # What it knows --------------------------------------------------------------------

    @property
    def is_over(self) -> bool:
        """The team has ended, or this robot ends without it."""
        return self.news.ended or self.alone

    @property
    def speaks(self) -> bool:
        """This robot logs what all robots know: it has the lowest id of all that fly."""
        return self.id == min(self.news.alive_ids(), default=self.id)

    def here(self) -> Place:
        """Return the place of the robot, (2,) m.

        If its estimate is beyond LARGEST_TASK_NUMBER, it is the last valid place: other robots
        could not read the new one.
        """
        place = project_to_plane(self.state.p)
        if all(abs(x) <= LARGEST_TASK_NUMBER for x in place):
            self._seen = place
        return self._seen

    def above(self, place: Sequence[float] | Vec) -> Vec:
        """Return the point (3,) m at take-off height above a place, (2,) m or (3,) m."""
        flight = self.member.config.flight
        return np.array([*place[0:2], flight.ground + flight.takeoff_height])


def project_to_plane(p: Sequence[float] | Vec) -> Place:
    """Return a place in the plane, (2,) m."""
    return float(p[0]), float(p[1])


def _describe_failure(cause: BaseException) -> str:
    """Return why the drone lands. Empty if the mission was only cancelled."""
    if isinstance(cause, asyncio.CancelledError):
        return ""
    return f"mission failed: {reason_or(cause, error_text(cause))}"
