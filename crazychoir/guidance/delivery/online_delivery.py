"""OnlinePDVRPGuidance: pickup and delivery while tasks and robots come and go.

No drone stops to plan. Each robot does four things at the same time. It flies its route. It gossips
its task book. It learns of new tasks. And it plans again with the team, in rounds, whenever tasks
or team differ from those of its present route.

Three rules prevent a task from being served twice.

A plan gives each free task to one robot. From the first message of a planning until it adopts the
new plan, a robot begins no pickup except those named in that message (`bound`). Two robots that
both hold a task as their own have therefore adopted the same plan.

A stop counts from the moment when the robot that stands there announces it. The robot leaves only
when more than half of the team are known to have received the announcement. A robot that is lost in
between lies at that very place, with its goods. A pickup that no robot has heard of has not
happened. A delivery that any robot has heard of has happened.

A part of the team that is cut off, with at most half of the robots before, picks nothing up.
"""

import asyncio
import logging
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from crazychoir.errors import CrazyChoirError, RosterChanged
from crazychoir.guidance.delivery.commitments import Commitments
from crazychoir.guidance.delivery.replanning import (
    AUCTION_METHOD,
    Mark,
    PlannedGoods,
    PlanShare,
    Replanning,
    identify_tasks,
)
from crazychoir.guidance.delivery.site import DeliverySite
from crazychoir.guidance.guidance import FLIGHT_LIMITS, CFGuidance
from crazychoir.guidance.member import Interrupted, Member, wait_for_touchdown
from crazychoir.guidance.tasks.task_book import LARGEST_TASK_NUMBER, Place, Task
from crazychoir.guidance.tasks.task_source import TaskEvent, TaskSource
from crazychoir.guidance.tasks.team_news import (
    NEWS_TIMING,
    UNREACHED_REASON,
    Key,
    TeamNews,
)
from crazychoir.guidance.tasks.together import cancel_task, run_together, wait_unless
from crazychoir.planning.point_to_point import compute_flight_time
from crazychoir.routing.instance.instance import LocalProblem
from crazychoir.routing.instance.plan import Stop
from crazychoir.types import FullState, Vec

log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class OnlineTiming:
    """Times of a robot of the online mission."""

    poll_interval: float = 0.05
    """s: interval at which the robot looks for changes."""
    binding_horizon: float = 3.0
    """s of its flight to which a robot is bound when a planning begins.

    A planning in which a robot is lost takes this long.
    """
    late_time: float = 5.0
    """s: the team plans again when a robot is this much later than its plan."""
    reunion_time: float = 30.0
    """s after which a robot that neither flies nor serves ends its mission.

    It applies when the robot is cut off, or when no other robot flies.
    """


ONLINE_TIMING = OnlineTiming()


NO_PLAN_REASON = "no plan: only goods on board are delivered"
"""Reason when all methods have failed."""
TOO_FAR_REASON = "no drone that can serve it has enough left of its route_length_limit"
"""Reason when no robot has enough range left."""


@dataclass(frozen=True)
class OnlineDeliveryOptions:
    """What all robots of a mission have in common."""

    site: DeliverySite
    """Where goods may lie, and which robots may serve which."""
    service_time: float = 1.0
    """s at each stop."""
    recover: bool = False
    """Goods of a lost robot are fetched from its last place."""
    until: float = 0.0
    """s after GO before which no robot considers the mission over."""
    method: str = AUCTION_METHOD
    """How tasks are shared out, see Replanning."""


class OnlinePDVRPGuidance(CFGuidance):
    """Robot i of the online mission, with its own home, capacity, limit and capability.

    own: this robot's part of the instance. Its capability counts for the first `len(own.tasks)`
        tasks. All later tasks name the robots that may serve them.
    tasks: the tasks that are known at the start.
    events: the tasks and cancellations that will come.
    options: what all robots have in common.
    """

    def __init__(
        self,
        own: LocalProblem,
        tasks: Sequence[Task],
        events: Sequence[TaskEvent],
        options: OnlineDeliveryOptions,
    ) -> None:
        self.own = own
        self.options = options
        self.events = tuple(sorted(events, key=lambda event: event.t))
        self.tasks = tuple(tasks)
        self.served: list[dict[str, Any]] = []
        self.way: list[Place] = [_project_to_plane(own.home)]
        self.unserved: dict[int, str] = {}
        self.plannings: list[float] = []
        self.fallbacks: list[dict[str, Any]] = []
        self.longest_wait = self.flown = 0.0
        self.up = False
        self.reason = ""
        self._mark: Mark | None = None
        self._promised = np.inf
        self._serving_until = 0.0

    def bind(self, member: Member) -> None:
        """Connect this guidance to its drone."""
        super().bind(member)
        self._seen = _project_to_plane(self.own.home)
        self.news = TeamNews(
            member.communicator, self.tasks, self._here, self.options.recover
        )
        self.commitments = Commitments(self.news)
        self.source = TaskSource(
            self.news, self.options.site, self.events, self._may_end
        )
        self._redirected = asyncio.Event()
        member.report = lambda: {"task": self._task()}

    async def mission(self) -> dict[str, Any]:
        """Fly, gossip, listen and plan, until the team agrees that no work is left."""
        await self.wait_for_start()
        try:
            async with asyncio.TaskGroup() as group:
                work = (
                    self.news.gossip(),
                    self.source.hear(),
                    self._fly(),
                    self._left_alone(),
                )
                jobs = [group.create_task(job) for job in work]
                await self._plan()
                await self.news.farewell()
                for job in jobs:
                    job.cancel()
        except BaseException as error:
            cause = (
                error.exceptions[0] if isinstance(error, BaseExceptionGroup) else error
            )
            await self._come_down(
                ""
                if isinstance(cause, asyncio.CancelledError)
                else f"mission failed: {cause}"
            )
            await self.news.last_words()
            if cause is error:
                raise
            raise cause from error
        return self.outcome()

    async def _come_down(self, reason: str) -> None:
        """Land before the others learn that the robot is out.

        They then come to its place for its goods.
        """
        self.member.pilot.land(reason)
        await wait_for_touchdown(self.member.pilot, FLIGHT_LIMITS.touchdown_time)

    def outcome(self) -> dict[str, Any]:
        """Return this drone's part of the report."""
        return {
            "served": self.served,
            "way": self.way,
            "tasks": {
                str(j): [s.fate.value, s.robot]
                for j, s in self.news.standings().items()
            },
            "unserved": {str(j): why for j, why in self.unserved.items()},
            "plannings_s": self.plannings,
            "fallbacks": self.fallbacks,
            "longest_wait_s": self.longest_wait,
            "dropped": self.news.dropped,
            **({"success": False, "reason": self.reason} if self.reason else {}),
        }

    def _task(self) -> str:
        aboard = len(self.commitments.aboard())
        left = len(self.commitments.route)
        doing = "planning again, " if self.commitments.planning else ""
        return f"{doing}{len(self.served)} stops done, {left} to do, {aboard} aboard"

    @property
    def _now(self) -> float:
        return self.member.clock.now()

    def _here(self) -> Place:
        """Return the place of the robot, (2,) m.

        If its estimate is beyond LARGEST, it is the last valid place: other robots could not read
        the new one.
        """
        place = _project_to_plane(self.state.p)
        if all(abs(x) <= LARGEST_TASK_NUMBER for x in place):
            self._seen = place
        return self._seen

    async def asked(self, verb: str, arguments: dict[str, Any]) -> Any:
        """Answer an operator: add a task, cancel a task, or list the tasks. See TaskSource."""
        return await self.source.asked(verb, arguments)

    def route(self) -> list[Vec]:
        """Return the stops that it is to serve, then its home."""
        stops = [] if self.news.record.out else self.commitments.route
        places = (
            [*map(self._place, stops), self.own.home[:2]] if self.up or stops else []
        )
        return [self._above(p) for p in places]

    def _may_end(self) -> bool:
        """Return whether a planning runs that may end the mission.

        It does not know of tasks that come now.
        """
        return self.commitments.planning and self.news.record.idle

    # Planning -------------------------------------------------------------------------

    async def _plan(self) -> None:
        """Plan at the start, and whenever a planning is due, until the team has ended.

        A change of the team also needs a planning.
        """
        while not self.news.ended:
            key = self.news.key()
            self.news.changed.clear()
            if not self.news.count():
                await self._cut_off(key)
            elif self.id in key[1]:
                await self.sleep(
                    NEWS_TIMING.period
                )  # out: the others continue without this robot
            else:
                try:
                    await self._plannings(key)
                except RosterChanged:
                    continue

    async def _plannings(self, key: Key) -> None:
        """Run the plannings of one team.

        When a robot begins a planning, all others begin it too.
        """
        n = 0
        while self.news.key() == key and not self.news.ended:
            if n and not self._wanted(key, n):
                await self.sleep(ONLINE_TIMING.poll_interval)
                continue
            n += 1
            began = self._now
            self.news.say(run=(key[0], len(key[1]), n))
            share = await self._planned(key)
            if share is None:
                return
            self.plannings.append(self._now - began)
            self._adopt(share)

    def _wanted(self, key: Key, n: int) -> bool:
        """Return whether a planning is due: a robot plans already, or there is a reason to plan."""
        alive = self.news.book.alive(self.graph.ids).values()
        begun = any(r.run[:2] == (key[0], len(key[1])) and r.run[2] > n for r in alive)
        return (
            begun
            or identify_tasks(self.news.book) != self._mark
            or self._late()
            or all(r.idle for r in alive)
        )

    def _late(self) -> bool:
        route = self.commitments.route
        return (
            bool(route)
            and self._now + self._seconds(route)
            > self._promised + ONLINE_TIMING.late_time
        )

    async def _planned(self, key: Key) -> PlanShare | None:
        """Run one planning with the team. Returns None if the team has changed meanwhile."""
        links = self.news.links(without=key[1])
        head, start, ready = self._head()
        bound, aboard = self.commitments.begin(head)
        left = max(
            0.0,
            self.own.limit - self.flown - float(np.linalg.norm(start - self._here())),
        )
        problem = partial(self._problem, start=start, ready=ready, left=left)
        program = Replanning(
            self.id,
            links,
            self.news.book,
            bound,
            aboard,
            problem,
            self.options.recover,
            self.options.method,
        )
        return (
            program.result
            if await run_together(self.news, program, links, key)
            else None
        )

    def _head(self) -> tuple[list[Stop], Vec, float]:
        """Return the stops to which this robot is bound, the place after them, and the s until
        then.

        These are the stop to which it flies now and the stops within HORIZON. While a planning has
        not led to a plan, other robots may have one: then the robot is bound to nothing new.
        """
        head: list[Stop] = []
        p = np.array(self._here())
        seconds = max(0.0, self._serving_until - self._now)
        for stop in self.commitments.route:
            if not self.commitments.allow(stop) or (
                head and seconds > ONLINE_TIMING.binding_horizon
            ):
                break
            goal = self._place(stop)
            seconds += self._leg(p, goal) + self.options.service_time
            p = goal
            head.append(stop)
        return head, p, seconds

    def _problem(
        self, goods: PlannedGoods, start: Vec, ready: float, left: float
    ) -> LocalProblem:
        """Return this robot's own problem of a planning.

        No robot is capable of goods that lie where no drone can stand, so all leave them alone.

        goods: the tasks of the planning.
        start: (2,) m: where the robot will be.
        ready: s until it is there.
        left: m that it may still fly from there.
        """
        own = self.own
        site = self.options.site
        lie = zip(goods.tasks, goods.pickup, goods.left_by, strict=True)
        well = np.array([not site.lies_badly(*where) for where in lie], dtype=bool)
        may = np.array([site.may(self.id, task) for task in goods.tasks], dtype=bool)
        free = np.array(goods.free, dtype=bool)
        mine = np.array(goods.mine, dtype=bool)
        return replace(
            own,
            tasks=goods.public(self.options.service_time),
            capable=may & (free & well | mine),
            home=own.home[:2],
            start=start,
            start_time=ready,
            aboard=mine,
            left=left,
            speed=self.member.config.flight.speed_limit,
        )

    def _adopt(self, share: PlanShare) -> None:
        """Fly by this plan from now on."""
        self.commitments.adopt(share)
        self._mark = identify_tasks(share.book)
        self._promised = self._now + self._seconds(self.commitments.route)
        self._say_trouble(share.trouble)
        unplanned = (
            f"{NO_PLAN_REASON}: {share.trouble[AUCTION_METHOD]}"
            if AUCTION_METHOD in share.trouble
            else ""
        )
        self._say_unserved({j: unplanned or self._why(j) for j in share.unserved})
        self._redirected.set()

    def _why(self, j: int) -> str:
        """Return why no robot serves a free task."""
        task = self.news.book.tasks[j]
        standing = self.news.standings()[j]
        site = self.options.site
        flying = self.news.book.alive(self.news.members)
        badly = site.lies_badly(task, standing.pickup, standing.robot)
        return badly or site.never(task) or site.waits(task, flying) or TOO_FAR_REASON

    @property
    def _speaks(self) -> bool:
        """This robot logs what all robots know: it has the lowest id of all that fly."""
        return self.id == min(self.news.book.alive(self.news.members), default=self.id)

    def _say_trouble(self, trouble: dict[str, str]) -> None:
        """Record which methods have found no plan, and why: once in the log, and in the result."""
        n = len(self.plannings)
        for method, why in trouble.items():
            instead = (
                NO_PLAN_REASON
                if method == AUCTION_METHOD
                else f"planned by {AUCTION_METHOD}"
            )
            self.fallbacks.append(
                {"planning": n, "method": method, "why": why, "instead": instead}
            )
            if self._speaks:
                log.warning(
                    "drone %d: planning %d: %s: %s; %s",
                    self.id,
                    n,
                    method,
                    why,
                    instead,
                )

    def _say_unserved(self, unserved: dict[int, str]) -> None:
        """Log new reasons why tasks are left alone, each once."""
        for j, why in unserved.items():
            if self._speaks and self.unserved.get(j) != why:
                log.warning("drone %d: task %d is left alone: %s", self.id, j, why)
        self.unserved = unserved

    async def _cut_off(self, key: Key) -> None:
        """Deliver what is aboard and go home, while too few robots are here to decide.

        If others may fetch the goods of a lost robot, it stays where it is.
        """
        log.warning("drone %d: %s", self.id, UNREACHED_REASON)
        if self.options.recover and self.up:
            self.reason = UNREACHED_REASON
            self.news.say(out=True)
        self.commitments.keep_aboard()
        self._redirected.set()
        while self.news.key() == key and not self.news.ended:
            await self.sleep(NEWS_TIMING.period)

    async def _left_alone(self) -> None:
        """End the mission if it waits for robots that are lost. Raises Interrupted."""
        why = await self.news.left_alone(ONLINE_TIMING.reunion_time, self._busy)
        raise Interrupted(
            f"{self.reason}; then {why}" if self.reason else f"drone {self.id}: {why}"
        )

    def _busy(self) -> bool:
        return self.member.pilot.remaining() > 0.0 or self._now < self._serving_until

    # The route ------------------------------------------------------------------------

    def _place(self, stop: Stop) -> Vec:
        """Return the place of a stop, (2,) m."""
        if stop.kind == "delivery":
            return np.array(self.news.book.tasks[stop.task].delivery)
        return np.array(self.news.standings()[stop.task].pickup)

    def _above(self, p: Vec) -> Vec:
        """Return the point (3,) m above a place in the plane."""
        flight = self.member.config.flight
        return np.array([*p, flight.ground + flight.takeoff_height])

    def _leg(self, a: Vec, b: Vec) -> float:
        flight = self.member.config.flight
        start = FullState.at(np.array([*a, 0.0]))
        goal = np.array([*b, 0.0])
        return compute_flight_time(
            start, goal, 0.0, flight.speed_limit, flight.acceleration_limit
        )

    def _seconds(self, route: Sequence[Stop]) -> float:
        """Return the s that a route takes from here."""
        p = np.array(self._here())
        total = max(0.0, self._serving_until - self._now)
        for stop in route:
            goal = self._place(stop)
            total = total + self._leg(p, goal) + self.options.service_time
            p = goal
        return total

    # Flying ---------------------------------------------------------------------------

    async def _fly(self) -> None:
        """Serve stop by stop. Without stops go home and wait on the ground.

        A robot that cannot fly on says so, and continues to pass messages on.
        """
        try:
            while not self.news.record.out:
                stop = self.commitments.next()
                if stop is None:
                    await self._rest()
                elif await self._reach(stop):
                    await self._serve(stop)
            await self.land()
        except CrazyChoirError as error:
            log.warning("drone %d: %s", self.id, error)
            self.reason = str(error)
            await self._come_down("")
        self.up = False
        self.news.say(out=True)

    async def _reach(self, stop: Stop) -> bool:
        """Fly to a stop.

        Returns False if it is not the next stop any more, or if it is elsewhere by what is known
        now.
        """
        if not self.up:
            self.up = True
            self.news.say(landed=False, idle=False)
            await self.take_off()
        return await self._to(
            goal := self._place(stop), lambda: self._leads_to(stop, goal)
        )

    def _leads_to(self, stop: Stop, goal: Vec) -> bool:
        """Return whether a stop is still the next one, and still at this place.

        A newer record of a lost robot may move its goods.
        """
        return (
            self.commitments.next() == stop
            and float(np.linalg.norm(self._place(stop) - goal))
            < FLIGHT_LIMITS.arrival_distance
        )

    async def _to(self, goal: Vec, valid: Callable[[], bool]) -> bool:
        """Fly straight to a place, as long as it is the right goal. Returns whether it still is."""
        await self._come_to_rest()
        leg = asyncio.ensure_future(self.go_to(self._above(goal)))
        began = np.array(self._here())
        try:
            while not leg.done():
                self._redirected.clear()
                await wait_unless(leg, self._redirected)
                if not valid():
                    return False
            leg.result()
        finally:
            await cancel_task(leg)
            self.flown += float(np.linalg.norm(self._here() - began))
            self.way.append(self._here())
        return valid()

    async def _come_to_rest(self) -> None:
        """Stop before a flight to another place.

        A flight that turns round on its way swings far out.
        """
        pilot = self.member.pilot
        if pilot.remaining() > 0.0:
            pilot.hover()
            await self.sleep(pilot.remaining())

    async def _serve(self, stop: Stop) -> None:
        """Announce the stop, serve it, and leave when the team knows."""
        if not await self._permitted(stop):
            return
        self._serving_until = self._now + self.options.service_time
        number = self.commitments.announce(stop)
        await self.sleep(self.options.service_time)
        if await self._known(number, stop):
            self.served.append(
                {"task": stop.task, "kind": stop.kind, "place": self._here()}
            )

    async def _permitted(self, stop: Stop) -> bool:
        """Wait above the stop while a plan may give it to another robot.

        Returns False if it is not the next stop any more.
        """
        since = self._now
        while self.commitments.next() == stop:
            if self.commitments.allow(stop):
                return True
            await self.sleep(ONLINE_TIMING.poll_interval)
            self._waited(since)
        return False

    async def _known(self, number: int, stop: Stop) -> bool:
        """Wait until more than half of the team have received the announcement of a stop.

        Returns False if the stop does not count. A robot that is cut off takes a pickup back. If
        others may fetch what it carries, they decide about a delivery.
        """
        since = self._now
        while True:
            if self.news.known(number):
                return True
            if not self.news.quorate:
                if stop.kind == "pickup":
                    self.commitments.take_back(stop.task)
                return stop.kind == "delivery" and not self.options.recover
            await self.sleep(ONLINE_TIMING.poll_interval)
            self._waited(since)

    def _waited(self, since: float) -> None:
        self.longest_wait = max(self.longest_wait, self._now - since)

    async def _rest(self) -> None:
        """Go home, land, and wait for something to do."""
        if self.up:
            if not await self._to(
                self.own.home[:2], lambda: self.commitments.next() is None
            ):
                return
            await self.land()
            self.up = False
            self.news.say(landed=True)
        idle = (
            self.source.age >= self.options.until
            and self.source.heard_all
            and not self.commitments.route
        )
        if idle != self.news.record.idle:
            self.news.say(idle=idle)
        await self.sleep(ONLINE_TIMING.poll_interval)


def _project_to_plane(p: Vec) -> Place:
    """Return a place in the plane, in m."""
    return float(p[0]), float(p[1])
