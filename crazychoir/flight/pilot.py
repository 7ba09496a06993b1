"""The pilot of one drone: pose -> filter -> reference -> controller -> guard -> command.

The pilot always has the last word: whatever guidance asks, or fails to ask, each tick ends in a
command that the safety table allows. A pose triggers the tick; if no pose comes in time, the clock
triggers it.
"""

import asyncio
import logging
import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any, Literal, Protocol

import numpy as np

from crazychoir.bus.port import Port
from crazychoir.bus.topics import DRONE_TOPICS
from crazychoir.config.tables import FlightTable
from crazychoir.control.choice import Controls, make_controls
from crazychoir.control.controller import CrazyflieController
from crazychoir.control.parameters import ControllerParameters
from crazychoir.control.position import FLATNESS_LIMITS
from crazychoir.control.senders import FPQRSender
from crazychoir.errors import ConfigError, error_text
from crazychoir.filters.state_filter import StateFilter
from crazychoir.flight.clearance import Clearance
from crazychoir.flight.estimate import SEEN_AGE, choose_filter, compute_believed_state
from crazychoir.flight.goals import require_goal
from crazychoir.flight.homecoming import Homecoming
from crazychoir.flight.point_flights import PointFlights, compute_braking_limit
from crazychoir.flight.references import (
    convert_reference,
    explain_refusal,
    extrapolate_reference,
)
from crazychoir.numerics.math3d import yaw_of
from crazychoir.planning.landing import Landing
from crazychoir.planning.trajectory import Trajectory
from crazychoir.runtime.actor import Actor, RestartPolicy
from crazychoir.runtime.clock import NS_PER_SECOND
from crazychoir.runtime.mailbox import Call
from crazychoir.safety.collision.agreed.planned import PlannedFlights
from crazychoir.safety.collision.filter import CollisionFilter
from crazychoir.safety.identity.pose_gate import PoseGate
from crazychoir.safety.rules.guard import (
    EDGE_MARGIN,
    FENCE_BELOW_GROUND,
    ON_BOARD_SAFETY_TABLE,
    RADIO_SAFETY_TABLE,
    SAFETY_TABLE,
    Action,
    Fence,
    Guard,
    SafetyVerdict,
    Throttle,
)
from crazychoir.safety.rules.limits import ReferenceLimits
from crazychoir.safety.rules.modes import (
    FOLLOW_MODE,
    GROUND_MODE,
    GUIDED_MODES,
    HELD_TEXT,
    HOVER_MODE,
    LAND_MODE,
    MOTORS_OFF_MODES,
    RETURN_MODE,
    TAKEOFF_MODE,
    Mode,
    ModeEvent,
    get_next_mode,
    get_refusal,
)
from crazychoir.types import (
    XYZ,
    ZERO_ACCELERATION,
    Acceleration,
    Command,
    FullState,
    Goto,
    Point,
    Pose,
    Reference,
    State,
    Vec,
    Velocity,
)

log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class TouchdownLimits:
    """When a landing drone counts as landed."""

    floor_height: float = 0.04
    """Height in m above the ground at which a landing drone stops its motors."""
    overdue_time: float = 2.0
    """Seconds after the planned touch-down when a drone slower than rest_speed counts as landed."""
    unseen_overdue_time: float = 0.5
    """Seconds after the planned touch-down when an unseen drone at rest counts as landed."""
    rest_speed: float = 0.05
    """m/s below which a drone is at rest."""
    replay_overdue_time: float = 5.0
    """s after the planned touch-down when the landing of a replayed drone is over, wherever its
    body is.
    """
    replanning_distance: float = 0.05
    """Distance in m from a drone to its landing plan at which the plan begins anew.

    While commands may be lost, each command that arrives asks for no more than this.
    """
    airborne_height: float = 0.2
    """Height in m above the ground at which a seen drone has not landed, whatever its plan says.
    """


TOUCHDOWN_LIMITS = TouchdownLimits()


REPLAY_TEXT = "follows a recording and obeys nothing"
"""What is said of a replayed drone that does not do what its mission asks."""
GIVE_UP_HOVER = 2.0
"""Seconds of hovering after guidance has failed, before the landing."""
GIVE_UP_TICKS = 0.5
"""Seconds of failed ticks, within 10 s, after which the pilot is given up.

The safety table lets the drone fly for as long without a pose.
"""

CUT_OFF_TEXT = "hears no more than half of the drones that fly: landing"
"""Reason of the landing of a drone that is cut off from the others."""


@dataclass(frozen=True, slots=True)
class LiftOffLimits:
    """When a drone that takes off has lifted off, or should have."""

    height: float = 0.03
    """Height in m above its place on the floor at which a drone flies.

    Below, its controllers learn nothing from an error of the height.
    """
    plan_height: float = 0.2
    """Height in m of the plan above the floor from which on the drone should have lifted off.
    """
    thrust_time: float = 0.4
    """Seconds after which a drone that is still on the floor does not rise; for senders of a
    thrust.
    """
    on_board_time: float = 0.8
    """Seconds after which a drone that is still on the floor does not rise, for other senders.

    Its firmware flies it, and takes off later.
    """


LIFT_OFF_LIMITS = LiftOffLimits()


@dataclass(frozen=True, slots=True)
class FirmwareLanding:
    """The landing of a drone by its firmware, without poses or commands."""

    pose_timeout: float = 0.5
    """Seconds without a pose after which the firmware lands a drone that is landing.

    The reason of the landing does not matter.
    """
    depth: float = 0.03
    """Depth in m below the ground where a landing by the firmware without poses ends.

    Its estimate of the height is off by cm after 3 s, that of its place by 1 m.
    """
    speed: float = 0.35
    """Descent speed in m/s of a landing by the firmware without poses."""
    motor_timeout: float = 10.0
    """Seconds beyond the planned time of a landing by the firmware, before the motors are stopped.
    """
    radio_timeout: float = 1.0
    """Seconds of silence of its radio after which a drone may no longer obey."""
    command_interval: float = 0.2
    """Seconds between two commands to the owner of a dongle to land a drone by its firmware."""


FIRMWARE_LANDING = FirmwareLanding()


ReachKind = Literal["no", "seen", "own"]
"""Kinds of reach: "no" radio, a radio and "seen" by cameras, or a radio and its "own" poses."""
THRUST_SENDERS = ("fpqr", "frpy")
"""Kinds of senders that command a thrust."""
LARGEST_THRUST_ERROR = 0.15
"""Largest allowed error of the hover thrust, as a share; a wrong thrust map is off by 0.27."""


@dataclass(frozen=True, slots=True)
class StrayBodyLimits:
    """When the seen body of a flying drone is where it should not be, and what is done then."""

    outside_time: float = 0.2
    """Seconds for which refused poses lie outside the limit area before the safety table acts on them."""
    on_floor_time: float = 1.0
    """Seconds on the floor, while the drone should fly, before this is acted upon."""
    silence: float = 0.5
    """Seconds of silence of its radio that explain why a drone has come down."""
    cut_height: float = 0.4
    """Height in m above the floor up to which the motors are cut if the pose is not the drone's own.

    Above, its firmware lands it without poses. A drone that flies by its own estimate, which was fed
    with these poses, is cut at any height: it would fly away by metres.
    """


STRAY_BODY_LIMITS = StrayBodyLimits()


LANDS_ASTRAY = 1.0
"""Value of the measure "astray" of a drone that may land by its firmware."""

NOMINAL_ACTION = Action.NOMINAL  # members of an enumeration are slow to look up
LOW_MODES = (TAKEOFF_MODE, LAND_MODE)
"""Modes in which the drone leaves the fence downwards."""


class PilotLink(Protocol):
    """The way to the drone: a simulated world or a radio."""

    def send(self, command: Command) -> None:
        """Let the drone obey this command until the next one."""
        ...

    def cut(self) -> None:
        """Stop the motors for good."""
        ...


class Pilot(Actor):
    """Flies one drone.

    Guidance calls `take_off`, `go_to`, `follow`, `hover` and `land`. The operator calls `hold` too.

    port: the port of the drone on the bus
    link: the way to the drone
    limits: [flight]
    fence: where the drone flies, from the ground up at most
    rate: Hz, of its poses
    chosen: the control scheme, None for the default
    state_filter: None for a Kalman filter
    body: the address that publishes the poses, None for the drone's own address
    collision: the collision filter, or the planner of agreed paths; None for neither
    limit_area: area outside which the motors are cut, None for the guard's default
    reached: "no" for a drone in a simulated world. "seen" for a drone behind a radio that cameras
        see: poses that jump are not believed. "own" for a drone behind a radio that finds its own
        pose. Behind a radio the firmware lands the drone when there are no poses.
    home: (3,) m, world: place above which the drone may always be sent, None for only where it
        took off
    is_replayed: True if the body follows a recording and obeys nothing
    """

    name = "pilot"

    def __init__(
        self,
        port: Port,
        link: PilotLink,
        limits: FlightTable,
        fence: Fence,
        rate: float = 100.0,
        chosen: Controls | None = None,
        state_filter: StateFilter | None = None,
        body: int | None = None,
        collision: CollisionFilter | PlannedFlights | None = None,
        limit_area: Fence | None = None,
        reached: ReachKind = "no",
        home: Point | None = None,
        is_replayed: bool = False,
    ) -> None:
        self.port = port
        self.link = link
        self.limits = limits
        self.controls = make_controls() if chosen is None else chosen
        self.parameters = ControllerParameters(self.controls)
        platform = self.controls.platform
        a_max = compute_braking_limit(
            limits,
            platform,
            FLATNESS_LIMITS.height_share * FLATNESS_LIMITS.acceleration_share,
        )
        self._takes_off = self.controls.takes_off
        self._planar = self.controls.planar
        ground = max(fence.low[2], limits.ground)
        self.fence = fence.with_floor(
            ground if self._takes_off else ground - FENCE_BELOW_GROUND
        )
        self.flights = PointFlights(limits, self.fence, a_max)
        self.clearance = Clearance(collision, self.flights, 1.0 / rate)
        table = ON_BOARD_SAFETY_TABLE
        if reached == "no":
            table = SAFETY_TABLE
        elif self.controls.sender.kind != "xyz":
            table = RADIO_SAFETY_TABLE
        self.guard = Guard(
            self.fence, table, a_max=a_max, ground=limits.ground, limit=limit_area
        )
        self._reached = reached != "no"
        self._gate = PoseGate() if reached == "seen" else None
        # Time in s when the firmware has landed the drone, after it was handed over.
        self._down_at = math.inf
        self._to_firmware: XYZ | None = None  # the command for that landing
        self._tell_owner_at = 0.0
        self.reference_limits = ReferenceLimits(limits, self.controls.gains)
        self.clock = port.bus.clock
        self._stages = port.bus.stages
        self.drone = port.address
        """Id of the drone."""
        self.mode: Mode = GROUND_MODE
        """Its mode, see modes."""
        self.state: State | None = None
        """Its newest state; None before the first pose."""
        # _evades: the last note of the collision filter.
        self.note = self._evades = ""
        self.grave = False
        """Whether the note needs attention: motors were cut, or the drone lands for safety."""
        self.brought_down = ""
        """Why the safety table first ended a flight by a landing; empty if it never did."""
        self.held = False
        """Whether the operator holds the drone."""
        self.commanded = False
        """Whether the flight, planned or about to begin, is the operator's.

        Guidance does not end such a flight.
        """
        self.unguided = ""
        """Why guidance is gone during the flight; empty while it is there."""
        self.turning: Callable[[], bool] = lambda: False
        """Return whether the motors turn or the body flies.

        The firmware says so, or the owner of the world, which lands the drone.
        """
        self.unheard: Callable[[], bool] = lambda: False
        """Return whether the owner of the body is silent.

        Commands do not arrive there then, and it lands the body without them.
        """
        self.unfit: Callable[[], list[str]] = list
        """Return further reasons why the drone may not take off."""
        self.astray: Callable[[], str] = str
        """Return how the body that the cameras take for the drone moved unlike it.

        Returns an empty text if it has not.
        """
        self.awaits_start = limits.operator
        """Whether the mission waits for the operator's start; until then guidance moves nothing."""
        self.started_at: Point | None = None
        """(3,) m, where it stood when it took off first."""
        self._home = home
        self.is_replayed = is_replayed
        self._replay_lands_at = math.inf  # s, when its landing counts as over
        self._way: Homecoming | None = None
        self._models = isinstance(self.controls.sender, FPQRSender)
        self.filter = (
            choose_filter("kalman", self.controls, limits.ground, rate)
            if state_filter is None
            else state_filter
        )
        self._reference: Reference | None = None
        self._reference_ns = 0
        seen = Call(self.clock, self._posed, f"drone {self.drone} pose")
        port.bus.subscribe(
            DRONE_TOPICS.pose, self.drone if body is None else body, self.drone, seen
        )
        self.period_ns = round(NS_PER_SECOND / rate)
        self.restart = RestartPolicy(
            limit=max(5, round(GIVE_UP_TICKS * rate)), backoff=0.0
        )  # a drone in flight cannot wait
        self._goto: tuple[float, ...] = ()  # the last Goto that was flown
        # The plan of that Goto.
        self._goto_plan: Trajectory | None = None
        self._a = ZERO_ACCELERATION  # m/s2, acceleration that the last command asks of the drone
        self._flown: FullState | None = (
            None  # reference of the last tick, if it was a FullState
        )
        self._stops: Trajectory | None = (
            None  # the plan that last brought the drone to rest
        )
        self._lift_off = 0.0  # m, height above which a drone that takes off flies
        # Time in s when it was last off the floor, or had no reason to be in the air.
        self._rises_at = 0.0
        self._outside_at = math.inf  # s, since when its body is seen outside
        self._outside_seen = -math.inf  # s, when a pose was last judged
        self._up_at = math.inf  # s, when it was last not seen on the floor
        self._obeyed = Action.NOMINAL  # action of the last verdict
        self._ticked_ns = 0
        self.cut_for = ""
        """Why the motors were cut for good; empty if they were not."""
        self._said = Throttle()
        self.braked = 0
        """Number of times the safety table has braked the drone in this flight."""
        self.at_fence = 0
        """Number of ticks at the fence because guidance wanted to be beyond it."""
        # Whether it flies to the fence only, because the wanted place is beyond it.
        self._beyond = False
        self._takes_over = False
        self._idle, self._level = (
            self.controls.sender.idle,
            self.controls.sender.steady(platform.weight),
        )
        self._run: asyncio.Future[None] | None = None

    async def run(self) -> None:
        """Handle a tick for each pose, or by the clock without poses, until a tick fails."""
        self._run = asyncio.get_running_loop().create_future()
        try:
            await self._run
        finally:
            self._run = None

    def _posed(self, pose: Pose | None, age: float) -> None:
        """Tick with a pose that is `age` s old, or without a pose."""
        # The pose was on its way for a while, or its own age is not a number.
        if pose is not None and not pose.age >= age:
            pose = Pose(pose.flat, age)
        if pose is not None and self._gate is not None:
            pose = self._believed(pose, self._gate)
        run = self._run
        if run is not None and not run.done():
            self.tick(pose)

    def _believed(self, pose: Pose, gate: PoseGate) -> Pose | None:
        """Return the pose, or None if it cannot be the pose of this drone."""
        now = self.clock.now()
        believed = gate.believes(pose, now, self.airborne)
        beyond = self.guard.beyond(pose.p)
        if believed or not beyond > 0.0:
            self._outside_at = math.inf
        elif self._outside_at == math.inf or now - self._outside_seen > SEEN_AGE:
            self._outside_at = now
        self._outside_seen = now
        if believed:
            return pose
        if now - self._outside_at > STRAY_BODY_LIMITS.outside_time:
            self.guard.tell("gone", beyond)
        self._say(
            "jump",
            "the pose has jumped: another body, or a mistake of the cameras: not believed",
        )
        return None

    def _fail(self, error: BaseException) -> None:
        """End the run after a failed tick; the supervisor decides what follows.

        The sender of the pose and the other drones go on.
        """
        run = self._run
        if run is None or isinstance(error, KeyboardInterrupt | SystemExit):
            raise error
        if not run.done():
            bare = not isinstance(error, Exception) or isinstance(
                error, StopIteration
            )  # no future takes these
            run.set_exception(
                RuntimeError(f"in a tick: {error_text(error)}") if bare else error
            )
        self._steady()

    def _steady(self) -> None:
        """After a failed tick, command the thrust of hovering and no body rates.

        This replaces the last command.
        """
        if not self.airborne:
            return
        try:
            self._send(self._level)
        except Exception as error:  # noqa: BLE001 - it may be the link that has failed
            self._say("link", f"no command reaches the drone: {error_text(error)}")

    def on_restart(self) -> None:
        """Forget what made the tick fail: come to rest and hover, or continue to land."""
        self._reference = self._flown = None
        self.flights.clear()
        if self.mode is LAND_MODE:
            self._descend()
        elif self.mode in GUIDED_MODES:
            self._change(ModeEvent.HOLD)

    def set_parameter(self, name: str, value: Any) -> Any:
        """Change a parameter from the next tick on, and return its value.

        Raises ConfigError if it may not be changed so.
        """
        found = self.parameters.set(name, value)
        self.reference_limits = ReferenceLimits(self.limits, self.controls.gains)
        return found

    def nudge(self, now_ns: int) -> None:
        """Tick without a pose if none has come for one and a half periods; the clock calls this."""
        if now_ns - self._ticked_ns > 1.5 * self.period_ns:
            self._posed(None, 0.0)

    def tick(self, pose: Pose | None) -> None:
        """Update the state, with a pose or by prediction, and start the stages of this tick."""
        try:
            now_ns = self._ticked_ns = self.clock.now_ns()
            now = now_ns / NS_PER_SECOND
            state = (
                self.filter.predict(now)
                if pose is None
                else self.filter.update(pose, now)
            )
            if state is not None:
                known = self._models or state.age <= SEEN_AGE
                flat = (
                    state.flat
                    if known
                    else compute_believed_state(
                        state, self.flights.sample(now) or self._flown
                    )
                )
                state = State(flat, state.age, self._a)
            self.state = state
        except BaseException as error:  # noqa: BLE001 - see _fail
            self._fail(error)
        else:
            if self.state is not None:
                stages = self._stages
                stages.say.append(self._say_state)
                stages.act.append(self._act)
                stages.due()

    def _say_state(self) -> None:
        """Publish the state of this tick.

        Guidance decides when all drones have published theirs.
        """
        state = self.state
        try:
            assert state is not None  # noqa: S101 - no state, no such stage
            self.port.publish(DRONE_TOPICS.state, state, state.age)
            self.clearance.publish(state)
        except BaseException as error:  # noqa: BLE001 - see _fail
            self._fail(error)

    def _act(self) -> None:
        """Send the command for the state of this tick, unless the tick has failed before."""
        state = self.state
        run = self._run
        if state is None or (run is not None and run.done()):
            return
        try:
            self._a = ZERO_ACCELERATION
            self._send(self._command(state, self._ticked_ns / NS_PER_SECOND))
            if self._flown is not None:
                self.port.publish(DRONE_TOPICS.reference, self._flown)
        except BaseException as error:  # noqa: BLE001 - see _fail
            self._fail(error)

    def _send(self, command: Command | None) -> None:
        """Send a command to the drone. None lets the drone continue as it does."""
        if command is None:
            return
        self.link.send(command)
        if self._models:
            self.filter.commanded = command.flat
        self.port.publish(DRONE_TOPICS.command, command)

    # What guidance asks -------------------------------------------------------------------------

    def take_off(self, height: float | None = None) -> float:
        """Rise to `height` m above the ground, inside the fence, and return the time it will take.

        Only a drone on the ground takes off. It stays there while it is held and during an
        emergency stop. After its motors were cut, or a latched rule of the safety table has acted,
        it stays there until its agent is started again. Returns 0 then.
        """
        rule, why = self.unready()
        if height is not None and not math.isfinite(height):
            rule = "rise"
            why = f"a take-off to {height} m: not flown"
        if why:
            self._say(rule, why)
            return 0.0
        if get_refusal(self.mode, ModeEvent.TAKE_OFF) or self.state is None:
            return 0.0
        if not self._takes_off:
            self.mode = HOVER_MODE
            return 0.0
        goal = self.above(height)
        start = FullState.at(self.state.p, yaw=yaw_of(self.state.q))
        duration = self.flights.go_to(start, goal, start.yaw, 0.0, self.clock.now())
        self._flown = start
        self._beyond = False
        self._lift_off, self._rises_at = (
            self.state.p[2] + LIFT_OFF_LIMITS.height,
            self.clock.now(),
        )
        if self.started_at is None:
            self.started_at = start.p
        self.guard.forget()
        self._change(ModeEvent.TAKE_OFF)
        return duration

    def unready(self) -> tuple[str, str]:
        """Return the rule that forbids a take-off now, and its text; both empty if none does."""
        if self.port.bus.stopped:
            return (
                "stop",
                "emergency stop in force: no take-off until `crazychoir stop --clear`",
            )
        if why := self.cut_for or self.guard.latched:
            return "again", f"{why}: no take-off until its agent is started again"
        if problems := self.unfit():
            return "unfit", f"{'; '.join(problems)}: no take-off"
        return (
            ("held", f"{HELD_TEXT}: no take-off until it is let go")
            if self.held
            else ("", "")
        )

    def above(self, height: float | None) -> Vec:
        """Return (3,) m where a take-off from here to `height` m above the ground ends.

        A robot that does not take off stays where it is.
        """
        assert self.state is not None  # noqa: S101 - callers have looked
        goal = self.state.p.copy()
        if self._takes_off:
            goal[2] = self.limits.ground + (
                self.limits.takeoff_height if height is None else height
            )
            goal[2] = self.fence.nearest(goal)[2]
        return goal

    def gap(self, p: Point) -> float:
        """Return the distance in m from p, (3,) m; horizontal for a robot that drives."""
        assert self.state is not None  # noqa: S101 - callers have looked
        away = self.state.p - np.asarray(p)
        return float(np.linalg.norm(away[0:2] if self._planar else away))

    def go_to(
        self,
        p: Point,
        yaw: float | None = None,
        duration: float = 0.0,
        commanded: bool = False,
    ) -> float:
        """Fly to p inside the fence, and return the time it will take.

        Returns 0 if the drone may not fly now: it is not in the air, is held, waits for its
        operator's start, or brakes because the safety table says so. A missing reference is no
        obstacle, because this flight needs none.

        p: (3,) m, world
        yaw: rad, None to keep the present yaw
        duration: s; the flight takes longer if the limits demand it
        commanded: True if the operator wants the flight. The operator may fly the drone when
            guidance may not, see `steerable`.
        """
        if not self._may_fly(commanded):
            return 0.0
        start = self._departure()
        now = self.clock.now()
        wanted = np.asarray(p, dtype=float)
        goal = self.guard.room.nearest(wanted, inset=0.0)
        if self._planar:
            wanted = np.array([*wanted[0:2], start.p[2]])
            goal = np.array([*goal[0:2], start.p[2]])
            seconds = self.flights.drive_to(
                start, goal, start.yaw if yaw is None else yaw, duration, now
            )
        else:
            seconds = self.flights.go_to(
                start, goal, start.yaw if yaw is None else yaw, duration, now
            )
        self._flown = start
        self._reference = None
        self._obeyed = NOMINAL_ACTION
        self._change(ModeEvent.FLY)
        self._beyond = bool(np.abs(wanted - goal).max() > 2.0 * EDGE_MARGIN)
        if self._beyond:
            self._say(
                "goal",
                f"{wanted.round(2).tolist()} is outside the fence: flies to {goal.round(2).tolist()}",
            )
        return seconds

    def fly(self, trajectory: Trajectory, commanded: bool = False) -> float:
        """Fly a trajectory from its beginning, now, and hover at its end.

        The caller has checked that the trajectory begins where the drone is and stays inside the
        fence and within the limits.

        commanded: as in `go_to`
        Returns the duration in s; 0 if the drone may not fly now, for the reasons of `go_to`.
        """
        if not self._may_fly(commanded):
            return 0.0
        self._flown = trajectory.sample(0.0)
        self._reference = None
        self._obeyed = NOMINAL_ACTION
        self._beyond = False
        self._change(ModeEvent.FLY)
        return self.flights.fly(trajectory, self.clock.now())

    def require_goal(
        self, where: str, p: object, yaw: object = None, duration: object = 0.0
    ) -> Vec:
        """Return the goal p as (3,) m.

        Raises ConfigError for a goal where the drone must not fly, see goals.require_goal.
        """
        homes = [home for home in (self._home, self.started_at) if home is not None]
        return require_goal(where, p, yaw, duration, self.guard, self._planar, homes)

    def _may_fly(self, commanded: bool) -> bool:
        """Return whether a flight may begin now.

        From a command of the operator until a hold, the flight counts as the operator's, even if it
        cannot begin yet.
        """
        if not (self.steerable if commanded else self.obeys):
            return False
        self.commanded = commanded
        self.guard.excuse("reference")
        return not self.guard.acts

    def follow(self, reference: Reference) -> bool:
        """Fly this reference from the next tick on; return False if it can never be flown.

        The reference must be renewed before it is stale. Its numbers are converted here, once, see
        `convert_reference`. An object that is not a reference, has another shape or is not finite is
        not flown, and neither is a Goto to a place where no goal may be. A reference that asks for
        more than [flight] allows is cut, see ReferenceLimits. A repeated Goto continues its flight.
        A held drone ignores references.
        """
        state = self.state
        if state is None or not self.obeys:
            return True
        wanted = convert_reference(reference)
        if wanted is None:
            self._say("reference", f"{explain_refusal(reference)}: not flown")
            return False
        if why := self._forbids(wanted):
            self._say("sender", why)
            return False
        if isinstance(wanted, Acceleration):
            wanted = (
                self.reference_limits.acceleration(wanted, state, self.filter.speed)
                or wanted
            )
        if isinstance(wanted, Goto):
            self._fly_goto(wanted)
        else:
            self._reference = wanted
            self._reference_ns = self.clock.now_ns()
            self._beyond = False
            if self.mode is not FOLLOW_MODE:
                self._change(ModeEvent.FLY)
        return True

    def unflown(self, reference: object) -> str:
        """Return why a reference can never be flown: its numbers, its place or its kind.

        Returns an empty text if it can be flown.
        """
        wanted = convert_reference(reference)
        return explain_refusal(reference) if wanted is None else self._forbids(wanted)

    def _forbids(self, reference: Reference) -> str:
        """Return why this drone never flies a valid reference: its place or its kind; else ""."""
        if isinstance(reference, Goto):
            try:
                self.require_goal("Goto", reference.p)
            except ConfigError as error:
                return str(error)
        if isinstance(reference, Acceleration) and self.controls.follower is None:
            do = "Send fpqr or frpy" if self._takes_off else "Return a Velocity"
            return f"an Acceleration cannot be sent as {self.controls.sender.kind}: not flown. {do}"
        return ""

    def _fly_goto(self, wanted: Goto) -> None:
        """Begin the flight of a Goto, unless it has begun.

        A law may return the same Goto in each step.
        """
        asked = (
            *np.asarray(wanted.p, dtype=float).tolist(),
            wanted.yaw,
            wanted.duration,
        )
        plan = self.flights.plan
        begun = self._reference is None and plan is self._goto_plan and plan is not None
        if begun and asked == self._goto:
            return
        if self.go_to(wanted.p, wanted.yaw, wanted.duration):
            self._goto = asked
            self._goto_plan = self.flights.plan

    def hover(self) -> None:
        """Come to rest in the shortest distance that the limits allow, and stay there.

        A drone at rest stays where it is. A flight that its operator has commanded goes on.
        """
        if self.mode in GUIDED_MODES and not self.commanded:
            self._rest()

    def _rest(self) -> None:
        """Come to rest and hover, unless the drone already does."""
        # Called in each step, it would begin anew each time, and never come to rest.
        stops = self.flights.plan is self._stops
        if self._reference is not None or (self.remaining() > 0.0 and not stops):
            self._brake()
        self._reference = None
        self._change(ModeEvent.HOLD)

    def land(self, reason: str = "", grave: bool = False) -> float:
        """Come to rest, then fly straight down inside the fence, and stop the motors.

        reason: empty if guidance wants the landing; a held or returning drone then does not land
        grave: whether the reason needs attention
        Returns s until the motors stop, 0 if the drone does not begin to land.
        """
        if (
            self.mode in (*MOTORS_OFF_MODES, LAND_MODE)
            or self.state is None
            or (not reason and (self.held or self.mode is RETURN_MODE))
        ):
            return 0.0
        if reason:
            self._say("land", reason, grave)
        return self._descend()

    def misjudged(self) -> str:
        """Return what is wrong with the hover thrust that a drone behind a radio has learnt.

        Returns an empty text if it is right.
        """
        factor = self.controls.trim.thrust
        if (
            not self._reached
            or self.controls.sender.kind not in THRUST_SENDERS
            or abs(factor - 1.0) <= LARGEST_THRUST_ERROR
        ):
            return ""
        low = 1.0 - LARGEST_THRUST_ERROR
        high = 1.0 + LARGEST_THRUST_ERROR
        return (
            f"hovers with {factor:.2f} times the thrust that its platform and firmware are known for, {low:g} to "
            f"{high:g} are allowed: look at platform, thrust_map, propellers and battery"
        )

    def take_over(self) -> None:
        """Land a drone that others fly from where it is first seen.

        Until then it gets no commands.
        """
        self._takes_over = True

    def _found(self) -> None:
        """Land from where the drone is seen, in the air, where others have flown it."""
        self._takes_over = False
        if self.mode is GROUND_MODE:
            self._change(ModeEvent.FOUND)
            self.land("found in the air, where others have flown it: landing")
        elif self.mode is LAND_MODE:
            self.flights.clear()
            self._descend()

    def cut(self, reason: str) -> None:
        """Stop the motors, for good."""
        self._change(ModeEvent.STOP)
        self.cut_for = self.cut_for or reason
        self.link.cut()
        self._say("cut", reason, grave=True)

    def guidance_failed(self, reason: str) -> None:
        """Hover, then land, because guidance is gone; a drone on the ground stays there.

        This holds for a flight that the operator has commanded too.
        """
        if not self.airborne:
            self._say(
                "guidance",
                f"guidance failed ({reason}): stays on the ground",
                grave=True,
            )
            return
        self._say(
            "guidance",
            f"guidance failed ({reason}): hovering, then landing",
            grave=True,
        )
        self.unguided = reason
        self.commanded = False
        self.hover()
        due_ns = self.clock.now_ns() + round(GIVE_UP_HOVER * NS_PER_SECOND)
        self.clock.call_at(
            due_ns, self.land, f"guidance failed ({reason}): landing", drone=self.drone
        )

    def remaining(self) -> float:
        """Return s until the planned flight is over.

        Returns 0 for a landing that may begin anew again and again.
        """
        if self.mode is LAND_MODE and self.unreached:
            return 0.0
        return self.flights.remaining(self.clock.now())

    @property
    def airborne(self) -> bool:
        """Whether the motors may be running."""
        return self.mode not in MOTORS_OFF_MODES

    @property
    def obeys(self) -> bool:
        """Whether guidance moves the drone: in the air, not held, not waiting for its operator."""
        return self.mode in GUIDED_MODES and not (self.held or self.awaits_start)

    @property
    def steerable(self) -> bool:
        """Whether the operator may fly the drone: it is in the air, and its mission waits.

        A mission waits while the drone is held, and before the operator has started the mission.
        After guidance has failed, the operator cannot fly the drone.
        """
        return (
            self.mode in (HOVER_MODE, FOLLOW_MODE)
            and (self.held or self.awaits_start)
            and not self.unguided
        )

    # What its operator commands -----------------------------------------------------------------

    def refuses(self, command: ModeEvent) -> str:
        """Return why the drone cannot do what its operator commands, in this mode.

        Returns an empty text if it can.
        """
        return get_refusal(self.mode, command)

    def start(self) -> None:
        """Let the mission fly the drone."""
        self.awaits_start = self.commanded = False

    def hold(self, on: bool = True) -> None:
        """Keep the drone where it is, whatever guidance wants, or let it go on.

        A landing drone cannot be held.
        """
        if self.refuses(ModeEvent.HOLD if on else ModeEvent.GO):
            return
        self.held = on
        self.commanded = False
        if on and self.airborne:
            self._rest()
        elif not on and self.mode is HOVER_MODE and self._way is not None:
            self._change(ModeEvent.HOME)

    def go_home(self, home: Point, level: float) -> None:
        """Rise to `level` m, fly home at that height, and land there.

        home: (3,) m, world: home if the drone has not taken off; else it lands where it took off
            first
        level: m, height of the flight
        """
        if self.refuses(ModeEvent.HOME) or self.state is None:
            return
        inside = self.guard.room.nearest(
            np.array([*self.state.p[:2], level]), inset=0.0
        )
        self._way = Homecoming(
            inside, home if self.started_at is None else self.started_at, inside[2]
        )
        self.held = False
        self.commanded = False
        self._reference = None
        self._brake()
        self._change(ModeEvent.HOME)

    def _go_on_home(self, state: State, now: float) -> None:
        """Begin the next leg of the way home.

        Land at the end of the way, or where the drone makes no progress.
        """
        way = self._way
        leg = None if way is None else way.leg(state.p)
        if leg is None:
            self.land(
                "does not get home: lands where it is"
                if way is not None and way.stuck
                else "home: landing"
            )
            return
        start = self._departure()
        self._flown = start
        self.flights.go_to(
            start, self.guard.room.nearest(leg, inset=0.0), start.yaw, 0.0, now
        )

    def _change(self, event: ModeEvent) -> None:
        """Change the mode as the table of modes says for this event."""
        self.mode = get_next_mode(self.mode, event)

    # The chain ----------------------------------------------------------------------------------

    def _command(self, state: State, now: float) -> Command | None:
        """Return the command of this tick; None lets the drone continue as it does."""
        if self._takes_over and state.age <= SEEN_AGE:
            self._found()
        mode = self.mode
        if mode in MOTORS_OFF_MODES:
            self.clearance.rest(now)
            return None if self._takes_over and mode is GROUND_MODE else self._idle
        if self.unheard():
            self.guard.bear_unseen(state.age + TOUCHDOWN_LIMITS.overdue_time)
        if self._reference is not None:
            verdict = self.guard.check(
                now,
                state,
                state.age,
                (self._ticked_ns - self._reference_ns) / NS_PER_SECOND,
            )
        else:
            verdict = self.guard.check(now, state, state.age, None, mode in LOW_MODES)
        if verdict.action is not NOMINAL_ACTION or self._obeyed is not NOMINAL_ACTION:
            self._obey(verdict)
            if not self.airborne:
                return self._idle
        if self.mode is TAKEOFF_MODE and self._reached:
            self.guard.tell("body", float(self._stays_down(state, now)))
        if self._reached and self._down_at == math.inf and (why := self.astray()):
            falls = (
                state.flat[2]
                < self._lift_off - LIFT_OFF_LIMITS.height + STRAY_BODY_LIMITS.cut_height
                or self.controls.sender.kind not in THRUST_SENDERS
            )
            self.guard.tell("astray", 2.0 if falls else LANDS_ASTRAY, why)
        if (
            self._reached
            and self.mode is LAND_MODE
            and (
                state.age > FIRMWARE_LANDING.pose_timeout
                or self.guard.told("astray") == LANDS_ASTRAY
            )
        ):
            self._hand_over()
        if self._reached and self._fallen(state, now):
            silent = self.guard.told("link")
            why = (
                f"its radio is silent for {silent:.2f} s, and it is "
                if silent > STRAY_BODY_LIMITS.silence
                else ""
            )
            self._give_up(f"{why}seen on the floor, where it should fly: landing")
        if self._held_at_fence(verdict, now):
            self.at_fence += 1
        if self.mode is not LAND_MODE and self.clearance.deaf(now):
            self._give_up(CUT_OFF_TEXT)
        if self.mode is not LAND_MODE and self.clearance.gives_up:
            self._give_up(f"{self.clearance.silent}: landing")
        if (
            self.mode is RETURN_MODE
            and self._obeyed is NOMINAL_ACTION
            and self.flights.done(now)
        ):
            self._go_on_home(state, now)
        if self.mode is LAND_MODE and self._is_down(state, now):
            self._landed()
            return self._idle
        if self._down_at < math.inf:
            self._tell_owner(now)
            return None
        if self._takes_over:
            return None
        if self.unreached and self.mode is LAND_MODE:
            return self._land_unheard(state, now)
        return self._follow(state, now)

    def _stays_down(self, state: State, now: float) -> bool:
        """Return whether the body that the cameras take for the drone fails to rise at a take-off.

        It must stand on the floor for some time while the plan is in the air.
        """
        plan = self.flights.sample(now)
        flown = self._flown
        floor = self._lift_off - LIFT_OFF_LIMITS.height
        # Others kept it down in the last tick.
        kept_down = self.clearance.aside and flown is not None and flown.a[2] <= 0.0
        low = plan is None or plan.p[2] - floor <= LIFT_OFF_LIMITS.plan_height
        if low or kept_down or state.flat[2] >= self._lift_off or not self.turning():
            self._rises_at = now
        return now - self._rises_at > (
            LIFT_OFF_LIMITS.thrust_time
            if self.controls.sender.kind in THRUST_SENDERS
            else LIFT_OFF_LIMITS.on_board_time
        )

    def _fallen(self, state: State, now: float) -> bool:
        """Return whether the drone has come down by itself and pushes against the floor."""
        up = (
            state.age > SEEN_AGE
            or state.flat[2] > self.limits.ground + TOUCHDOWN_LIMITS.floor_height
        )
        if up or self.mode not in GUIDED_MODES or self.mode is TAKEOFF_MODE:
            self._up_at = now
        return now - self._up_at > STRAY_BODY_LIMITS.on_floor_time

    def _held_at_fence(self, verdict: SafetyVerdict, now: float) -> bool:
        """Return whether the fence keeps the drone from where guidance wants it.

        Either the safety table keeps it inside, or a flight to a place outside has ended at the
        fence.
        """
        if self.mode not in GUIDED_MODES or self.held:
            return False
        return verdict.measure == "stop" or (self._beyond and self.flights.done(now))

    def _give_up(self, reason: str) -> None:
        """Land, whatever the mission wants."""
        if self.land(reason, grave=True) > 0.0:
            self.brought_down = self.brought_down or reason

    @property
    def unreached(self) -> bool:
        """Whether the drone flies on without commands.

        Its planner is on board, and its radio is silent.
        """
        return (
            self._reached
            and self.controls.sender.kind == "xyz"
            and self.guard.told("link") > FIRMWARE_LANDING.radio_timeout
        )

    def _land_unheard(self, state: State, now: float) -> Command | None:
        """Return the command to land for a drone that may not receive it.

        The landing begins anew from where the drone is seen, as soon as the plan leaves it behind.
        """
        planned = self.flights.sample(now)
        if (
            planned is None
            or np.linalg.norm(planned.p - state.p)
            > TOUCHDOWN_LIMITS.replanning_distance
        ):
            start = FullState.at(state.p, state.v, yaw=yaw_of(state.q))
            self.flights.descend(
                start, now, self.limits.ground + TOUCHDOWN_LIMITS.floor_height
            )
            planned = self.flights.sample(now)
        self._flown = planned
        return self._commanded(self.controls.tracker, state, planned, now)

    def _is_down(self, state: State, now: float) -> bool:
        """Return whether the drone has landed.

        It is low enough, or its descent is over and it no longer moves, whatever height cameras and
        floor suggest. A height that is only predicted does not count: it may be wrong by a fall
        that breaks the drone.
        """
        seen = state.age <= SEEN_AGE
        if (
            self.unreached
            and seen
            and state.flat[2] > self.limits.ground + TOUCHDOWN_LIMITS.airborne_height
        ):
            return False
        if now > self._down_at:
            return (
                not self.turning()
                or now > self._down_at + FIRMWARE_LANDING.motor_timeout
            )
        if not self._takes_off:
            return self.flights.done(now) and bool(
                np.linalg.norm(state.v) < TOUCHDOWN_LIMITS.rest_speed
            )
        if now > self._replay_lands_at:
            up = state.flat[2] - self.limits.ground
            self._say(
                "replay",
                f"{REPLAY_TEXT}: its landing ends {up:.2f} m above the ground",
            )
            return True
        low = (
            seen and state.flat[2] < self.limits.ground + TOUCHDOWN_LIMITS.floor_height
        )
        landing = isinstance(self.flights.plan, Landing)
        # Its owner has seen it land, or does not come back.
        if not seen and (self.turning() or self.unheard()):
            return not self.turning()
        late = (
            TOUCHDOWN_LIMITS.overdue_time
            if seen
            else TOUCHDOWN_LIMITS.unseen_overdue_time
        )
        over = (
            landing
            and self.flights.done(now, late)
            and now > self.clearance.gave_way + late
        )
        # A delayed drone waits until it may go down.
        planned = self.clearance.planned
        over = over and not (planned is not None and planned.delayed)
        return bool(
            low or (over and np.linalg.norm(state.v) < TOUCHDOWN_LIMITS.rest_speed)
        )

    def _follow(self, state: State, now: float) -> Command | None:
        """Return the command that flies the reference of guidance, or the plan."""
        chosen = self.controls
        flights = self.flights
        if self.mode is FOLLOW_MODE and self._obeyed is NOMINAL_ACTION:
            reference = self._reference
            if isinstance(reference, Acceleration) and chosen.follower is not None:
                self._flown = None
                flights.plan = None
                if (safe := self._kept_clear(state, reference, now)) is not None:
                    return self._evade(state, safe, reference.yaw, now)
                return self._commanded(chosen.follower, state, reference, now)
            if isinstance(reference, Velocity):
                reference = FullState.at(state.p, reference.v, yaw=reference.yaw)
            if isinstance(reference, FullState):
                wanted = self.reference_limits.full_state(reference, state)
                flights.plan = None
                self._flown = self.clearance.agreed(
                    state, wanted, partial(extrapolate_reference, reference), 0.0, now
                )
                self._say_delayed()
                if (safe := self._kept_clear(state, self._flown, now)) is not None:
                    return self._evade(state, safe, self._flown.yaw, now)
                chosen.trim.frozen = (
                    self._flown is not reference or state.age > SEEN_AGE
                )
                return self._commanded(chosen.tracker, state, self._flown, now)
        if flights.plan is None:
            self._brake()
        planned = flights.sample(now)
        assert planned is not None  # noqa: S101 - there is a plan
        self._flown = flown = self._flown_of(state, planned, now)
        if (
            self.mode in (TAKEOFF_MODE, FOLLOW_MODE)
            and self._reference is None
            and flights.done(now)
        ):
            self._change(ModeEvent.ARRIVED)
        if (safe := self._kept_clear(state, flown, now)) is not None:
            self.clearance.aside = True
            return self._evade(state, safe, flown.yaw, now)
        low = self.mode is TAKEOFF_MODE and state.flat[2] < self._lift_off
        chosen.trim.frozen = low or state.age > SEEN_AGE or flown is not planned
        return self._commanded(chosen.tracker, state, self._flown, now)

    def _flown_of(self, state: State, planned: FullState, now: float) -> FullState:
        """Return the part of the plan to fly now, adjusted for other drones.

        After an evasion the drone returns to its plan within the limits.
        """
        clearance = self.clearance
        if clearance.planned is not None:
            lands = self.mode is LAND_MODE
            if lands:
                planned = self._down_elsewhere(clearance.planned, planned, now)
            flown = clearance.planned_flight(
                clearance.planned,
                state,
                planned,
                now,
                lands,
                self._obeyed is Action.LAND,
            )
            self._say_delayed()
            return flown
        # A drone that brakes, for example at the fence, must not drift.
        if not clearance.aside or self._obeyed is Action.BRAKE:
            return planned
        if clearance.astray(state, planned, now):
            planned = self._come_back(state, planned, now)
        return self.reference_limits.full_state(planned, state)

    def _down_elsewhere(
        self, planner: PlannedFlights, planned: FullState, now: float
    ) -> FullState:
        """Return the reference of a landing drone that the others may keep up.

        It lands beside drones that keep it up for too long, or where it is if no other drone
        answers.
        """
        beside = self.clearance.lands_beside(planned.p, now)
        if beside is not None:
            self._say(
                "beside",
                f"cannot come down for drone {self.clearance.delayed_by}: lands beside",
            )
        elif not self.clearance.begins_landing_anew(planner, planned, now):
            return planned
        self._descend(beside)
        return self.flights.sample(now) or planned

    def _come_back(self, state: State, planned: FullState, now: float) -> FullState:
        """Return the reference of a drone that was pushed far off its plan.

        A landing drone lands where it is.
        """
        flights = self.flights
        if self.mode is LAND_MODE:
            flights.clear()
            self._descend()
            return flights.sample(now) or planned
        same = flights.plan is self._goto_plan
        wanted = self.clearance.awaited(state, planned, now)
        if same:
            self._goto_plan = flights.plan
        return wanted

    def _say_delayed(self) -> None:
        """Say which drone this one waits for."""
        other = self.clearance.delayed_by
        if silent := self.clearance.silent:
            self._say("silent", silent)
        elif other is not None:
            self._say("collision", f"keeps clear of drone {other}")

    def _kept_clear(
        self, state: State, reference: Acceleration | FullState, now: float
    ) -> Vec | None:
        """Return the acceleration, (3,) m/s2, that avoids the others.

        Returns None if nothing is in the way.
        """
        safe = self.clearance.evasion(
            state,
            reference,
            self.reference_limits.gains,
            now,
            lands=self.mode is LAND_MODE,
        )
        if safe is None and self.note == self._evades:
            self.note = ""
            self.grave = False
        return safe

    def _evade(self, state: State, a: Vec, yaw: float, now: float) -> Command | None:
        """Return the command that flies the acceleration a, (3,) m/s2, of the collision filter."""
        assert self.clearance.filter is not None  # noqa: S101 - the filter has acted
        # If the safety table acts, it has already given the reason.
        if self._obeyed is NOMINAL_ACTION:
            self._say_evades(self.clearance.filter.gives_way_to)
        self.controls.trim.frozen = True
        self._flown = FullState(
            np.array([*state.flat[0:6], *a, 0.0, 0.0, 0.0, yaw, 0.0])
        )
        return self._commanded(self.controls.tracker, state, self._flown, now)

    def _say_evades(self, other: int | None) -> None:
        """Say which drone this one evades; None if it brakes because others are not heard."""
        if other is None:
            self._say("collision", "braking: drones nearby are not heard")
        else:
            self.note = f"keeps clear of drone {other}"
            self.grave = False
            if self.clearance.ticks == 1:
                log.info("drone %d: %s", self.drone, self.note)
        self._evades = self.note

    def _commanded(
        self,
        controller: CrazyflieController,
        state: State,
        reference: Reference | None,
        now: float,
    ) -> Command | None:
        """Return the command of the controller, and keep its acceleration for the next state."""
        command = controller.command(state, reference, now)
        self._a = controller.acceleration
        return command

    def _obey(self, verdict: SafetyVerdict) -> None:
        """Act on a verdict of the safety table when its action changes."""
        if verdict.action is not Action.NOMINAL:
            self._say(
                f"{verdict.action.name} {verdict.measure}",
                verdict.reason,
                verdict.action >= Action.LAND,
            )
        if verdict.action is self._obeyed:
            return
        self._obeyed = verdict.action
        self.braked += verdict.action is Action.BRAKE
        if verdict.action is Action.CUT:
            self.cut(verdict.reason)
        elif verdict.action is Action.LAND:
            self._give_up(verdict.reason)
        elif verdict.action is Action.BRAKE and self.mode is not LAND_MODE:
            self._brake()

    def _hand_over(self) -> None:
        """Let the firmware land the drone by its own sensors.

        The landing is soon, because the sensors drift, and ends a little below the floor.
        """
        if self._down_at < math.inf or self.state is None:
            return
        depth = float(self.state.p[2]) - self.limits.ground + FIRMWARE_LANDING.depth
        seconds = max(depth / FIRMWARE_LANDING.speed, 1.0)
        self._down_at = self.clock.now() + seconds
        self.guard.bear_unseen(self.state.age + seconds + TOUCHDOWN_LIMITS.overdue_time)
        floor = self.limits.ground - FIRMWARE_LANDING.depth
        self._to_firmware = XYZ(
            "land", np.array([0.0, 0.0, floor, yaw_of(self.state.q), seconds])
        )
        self._tell_owner(self.clock.now())

    def _tell_owner(self, now: float) -> None:
        """Repeat the command to land by the firmware; the owner takes a silent agent for gone."""
        if self._to_firmware is not None and now >= self._tell_owner_at:
            self._tell_owner_at = now + FIRMWARE_LANDING.command_interval
            self.link.send(self._to_firmware)

    def _brake(self) -> None:
        """Plan to come to rest."""
        self._flown = start = self._departure()
        self.flights.brake(start, self.clock.now())
        self._stops = self.flights.plan

    def _descend(self, beside: Vec | None = None) -> float:
        """Land from here, or over `beside`, and return s until the motors stop.

        What the controllers learn meanwhile may come from a floor that the drone pushes against, so
        the trim of now is kept.

        beside: (3,) m, world: where the drone comes down instead
        """
        begins = self.mode is not LAND_MODE
        if begins:
            self.controls.trim.keep()
        self._flown = start = self._departure()
        self._reference = None
        self._way = None
        self.commanded = False
        self._change(ModeEvent.ARRIVED if self.mode is RETURN_MODE else ModeEvent.LAND)
        if not self._takes_off:
            return self.flights.brake(start, self.clock.now())
        seconds = self.flights.descend(
            start,
            self.clock.now(),
            self.limits.ground + TOUCHDOWN_LIMITS.floor_height,
            beside,
        )
        if begins and self.is_replayed:
            self._replay_lands_at = (
                self.clock.now() + seconds + TOUCHDOWN_LIMITS.replay_overdue_time
            )
        return seconds

    def _departure(self) -> FullState:
        """Return the state from which a new plan begins."""
        assert self.state is not None  # noqa: S101 - callers fly, and a flying drone has a state
        # Its plan says where it should be, not where it is.
        if self._planar or self.clearance.aside:
            return FullState.at(self.state.p, self.state.v, yaw=yaw_of(self.state.q))
        planned = self.clearance.planned
        if planned is not None and self._flown is not None:
            elsewhere = planned.departure(self._flown.yaw, self.clock.now())
            if elsewhere is not None:
                return elsewhere
        return self.flights.departure(self.state, self.clock.now())

    def _landed(self) -> None:
        """Enter the mode on the ground, and forget the flight."""
        self._change(ModeEvent.DOWN)
        self._down_at = self._replay_lands_at = math.inf
        self._to_firmware = None
        self._tell_owner_at = 0.0
        self._flown = None
        self.flights.clear()
        self.controls.trim.frozen = True
        self.controls.trim.restore()
        self._obeyed = Action.NOMINAL
        self.guard.forget()
        if self.braked > 1:
            text = f"the safety table has braked it {self.braked} times in this flight"
            self._say("braked", text)
            self.port.publish(DRONE_TOPICS.log, f"drone {self.drone}: {text}")
        self.braked = 0

    def _say(self, topic: str, text: str, grave: bool = False) -> None:
        """Keep a note for the status, and log it, at most now and then."""
        # Errors name their drone, and so does the log line.
        text = text.removeprefix(f"drone {self.drone}: ")
        self.note = text
        self.grave = grave
        if self._said.due(self.clock.now(), topic) and self._said.due(
            self.clock.now(), text
        ):
            log.warning("drone %d: %s", self.drone, text)
