"""Watches a drone near the floor: whether it lifts off, stays up, and hovers with the right thrust."""

import math
from dataclasses import dataclass

from crazychoir.flight.batch import DroneRow
from crazychoir.flight.body import DroneBody
from crazychoir.flight.flight_limits import SEEN_AGE, TOUCHDOWN_LIMITS
from crazychoir.flight.notes import FlightNotes
from crazychoir.flight.point_flights import PointFlights
from crazychoir.flight.setup import FlightSetup
from crazychoir.safety.identity.pose_gate import PoseGate
from crazychoir.safety.rules.guard import Guard
from crazychoir.safety.rules.modes import GUIDED_MODES, TAKEOFF_MODE
from crazychoir.types import Pose, State


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
FALLS_ASTRAY = 2.0
"""Value of the measure "astray" of a drone that must stop its motors."""


class GroundWatch:
    """Tells the guard of one drone what cameras and radio say against its flight.

    The drone does not lift off, has come down by itself, or is seen where it cannot be.

    setup: of the drone
    row: of the drone in its batch
    body: of the drone
    guard: of the drone
    notes: of the drone
    """

    def __init__(
        self,
        setup: FlightSetup,
        row: DroneRow,
        body: DroneBody,
        guard: Guard,
        notes: FlightNotes,
    ) -> None:
        self._setup = setup
        self._row = row
        self._body = body
        self._guard = guard
        self._notes = notes
        self._gate = PoseGate() if setup.reach == "seen" else None
        # Time in s when it was last off the floor, or had no reason to be in the air.
        self._rises_at = 0.0
        self._outside_at = math.inf  # s, since when its body is seen outside
        self._outside_seen = -math.inf  # s, when a pose was last judged
        self._up_at = math.inf  # s, when it was last not seen on the floor

    def begin_take_off(self, z: float, now: float) -> None:
        """Watch whether the drone lifts off from the height z, m, after the time `now` in s."""
        self._row.drone["lift_off_height"] = z + LIFT_OFF_LIMITS.height
        self._rises_at = now

    def believe(self, pose: Pose, now: float, is_flying: bool) -> Pose | None:
        """Return the pose, or None if it cannot be the pose of this drone.

        now: s
        is_flying: whether the drone may be in the air
        """
        if self._gate is None:
            return pose
        is_believed = self._gate.believes(pose, now, is_flying)
        beyond = self._guard.beyond(pose.p)
        if is_believed or not beyond > 0.0:
            self._outside_at = math.inf
        elif self._outside_at == math.inf or now - self._outside_seen > SEEN_AGE:
            self._outside_at = now
        self._outside_seen = now
        if is_believed:
            return pose
        if now - self._outside_at > STRAY_BODY_LIMITS.outside_time:
            self._guard.tell("gone", beyond)
        self._notes.say(
            "jump",
            "the pose has jumped: another body, or a mistake of the cameras: not believed",
        )
        return None

    def watch_lift_off(self, state: State, flights: PointFlights, now: float) -> None:
        """Tell the guard whether the body fails to rise at a take-off.

        It must stand on the floor for some time while the plan is in the air.
        """
        row = self._row
        plan = flights.sample(now)
        flown = row.flown
        lift_off = float(row.drone["lift_off_height"])
        floor = lift_off - LIFT_OFF_LIMITS.height
        # Others kept it down in the last tick.
        kept_down = row.drone["is_aside"] and flown is not None and flown.a[2] <= 0.0
        low = plan is None or plan.p[2] - floor <= LIFT_OFF_LIMITS.plan_height
        rises = state.flat[2] >= lift_off or not self._body.is_turning()
        if low or kept_down or rises:
            self._rises_at = now
        patience = (
            LIFT_OFF_LIMITS.thrust_time
            if self._setup.sends_thrust
            else LIFT_OFF_LIMITS.on_board_time
        )
        self._guard.tell("body", float(now - self._rises_at > patience))

    def watch_motion(self, state: State) -> None:
        """Tell the guard if the body that the cameras see does not move as the drone does."""
        why = self._body.explain_astray()
        if not why:
            return
        floor = self._row.drone["lift_off_height"] - LIFT_OFF_LIMITS.height
        falls = (
            state.flat[2] < floor + STRAY_BODY_LIMITS.cut_height
            or not self._setup.sends_thrust
        )
        self._guard.tell("astray", FALLS_ASTRAY if falls else LANDS_ASTRAY, why)

    def explain_fall(self, state: State, now: float) -> str:
        """Return why a drone must land that has come down by itself and pushes against the floor.

        Returns an empty text if it flies.
        """
        mode = self._row.mode
        is_up = (
            state.age > SEEN_AGE
            or state.flat[2] > self._setup.limits.ground + TOUCHDOWN_LIMITS.floor_height
        )
        if is_up or mode not in GUIDED_MODES or mode is TAKEOFF_MODE:
            self._up_at = now
        if now - self._up_at <= STRAY_BODY_LIMITS.on_floor_time:
            return ""
        silent = self._guard.told("link")
        why = (
            f"its radio is silent for {silent:.2f} s, and it is "
            if silent > STRAY_BODY_LIMITS.silence
            else ""
        )
        return f"{why}seen on the floor, where it should fly: landing"

    def explain_wrong_thrust(self) -> str:
        """Return what is wrong with the hover thrust that a drone behind a radio has learnt.

        Returns an empty text if it is right.
        """
        factor = self._setup.controls.trim.thrust
        if (
            not self._setup.has_radio
            or not self._setup.sends_thrust
            or abs(factor - 1.0) <= LARGEST_THRUST_ERROR
        ):
            return ""
        low = 1.0 - LARGEST_THRUST_ERROR
        high = 1.0 + LARGEST_THRUST_ERROR
        return (
            f"hovers with {factor:.2f} times the thrust that its platform and firmware are known for, {low:g} to "
            f"{high:g} are allowed: look at platform, thrust_map, propellers and battery"
        )
