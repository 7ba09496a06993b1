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
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from crazychoir.guidance.delivery.commitments import Commitments
from crazychoir.guidance.delivery.plan_notes import PlanNotes
from crazychoir.guidance.delivery.replanning import (
    AUCTION_METHOD,
    Mark,
    PlannedGoods,
    PlanShare,
    Replanning,
    identify_tasks,
)
from crazychoir.guidance.delivery.route_forecast import RouteForecast
from crazychoir.guidance.delivery.site import DeliverySite
from crazychoir.guidance.delivery.stop_service import StopService
from crazychoir.guidance.flights import FLIGHT_LIMITS
from crazychoir.guidance.member import Member
from crazychoir.guidance.tasks.task_book import Place, Record, Task
from crazychoir.guidance.tasks.task_source import TaskEvent, TaskSource
from crazychoir.guidance.tasks.team_mission import (
    PLAN_LOOK_INTERVAL,
    TeamMission,
    TeamRules,
    project_to_plane,
)
from crazychoir.guidance.tasks.team_news import NEWS_TIMING, UNREACHED_REASON, Key
from crazychoir.guidance.tasks.together import cancel_task, run_together, wait_unless
from crazychoir.routing.instance.instance import LocalProblem
from crazychoir.routing.instance.plan import Stop
from crazychoir.types import Bools, Vec


@dataclass(frozen=True, slots=True)
class OnlineTiming:
    """Times of a robot of the online mission."""

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


def _find_servable(site: DeliverySite, robot: int, goods: PlannedGoods) -> Bools:
    """Return, for each task of a planning, whether the robot may serve it.

    It may serve a task that is meant for it, and free at a place where a drone can stand, or on
    board of this robot.
    """
    places = zip(goods.tasks, goods.pickup, goods.left_by, strict=True)
    is_well_placed = np.array(
        [not site.explain_bad_place(*where) for where in places], dtype=bool
    )
    is_meant = np.array([site.may_serve(robot, task) for task in goods.tasks], bool)
    is_free = np.array(goods.free, dtype=bool)
    is_aboard = np.array(goods.mine, dtype=bool)
    servable: Bools = is_meant & (is_free & is_well_placed | is_aboard)
    return servable


class OnlinePDVRPGuidance(TeamMission):
    """Robot i of the online mission, with its own home, capacity, limit and capability.

    own: this robot's part of the instance. Its capability counts for the first `len(own.tasks)`
        tasks. All later tasks name the robots that may serve them.
    tasks: the tasks that are known at the start.
    events: the tasks and cancellations that will come.
    options: what all robots have in common.

    way: (2,) m each: its home, and where its flights ended.
    plannings: s that each planning took.
    flown: m flown so far.
    up: the robot flies.
    commitments: its route, and what it may begin. Set by `bind`.
    forecast: when it will have served its route. Set by `bind`.
    service: how it serves its stops. Set by `bind`.
    notes: what its plannings could not do. Set by `bind`.
    """

    commitments: Commitments
    forecast: RouteForecast
    service: StopService
    notes: PlanNotes

    def __init__(
        self,
        own: LocalProblem,
        tasks: Sequence[Task],
        events: Sequence[TaskEvent],
        options: OnlineDeliveryOptions,
    ) -> None:
        rules = TeamRules(
            options.recover, NEWS_TIMING.period, ONLINE_TIMING.reunion_time
        )
        super().__init__(rules, tasks)
        self.own = own
        self.options = options
        self.events = tuple(sorted(events, key=lambda event: event.t))
        self.way: list[Place] = [project_to_plane(own.home)]
        self.plannings: list[float] = []
        self.flown = 0.0
        self.up = False
        self._mark: Mark | None = None

    def bind(self, member: Member) -> None:
        """Connect this guidance to its drone."""
        super().bind(member)
        options = self.options
        self.commitments = Commitments(self.news)
        self.forecast = RouteForecast(
            self.commitments, member.config.flight, options.service_time
        )
        self.service = StopService(
            self.commitments, self.forecast, options.service_time, options.recover
        )
        self.notes = PlanNotes(self.news, options.site)
        self.source = TaskSource(self.news, options.site, self.events, self._may_end)
        self._redirected = asyncio.Event()
        member.report = lambda: {"task": self._task()}

    async def mission(self) -> dict[str, Any]:
        """Wait for the start on the ground, then fly, gossip, listen and plan with the team."""
        await self.wait_for_start()
        return await super().mission()

    def outcome(self) -> dict[str, Any]:
        """Return this drone's part of the report."""
        return {
            "served": self.service.served,
            "way": self.way,
            "tasks": {
                str(j): [s.fate.value, s.robot]
                for j, s in self.news.standings().items()
            },
            "unserved": {str(j): why for j, why in self.notes.unserved.items()},
            "plannings_s": self.plannings,
            "fallbacks": self.notes.fallbacks,
            "longest_wait_s": self.service.longest_wait,
            "dropped": self.news.dropped,
        }

    def _task(self) -> str:
        aboard = len(self.commitments.aboard())
        left = len(self.commitments.route)
        doing = "planning again, " if self.commitments.planning else ""
        return f"{doing}{len(self.service.served)} stops done, {left} to do, {aboard} aboard"

    def route(self) -> list[Vec]:
        """Return the places that the robot will still visit: its stops, then its home."""
        stops = [] if self.news.record.out else self.commitments.route
        places = (
            [*map(self.forecast.place, stops), self.own.home[:2]]
            if self.up or stops
            else []
        )
        return [self.above(p) for p in places]

    def _may_end(self) -> bool:
        """Return whether the planning that runs may end the mission.

        Tasks that arrive now are too late for it.
        """
        return self.commitments.planning and self.news.record.idle

    # Planning -------------------------------------------------------------------------

    def needs_plan(self, alive: Collection[Record]) -> bool:
        """Return whether tasks have changed, the robot is late, or no robot has work."""
        return (
            identify_tasks(self.news.book) != self._mark
            or self.forecast.is_late(ONLINE_TIMING.late_time)
            or all(r.idle for r in alive)
        )

    async def plan_once(self, key: Key) -> bool:
        """Plan once with the team of this key, and fly by the new plan from then on.

        Returns False if the team has changed meanwhile.
        """
        began = self.member.clock.now()
        share = await self._planned(key)
        if share is None:
            return False
        self.plannings.append(self.member.clock.now() - began)
        self._adopt(share)
        return True

    async def _planned(self, key: Key) -> PlanShare | None:
        """Run one planning with the team. Returns None if the team has changed meanwhile."""
        links = self.news.links(without=key[1])
        head, start, ready = self.forecast.head(ONLINE_TIMING.binding_horizon)
        bonds = self.commitments.begin(head)
        left = max(
            0.0,
            self.own.limit - self.flown - float(np.linalg.norm(start - self.here())),
        )
        problem = partial(self._problem, start=start, ready=ready, left=left)
        program = Replanning(
            self.id,
            links,
            self.news.book,
            bonds,
            problem,
            self.options.recover,
            self.options.method,
        )
        is_done = await run_together(self.news, program, links, key)
        return program.result if is_done else None

    def _problem(
        self, goods: PlannedGoods, start: Vec, ready: float, left: float
    ) -> LocalProblem:
        """Return the problem that this robot brings to a planning.

        Goods at a place where no drone can stand get no capable robot, so they are left there.

        goods: the tasks of the planning.
        start: (2,) m: where the robot will be.
        ready: s until it is there.
        left: m that it may still fly from there.
        """
        own = self.own
        mine = np.array(goods.mine, dtype=bool)
        return replace(
            own,
            tasks=goods.public(self.options.service_time),
            capable=_find_servable(self.options.site, self.id, goods),
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
        self.forecast.promise()
        self.notes.note(len(self.plannings), share, self.speaks)
        self._redirected.set()

    def lose_quorum(self) -> None:
        """Give up the plan, because too few robots are in reach to decide.

        The robot delivers the goods on board and flies home. With `options.recover` a flying robot
        lands where it is instead, and is out: the rest of the team may already fly to its goods.
        """
        if self.options.recover and self.up:
            self.reason = UNREACHED_REASON
            self.news.say(out=True)
        self.commitments.keep_aboard()
        self._redirected.set()

    # Flying ---------------------------------------------------------------------------

    def is_busy(self) -> bool:
        """Return whether the robot flies or serves a stop."""
        return (
            self.member.pilot.remaining() > 0.0
            or self.member.clock.now() < self.forecast.serving_until
        )

    async def end_flight(self, flight: "asyncio.Task[None]") -> None:
        """End the wait for further stops: the robot is on the ground when the team has ended."""
        flight.cancel()

    def leave(self) -> None:
        """Tell the team that this robot flies no more."""
        self.up = False
        super().leave()

    async def fly_plan(self) -> None:
        """Serve stop by stop. Without stops, fly home and wait on the ground."""
        while not self.news.record.out:
            stop = self.commitments.next()
            if stop is None:
                await self._rest()
            elif await self._reach(stop):
                await self.service.serve(stop)
        await self.land()
        self.leave()

    async def _reach(self, stop: Stop) -> bool:
        """Fly to a stop.

        Returns False if another stop has become the next one, or if newer information moves it.
        """
        if not self.up:
            self.up = True
            self.news.say(landed=False, idle=False)
            await self.take_off()
        return await self._to(
            goal := self.forecast.place(stop), lambda: self._leads_to(stop, goal)
        )

    def _leads_to(self, stop: Stop, goal: Vec) -> bool:
        """Return whether a stop is still the next one, and still at this place.

        A newer record of a lost robot may move its goods.
        """
        return (
            self.commitments.next() == stop
            and float(np.linalg.norm(self.forecast.place(stop) - goal))
            < FLIGHT_LIMITS.arrival_distance
        )

    async def _to(self, goal: Vec, valid: Callable[[], bool]) -> bool:
        """Fly straight to a place, as long as it is the right goal. Returns whether it still is."""
        await self._come_to_rest()
        leg = asyncio.ensure_future(self.go_to(self.above(goal)))
        began = np.array(self.here())
        try:
            while not leg.done():
                self._redirected.clear()
                await wait_unless(leg, self._redirected)
                if not valid():
                    return False
            leg.result()
        finally:
            await cancel_task(leg)
            self.flown += float(np.linalg.norm(self.here() - began))
            self.way.append(self.here())
        return valid()

    async def _come_to_rest(self) -> None:
        """Stop before a flight to another place.

        A flight that turns round on its way swings far out.
        """
        pilot = self.member.pilot
        if pilot.remaining() > 0.0:
            pilot.hover()
            await self.sleep(pilot.remaining())

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
        await self.sleep(PLAN_LOOK_INTERVAL)
