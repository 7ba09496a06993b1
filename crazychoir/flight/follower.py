"""What one drone flies: the reference of its guidance, or a flight that the pilot has planned."""

import math
from typing import Any

import numpy as np

from crazychoir.control.parameters import ControllerParameters
from crazychoir.errors import ConfigError
from crazychoir.flight.agreed_flight import AgreedFlight
from crazychoir.flight.batch import Course, DroneRow
from crazychoir.flight.clearance import PLAN_DEVIATION, Clearance
from crazychoir.flight.goals import require_goal
from crazychoir.flight.homecoming import Homecoming
from crazychoir.flight.notes import FlightNotes
from crazychoir.flight.permission import Permission
from crazychoir.flight.point_flights import PointFlights
from crazychoir.flight.references import (
    convert_reference,
    explain_refusal,
)
from crazychoir.flight.setup import FlightSetup
from crazychoir.numerics.math3d import yaw_of
from crazychoir.planning.trajectory import Trajectory
from crazychoir.runtime.clock import NS_PER_SECOND
from crazychoir.safety.rules.guard import EDGE_MARGIN, Action, Guard
from crazychoir.safety.rules.limits import ReferenceLimits
from crazychoir.safety.rules.modes import (
    FOLLOW_MODE,
    LAND_MODE,
    TAKEOFF_MODE,
    ModeEvent,
)
from crazychoir.types import (
    Acceleration,
    FullState,
    Goto,
    Point,
    Reference,
    State,
    Vec,
)

RISE_DELAY = 3.0  # s
"""Longest time for which the safety table brakes a rise that goes on then."""


class FlightFollower:
    """Holds the reference and the plan of one drone, and begins new plans from where it is.

    setup: of the drone
    row: of the drone in its batch
    permission: of the drone
    guard: of the drone
    notes: of the drone
    clearance: of the drone, with its planned flights
    """

    def __init__(
        self,
        setup: FlightSetup,
        row: DroneRow,
        permission: Permission,
        guard: Guard,
        notes: FlightNotes,
        clearance: Clearance,
    ) -> None:
        self._setup = setup
        self._row = row
        self._permission = permission
        self._guard = guard
        self._notes = notes
        self.clearance = clearance
        self.flights: PointFlights = clearance.flights
        self._goto: tuple[float, ...] = ()  # the last Goto that was flown
        self._goto_plan: Trajectory | None = None  # the plan of that Goto
        self.homecoming: Homecoming | None = None
        """The way home that the operator has commanded; None without one."""
        # The plan that last brought the drone to rest.
        self._stops: Trajectory | None = None
        self.parameters = ControllerParameters(setup.controls)
        """The parameters of its controllers."""
        row.drone["has_follower"] = setup.controls.follower is not None
        self._agreed = AgreedFlight(row, notes, clearance, self.descend)
        row.drone["ground"] = setup.limits.ground
        self._take_in_gains()

    def set_parameter(self, name: str, value: Any) -> Any:
        """Change a parameter from the next tick on, and return its value.

        Raises ConfigError if it may not be changed so.
        """
        found = self.parameters.set(name, value)
        self._take_in_gains()
        return found

    def _take_in_gains(self) -> None:
        """Take in the gains of the tracker."""
        self.limits = ReferenceLimits(self._setup.limits, self._setup.controls.gains)
        self._row.drone["gains"] = self.limits.gains
        self._row.drone["limits"] = self.limits.figures
        self._row.drone["least_velocity_gain"] = self.limits.least_velocity_gain

    # What guidance and operator ask -------------------------------------------------------

    def require_goal(
        self, where: str, p: object, yaw: object = None, duration: object = 0.0
    ) -> Vec:
        """Return the goal p as (3,) m.

        Raises ConfigError for a goal where the drone must not fly, see goals.require_goal.
        """
        places = (self._setup.home, self._permission.started_at)
        homes = [home for home in places if home is not None]
        planar = self._setup.controls.planar
        return require_goal(where, p, yaw, duration, self._guard, planar, homes)

    def get_place_above(self, height: float | None) -> Vec:
        """Return (3,) m where a take-off from here to `height` m above the ground ends."""
        return self._setup.get_place_above(self._row.get_state().p, height)

    def begin_take_off(self, height: float | None, now: float, least: float) -> float:
        """Plan the rise to `height` m above the ground in at least `least` s; return its s."""
        state = self._row.get_state()
        start = FullState.at(state.p, yaw=yaw_of(state.q))
        goal = self.get_place_above(height)
        if self._permission.started_at is None:
            self._permission.started_at = state.p
        self._row.flown = start
        self._row.drone["is_beyond"] = 0
        return self.flights.go_to(start, goal, start.yaw, least, now)

    def go_to(self, p: Point, yaw: float | None, duration: float, now: float) -> float:
        """Plan a flight to p inside the fence, and return the s that it takes.

        p: (3,) m, world
        yaw: rad, None to keep the present yaw
        duration: s; the flight takes longer if the limits demand it
        now: s
        """
        start = self._get_departure(now)
        wanted = np.asarray(p, dtype=float)
        goal = self._guard.room.nearest(wanted, inset=0.0)
        turned = start.yaw if yaw is None else yaw
        if self._setup.controls.planar:
            wanted = np.array([*wanted[0:2], start.p[2]])
            goal = np.array([*goal[0:2], start.p[2]])
            seconds = self.flights.drive_to(start, goal, turned, duration, now)
        else:
            seconds = self.flights.go_to(start, goal, turned, duration, now)
        self._begin_plan(start)
        is_beyond = bool(np.abs(wanted - goal).max() > 2.0 * EDGE_MARGIN)
        self._row.drone["is_beyond"] = is_beyond
        if is_beyond:
            self._notes.say(
                "goal",
                f"{wanted.round(2).tolist()} is outside the fence: flies to {goal.round(2).tolist()}",
            )
        return seconds

    def fly(self, trajectory: Trajectory, now: float) -> float:
        """Fly a trajectory from its beginning, now, and return its duration in s."""
        self._begin_plan(trajectory.sample(0.0))
        self._row.drone["is_beyond"] = 0
        return self.flights.fly(trajectory, now)

    def fly_leg(self, goal: Vec, now: float, least: float = 0.0) -> None:
        """Plan a leg to the goal, (3,) m, in at least `least` s: of a way home, or the rest of a take-off."""
        start = self._get_departure(now)
        self._row.flown = start
        inside = self._guard.room.nearest(goal, inset=0.0)
        self.flights.go_to(start, inside, start.yaw, least, now)

    def _begin_plan(self, start: FullState) -> None:
        """Leave the reference of guidance for a plan that begins at `start`."""
        self._row.flown = start
        self._row.set_reference(None)
        self._row.obeyed = Action.NOMINAL
        self._permission.change(ModeEvent.FLY)

    def follow(self, wanted: Reference, state: State, now_ns: int) -> str:
        """Fly this reference from the next tick on; return why it is never flown, else "".

        wanted: see `convert_reference`
        state: of the drone
        """
        if why := self.forbids(wanted):
            return why
        if isinstance(wanted, Goto):
            self._fly_goto(wanted, now_ns / NS_PER_SECOND)
            return ""
        if isinstance(wanted, Acceleration):
            wanted = self.limits.acceleration(wanted, state) or wanted
        self._row.set_reference(wanted, now_ns)
        self._row.drone["is_beyond"] = 0
        if self._row.mode is not FOLLOW_MODE:
            self._permission.change(ModeEvent.FLY)
        return ""

    def explain_unflown(self, reference: object) -> str:
        """Return why a reference can never be flown: its numbers, its place or its kind.

        Returns an empty text if it can be flown.
        """
        wanted = convert_reference(reference)
        return explain_refusal(reference) if wanted is None else self.forbids(wanted)

    def forbids(self, reference: Reference) -> str:
        """Return why this drone never flies a valid reference: its place or its kind; else ""."""
        controls = self._setup.controls
        if isinstance(reference, Goto):
            try:
                self.require_goal("Goto", reference.p)
            except ConfigError as error:
                return str(error)
        if isinstance(reference, Acceleration) and controls.follower is None:
            do = "Send fpqr or frpy" if controls.takes_off else "Return a Velocity"
            return f"an Acceleration cannot be sent as {controls.sender.kind}: not flown. {do}"
        return ""

    def _fly_goto(self, wanted: Goto, now: float) -> None:
        """Begin the flight of a Goto, unless it has begun.

        A law may return the same Goto in each step.
        """
        place = np.asarray(wanted.p, dtype=float).tolist()
        asked = (*place, wanted.yaw, wanted.duration)
        plan = self.flights.plan
        has_begun = (
            not self._row.has_reference and plan is self._goto_plan and plan is not None
        )
        if has_begun and asked == self._goto:
            return
        self._guard.excuse("reference")
        self._permission.commanded = False
        if self._guard.acts:
            return
        if self.go_to(wanted.p, wanted.yaw, wanted.duration, now):
            self._goto = asked
            self._goto_plan = self.flights.plan

    def rest(self, now: float) -> None:
        """Come to rest and hover, unless the drone already does."""
        # Called in each step, it would begin anew each time, and never come to rest.
        stops = self.flights.plan is self._stops
        is_moving = self.flights.remaining(now) > 0.0
        if self._row.has_reference or (is_moving and not stops):
            self.brake(now)
        self._row.set_reference(None)
        self._permission.change(ModeEvent.HOLD)

    def brake(self, now: float) -> float:
        """Plan to come to rest, and return the s that this takes."""
        start = self._get_departure(now)
        self._row.flown = start
        seconds = self.flights.brake(start, now)
        self._stops = self.flights.plan
        return seconds

    def descend(self, now: float, beside: Vec | None = None) -> float:
        """Land from here, or over `beside`, and return s until the motors stop.

        beside: (3,) m, world: where the drone comes down instead
        """
        start = self._get_departure(now)
        self._row.flown = start
        self._row.set_reference(None)
        self.homecoming = None
        if not self._setup.controls.takes_off:
            return self.flights.brake(start, now)
        return self.flights.descend(start, now, beside)

    def forget(self) -> None:
        """Forget what the drone flies."""
        self._row.flown = None
        self._row.set_reference(None)
        self.flights.clear()

    def _get_departure(self, now: float) -> FullState:
        """Return the state from which a new plan begins."""
        state = self._row.get_state()
        # A robot that drives finds its path itself: its plan does not say where it is.
        if self._setup.controls.planar:
            return FullState.at(state.p, state.v, yaw=yaw_of(state.q))
        return self.clearance.find_departure(state, now)

    # What a tick flies --------------------------------------------------------------------

    @property
    def _flies_reference(self) -> bool:
        """Whether this tick flies the reference of guidance, not a plan."""
        row = self._row
        return (
            row.mode is FOLLOW_MODE
            and row.obeyed is Action.NOMINAL
            and row.has_reference
        )

    def prepare(self, state: State, now: float) -> None:
        """Let the stages of this tick fly the reference or the plan, and begin a plan if needed."""
        row = self._row
        row.drone["course"] = Course.FOLLOW
        if not self._flies_reference:
            self._prepare_plan(state, now)
        if self.clearance.planned is not None:
            reference = row.reference if self._flies_reference else None
            self._agreed.fly(state, reference, self.limits, now)

    def _prepare_plan(self, state: State, now: float) -> None:
        """Make sure that there is a plan, with its pieces or its set-point of now."""
        flights = self.flights
        if flights.plan is None:
            self.brake(now)
        flights.load(now)
        if flights.lacks_set_point:
            text = "the trajectory gives no finite numbers: stays where it was"
            self._notes.say("plan", text)
        row = self._row
        # A drone that brakes, for example at the fence, must not drift.
        if row.drone["is_aside"] and row.obeyed is not Action.BRAKE:
            self._come_back(state, now)
        if (
            row.mode in (TAKEOFF_MODE, FOLLOW_MODE)
            and not row.has_reference
            and not (row.mode is TAKEOFF_MODE and row.obeyed is Action.BRAKE)
            and flights.done(now)
        ):
            self._permission.change(ModeEvent.ARRIVED)

    def _come_back(self, state: State, now: float) -> None:
        """Change the plan of a drone that was pushed far off it.

        A landing drone lands where it is.
        """
        flights = self.flights
        planned = flights.sample(now)
        assert planned is not None  # noqa: S101 - there is a plan
        far = float(np.linalg.norm(planned.p - state.p))
        if self._row.mode is LAND_MODE and far > PLAN_DEVIATION.landing_distance:
            flights.clear()
            self.descend(now)
        elif far > PLAN_DEVIATION.waiting_distance:
            is_goto = flights.plan is self._goto_plan
            self.clearance.wait_for_drone(state, now)
            if is_goto:
                self._goto_plan = flights.plan
        flights.load(now)


class Rise:
    """The rise of a drone at its take-off, which goes on after the safety table has braked it.

    row: of the drone in its batch
    follower: of the drone, which plans the rise
    """

    def __init__(self, row: DroneRow, follower: FlightFollower) -> None:
        self._row = row
        self._follower = follower
        self._height = 0.0  # m, world: where it ends
        self._left = 0.0  # s that were left of it when it was braked last
        self._braked_at = math.inf  # s: when it was braked; inf while it is not
        self._braked = 0.0  # s that earlier brakes of it took

    def begin(self, height: float | None, now: float, least: float) -> float:
        """Plan the rise to `height` m above the ground in at least `least` s; return its s."""
        self._height = float(self._follower.get_place_above(height)[2])
        self._braked_at = math.inf
        self._braked = 0.0
        return self._follower.begin_take_off(height, now, least)

    def brake(self, now: float) -> None:
        """Note that the drone is about to brake."""
        self._left = self._follower.flights.remaining(now)
        self._braked_at = now

    def go_on(self, now: float) -> None:
        """Plan the rest of the rise, straight up from here."""
        self._braked = self._measure_brakes(now)
        self._braked_at = math.inf
        x, y, _ = self._row.get_state().p
        goal = np.array([x, y, self._height])
        self._follower.fly_leg(goal, now, self._left)

    def is_late(self, now: float) -> bool:
        """Return whether it was braked for too long to go on, so that it ends where the drone is."""
        return self._measure_brakes(now) >= RISE_DELAY

    def _measure_brakes(self, now: float) -> float:
        """Return the time in s that all brakes of this rise took."""
        return self._braked + max(now - self._braked_at, 0.0)
