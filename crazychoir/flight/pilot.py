"""The pilot of one drone: what guidance and operator may ask of it, and its part in each tick.

The pilot always has the last word: whatever guidance asks, or fails to ask, each tick ends in a
command that the safety table allows. The straight line of a tick is in tick.py.
"""

import asyncio
import logging
import math

import numpy as np

from crazychoir.bus.port import Port
from crazychoir.errors import error_text
from crazychoir.filters.state_filter import StateFilter
from crazychoir.flight.batch import DroneRow
from crazychoir.flight.body import DroneBody
from crazychoir.flight.clearance import Clearance
from crazychoir.flight.drone_stages import DroneStages
from crazychoir.flight.follower import FlightFollower
from crazychoir.flight.judge import Judge
from crazychoir.flight.notes import FlightNotes
from crazychoir.flight.permission import Permission
from crazychoir.flight.point_flights import PointFlights
from crazychoir.flight.references import convert_reference, explain_refusal
from crazychoir.flight.setup import FlightSetup
from crazychoir.flight.tick import FlightTick
from crazychoir.planning.landing import STRAIGHT_DOWN, Descent
from crazychoir.planning.trajectory import Trajectory
from crazychoir.runtime.actor import Actor, RestartPolicy
from crazychoir.runtime.clock import NS_PER_SECOND, Clock
from crazychoir.safety.collision.agreed.planned import PlannedFlights
from crazychoir.safety.collision.filter import CollisionFilter
from crazychoir.safety.rules.guard import Guard
from crazychoir.safety.rules.modes import (
    GUIDED_MODES,
    Mode,
    ModeEvent,
)
from crazychoir.types import Point, Pose, Reference, State

log = logging.getLogger(__name__)
GIVE_UP_HOVER = 2.0
"""Seconds of hovering after guidance has failed, before the landing."""
GIVE_UP_TICKS = 0.5
"""Seconds of failed ticks, within 10 s, after which the pilot is given up.

The safety table lets the drone fly for as long without a pose.
"""


class TickRun:
    """The run of a pilot: the drone ticks until a tick of it fails.

    row: of the drone in its batch
    """

    def __init__(self, row: DroneRow) -> None:
        self._row = row
        self._end: asyncio.Future[None] | None = None

    async def wait(self) -> None:
        """Run, and raise the error of the tick that fails."""
        self._end = asyncio.get_running_loop().create_future()
        self._row.drone["is_running"] = 1
        try:
            await self._end
        finally:
            self._row.drone["is_running"] = 0
            self._row.drone["ticks"] = 0
            self._end = None

    def fail(self, error: BaseException) -> None:
        """End the run with this error; raise it if the process ends."""
        if isinstance(error, KeyboardInterrupt | SystemExit):
            raise error
        self._row.drone["is_running"] = 0
        end = self._end
        if end is None or end.done():
            log.error("%s, after its run has ended", error_text(error), exc_info=error)
            return
        # No future takes these.
        is_bare = not isinstance(error, Exception) or isinstance(error, StopIteration)
        end.set_exception(
            RuntimeError(f"in a tick: {error_text(error)}") if is_bare else error
        )


class Pilot(Actor):
    """Flies one drone.

    Guidance calls `take_off`, `go_to`, `fly`, `follow`, `hover` and `land`. The operator calls `hold`,
    `start` and `go_home` too.

    port: the port of the drone on the bus
    body: of the drone
    setup: what is known of the drone
    state_filter: of the drone, None for a Kalman filter
    collision: the collision filter, or the planner of agreed paths; None for neither
    tick: of the process, None for one of its own
    row: record of the drone in the batch of the tick, None for a new one
    guard: of the drone, with that record; None for a new one
    """

    name = "pilot"

    def __init__(
        self,
        port: Port,
        body: DroneBody,
        setup: FlightSetup,
        state_filter: StateFilter | None = None,
        collision: CollisionFilter | PlannedFlights | None = None,
        tick: FlightTick | None = None,
        row: DroneRow | None = None,
        guard: Guard | None = None,
    ) -> None:
        self.port = port
        self.body = body
        self.setup = setup
        self.tick = FlightTick(port.bus) if tick is None else tick
        self.row = self.tick.batch.add(port.address) if row is None else row
        self.guard = setup.make_guard(self.row) if guard is None else guard
        self.notes = FlightNotes(port)
        self.permission = Permission(self.row, setup.limits.operator)
        flights = PointFlights(setup.limits, setup.fence, setup.a_max, self.row.plan)
        clearance = Clearance(collision, flights, setup.period, self.row)
        self.follower = FlightFollower(
            setup, self.row, self.permission, self.guard, self.notes, clearance
        )
        self.judge = Judge(
            setup,
            self.row,
            body,
            self.guard,
            self.notes,
            self.permission,
            self.follower,
        )
        if state_filter is None:
            state_filter = setup.make_filter(self.row)
        self.stages = DroneStages(self, state_filter)
        self.tick.add(self.stages, self.row.index, setup.period)
        # A drone in flight cannot wait.
        limit = max(5, round(GIVE_UP_TICKS * setup.rate))
        self.restart = RestartPolicy(limit=limit, backoff=0.0)
        self._run = TickRun(self.row)

    async def run(self) -> None:
        """Let the drone tick until a tick of it fails."""
        await self._run.wait()

    def see(self, pose: Pose | None, age: float = 0.0) -> None:
        """Tick in the next pass of the loop, with a pose or without.

        age: s that the pose was on its way
        """
        believed = self.stages.receive_pose(pose, age)
        if self.row.drone["is_running"]:
            self.tick.see(self.row.index, believed)

    def fail(self, error: BaseException) -> None:
        """End the run after a failed tick. The supervisor decides; other drones go on."""
        if self.airborne:
            self.stages.steady()
        self._run.fail(error)

    def on_restart(self) -> None:
        """Forget what made the tick fail: come to rest and hover, or continue to land."""
        self.judge.begin_anew(self.clock.now())

    # What others ask most -----------------------------------------------------------------

    @property
    def clock(self) -> Clock:
        """The clock of the drone."""
        return self.port.bus.clock

    @property
    def mode(self) -> Mode:
        """The mode of the drone, see safety/rules/modes."""
        return self.row.mode

    @property
    def state(self) -> State | None:
        """The newest state of the drone; None before the first pose."""
        return self.row.state

    @property
    def airborne(self) -> bool:
        """Whether the motors may be running."""
        return self.permission.airborne

    @property
    def flights(self) -> PointFlights:
        """The flights that the pilot plans itself."""
        return self.follower.flights

    def gap(self, p: Point) -> float:
        """Return the distance in m from p, (3,) m; horizontal for a robot that drives."""
        away = self.row.get_state().p - np.asarray(p)
        is_planar = self.setup.controls.planar
        return float(np.linalg.norm(away[0:2] if is_planar else away))

    def remaining(self) -> float:
        """Return s until the planned flight is over; 0 for a landing that may begin anew."""
        return self.judge.touchdown.get_remaining(self.clock.now())

    def unready(self) -> tuple[str, str]:
        """Return the rule that forbids a take-off now, and its text; both empty if none does."""
        return self.permission.explain_no_take_off(
            self.port.bus.stopped, self.guard.latched, self.body.list_problems()
        )

    # What guidance asks -------------------------------------------------------------------

    def take_off(self, height: float | None = None, duration: float = 0.0) -> float:
        """Rise to `height` m above the ground, inside the fence, and return the time it will take.

        Only a drone on the ground takes off. It stays there while it is held and during an
        emergency stop. After its motors were cut, or a latched rule of the safety table has acted,
        it stays there until its agent is started again. Returns 0 then.

        duration: s; the rise takes longer if the limits demand it
        """
        rule, why = self.unready()
        if height is not None and not math.isfinite(height):
            rule = "rise"
            why = f"a take-off to {height} m: not flown"
        if why:
            self.notes.say(rule, why)
            return 0.0
        return self.judge.begin_take_off(height, self.clock.now(), duration)

    def go_to(
        self,
        p: Point,
        yaw: float | None = None,
        duration: float = 0.0,
        commanded: bool = False,
    ) -> float:
        """Fly to p inside the fence, and return the time it will take.

        Returns 0 if the drone may not fly now, see Judge.may_fly.

        p: (3,) m, world
        yaw: rad, None to keep the present yaw
        duration: s; the flight takes longer if the limits demand it
        commanded: True if the operator wants the flight. The operator may fly the drone when
            guidance may not, see Permission.steerable.
        """
        if not self.judge.may_fly(commanded):
            return 0.0
        return self.follower.go_to(p, yaw, duration, self.clock.now())

    def fly(self, trajectory: Trajectory, commanded: bool = False) -> float:
        """Fly a trajectory from its beginning, now, and hover at its end.

        The caller has checked that the trajectory begins where the drone is and stays inside the
        fence and within the limits.

        commanded: as in `go_to`
        Returns the duration in s; 0 if the drone may not fly now, see Judge.may_fly.
        """
        if not self.judge.may_fly(commanded):
            return 0.0
        return self.follower.fly(trajectory, self.clock.now())

    def follow(self, reference: Reference, commanded: bool = False) -> bool:
        """Fly this reference from the next tick on; return False if it can never be flown.

        The reference must be renewed before it is stale. What is no reference or not finite is not
        flown, and neither is a Goto to a place where no goal may be. A reference that asks for more
        than [flight] allows is cut. A repeated Goto continues its flight. A held drone ignores all
        but references that its operator has commanded.

        commanded: as in `go_to`
        """
        permission = self.permission
        may_fly = permission.may_fly(True) if commanded else permission.obeys
        state = self.state
        if state is None or not may_fly:
            return True
        wanted = convert_reference(reference)
        if wanted is None:
            self.notes.say("reference", f"{explain_refusal(reference)}: not flown")
            return False
        why = self.follower.follow(wanted, state, self.clock.now_ns())
        if why:
            self.notes.say("sender", why)
        return not why

    def hover(self, commanded: bool = False) -> None:
        """Come to rest in the shortest distance that the limits allow, and stay there.

        A drone at rest stays where it is. A flight that its operator has commanded goes on, unless
        the operator commands this.

        commanded: as in `go_to`
        """
        is_guided = self.mode in GUIDED_MODES
        if is_guided and (commanded or not self.permission.commanded):
            self.follower.rest(self.clock.now())

    def land(
        self, reason: str = "", grave: bool = False, descent: Descent = STRAIGHT_DOWN
    ) -> float:
        """Come to rest, then fly straight down inside the fence, and stop the motors.

        reason: empty if guidance wants the landing; a held or returning drone then does not land
        grave: whether the reason needs attention
        descent: where the way down ends, and how long it takes
        Returns s until the motors stop, 0 if the drone does not begin to land.
        """
        return self.judge.touchdown.land(reason, grave, self.clock.now(), descent)

    def cut(self, reason: str) -> None:
        """Stop the motors, for good."""
        self.judge.cut(reason)

    def take_over(self) -> None:
        """Land a drone that others fly from where it is first seen.

        Until then it gets no commands.
        """
        self.permission.takes_over = True
        self.judge.watch_always()

    def guidance_failed(self, reason: str) -> None:
        """Hover, then land, because guidance is gone; a drone on the ground stays there.

        This holds for a flight that the operator has commanded too.
        """
        if not self.judge.lose_guidance(reason):
            return
        self.hover()
        due_ns = self.clock.now_ns() + round(GIVE_UP_HOVER * NS_PER_SECOND)
        why = f"guidance failed ({reason}): landing"
        self.clock.call_at(due_ns, self.land, why, drone=self.port.address)

    # What its operator commands -----------------------------------------------------------

    def hold(self, on: bool = True) -> None:
        """Keep the drone where it is, unless it lands, or let guidance move it again."""
        self.judge.hold(on, self.clock.now())

    def go_home(self, home: Point, level: float) -> None:
        """Rise to `level` m, fly home at that height, and land there, see Judge.begin_return."""
        if not self.permission.refuses(ModeEvent.HOME) and self.state is not None:
            self.judge.begin_return(home, level, self.clock.now())
