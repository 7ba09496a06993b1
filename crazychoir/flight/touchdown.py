"""The landing of a drone: its begin, its end, and what its firmware must do alone."""

import math
from dataclasses import dataclass

import numpy as np

from crazychoir.flight.batch import DroneRow
from crazychoir.flight.body import DroneBody
from crazychoir.flight.flight_limits import SEEN_AGE, TOUCHDOWN_LIMITS
from crazychoir.flight.follower import FlightFollower
from crazychoir.flight.notes import FlightNotes
from crazychoir.flight.permission import Permission
from crazychoir.flight.setup import FlightSetup
from crazychoir.numerics.math3d import yaw_of
from crazychoir.planning.landing import STRAIGHT_DOWN, Descent, Landing
from crazychoir.safety.rules.guard import Guard
from crazychoir.safety.rules.modes import (
    LAND_MODE,
    MOTORS_OFF_MODES,
    RETURN_MODE,
    ModeEvent,
)
from crazychoir.types import XYZ, FullState, State


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

REPLAY_TEXT = "follows a recording and obeys nothing"
"""What is said of a replayed drone that does not do what its mission asks."""


class Touchdown:
    """Lands one drone, decides when it is down, and lets its firmware land it where that must be.

    setup: of the drone
    row: of the drone in its batch
    body: of the drone
    guard: of the drone
    notes: of the drone
    permission: of the drone
    follower: of the drone
    """

    def __init__(
        self,
        setup: FlightSetup,
        row: DroneRow,
        body: DroneBody,
        guard: Guard,
        notes: FlightNotes,
        permission: Permission,
        follower: FlightFollower,
    ) -> None:
        self._setup = setup
        self._row = row
        self._body = body
        self._guard = guard
        self._notes = notes
        self._permission = permission
        self._follower = follower
        self._clearance = follower.clearance
        # Time in s when the firmware has landed the drone, after it was handed over.
        self._down_at = math.inf
        self._to_firmware: XYZ | None = None  # the command for that landing
        self._tell_owner_at = 0.0
        self._replay_lands_at = math.inf  # s, when a replayed landing counts as over
        self._low_since = math.inf  # s, since when a landing drone is low but not down

    @property
    def is_handed_over(self) -> bool:
        """Whether the firmware lands the drone."""
        return self._down_at < math.inf

    @property
    def is_unreached(self) -> bool:
        """Whether the drone flies on without commands.

        Its planner is on board, and its radio is silent.
        """
        return (
            self._setup.has_radio
            and self._setup.has_planner_on_board
            and self._guard.told("link") > FIRMWARE_LANDING.radio_timeout
        )

    @property
    def _floor(self) -> float:
        """Height of the floor on which the drone lands, m, world."""
        return self._setup.limits.ground + self._follower.flights.descent.height

    def land(
        self,
        reason: str,
        is_grave: bool,
        now: float,
        descent: Descent = STRAIGHT_DOWN,
    ) -> float:
        """Come to rest, then fly straight down inside the fence, and stop the motors.

        reason: empty if guidance wants the landing; a held or returning drone then does not land
        is_grave: whether the reason needs attention
        now: s
        descent: where the way down ends, and how long it takes
        Returns s until the motors stop, 0 if the drone does not begin to land.
        """
        mode = self._row.mode
        is_unwanted = self._permission.held or mode is RETURN_MODE
        if (
            mode in (*MOTORS_OFF_MODES, LAND_MODE)
            or self._row.state is None
            or (not reason and is_unwanted)
        ):
            return 0.0
        if reason:
            self._notes.say("land", reason, is_grave)
        self._follower.flights.descent = descent
        return self.descend(now)

    def descend(self, now: float) -> float:
        """Land from here, and return s until the motors stop.

        What the controllers learn meanwhile may come from a floor that the drone pushes against, so
        the trim of now is kept.

        now: s
        """
        mode = self._row.mode
        if mode is not LAND_MODE:
            self._setup.controls.trim.keep()
        seconds = self._follower.descend(now)
        self._permission.commanded = False
        self._permission.change(
            ModeEvent.ARRIVED if mode is RETURN_MODE else ModeEvent.LAND
        )
        if mode is not LAND_MODE and self._setup.is_replayed:
            self._replay_lands_at = now + seconds + TOUCHDOWN_LIMITS.replay_overdue_time
        return seconds

    def get_remaining(self, now: float) -> float:
        """Return s until the planned flight is over; 0 for a landing that may begin again and again.

        now: s
        """
        if self._row.mode is LAND_MODE and self.is_unreached:
            return 0.0
        return self._follower.flights.remaining(now)

    def end(self) -> None:
        """Enter the mode on the ground, and forget the flight."""
        self._permission.change(ModeEvent.DOWN)
        self._down_at = math.inf
        self._replay_lands_at = math.inf
        self._low_since = math.inf
        self._to_firmware = None
        self._tell_owner_at = 0.0
        self._follower.forget()
        self._follower.flights.descent = STRAIGHT_DOWN
        self._setup.controls.trim.frozen = True
        self._setup.controls.trim.restore()

    def is_down(self, state: State, now: float) -> bool:
        """Return whether the drone has landed.

        It is low enough, or its descent is over and it no longer moves, whatever height cameras and
        floor suggest. A height that is only predicted does not count: it may be wrong by a fall
        that breaks the drone.

        now: s
        """
        ground = self._floor
        flights = self._clearance.flights
        is_seen = state.age <= SEEN_AGE
        is_at_rest = bool(np.linalg.norm(state.v) < TOUCHDOWN_LIMITS.rest_speed)
        high = ground + TOUCHDOWN_LIMITS.airborne_height
        if self.is_unreached and is_seen and state.flat[2] > high:
            return False
        if now > self._down_at:
            return (
                not self._body.is_turning()
                or now > self._down_at + FIRMWARE_LANDING.motor_timeout
            )
        if not self._setup.controls.takes_off:
            return flights.done(now) and is_at_rest
        if now > self._replay_lands_at:
            up = state.flat[2] - ground
            self._notes.say(
                "replay",
                f"{REPLAY_TEXT}: its landing ends {up:.2f} m above the ground",
            )
            return True
        # Its owner has seen it land, or does not come back.
        if not is_seen and (self._body.is_turning() or self._body.is_unheard()):
            return not self._body.is_turning()
        if is_seen and state.flat[2] < ground + TOUCHDOWN_LIMITS.floor_height:
            return True
        if is_seen and self._is_kept_up(state, now):
            return True
        return is_at_rest and self._is_overdue(is_seen, now)

    def _is_kept_up(self, state: State, now: float) -> bool:
        """Return whether others have kept the drone just above the ground for long enough.

        now: s
        """
        height = state.flat[2] - self._floor
        gives_way = now < self._clearance.gave_way + TOUCHDOWN_LIMITS.overdue_time
        if height > TOUCHDOWN_LIMITS.kept_up_height or not gives_way:
            self._low_since = math.inf
            return False
        self._low_since = min(self._low_since, now)
        speed = float(np.linalg.norm(state.v))
        if (
            now - self._low_since < TOUCHDOWN_LIMITS.kept_up_time
            or speed > TOUCHDOWN_LIMITS.kept_up_speed
        ):
            return False
        text = f"others keep it {height:.2f} m above the ground: stops its motors there"
        self._notes.say("land", text)
        return True

    def _is_overdue(self, is_seen: bool, now: float) -> bool:
        """Return whether the descent should have been over for some time.

        A delayed drone waits until it may go down.
        """
        late = (
            TOUCHDOWN_LIMITS.overdue_time
            if is_seen
            else TOUCHDOWN_LIMITS.unseen_overdue_time
        )
        flights = self._clearance.flights
        planned = self._clearance.planned
        return (
            isinstance(flights.plan, Landing)
            and flights.done(now, late)
            and now > self._clearance.gave_way + late
            and not (planned is not None and planned.delayed)
        )

    def must_hand_over(self, state: State, is_astray: bool) -> bool:
        """Return whether the firmware must land a landing drone behind a radio.

        is_astray: whether the poses are not its own
        """
        return self._setup.has_radio and (
            state.age > FIRMWARE_LANDING.pose_timeout or is_astray
        )

    def hand_over(self, state: State, now: float) -> None:
        """Let the firmware land the drone by its own sensors.

        The landing is soon, because the sensors drift, and ends a little below the floor.

        now: s
        """
        if self.is_handed_over:
            return
        ground = self._floor
        depth = float(state.p[2]) - ground + FIRMWARE_LANDING.depth
        seconds = max(depth / FIRMWARE_LANDING.speed, 1.0)
        self._down_at = now + seconds
        self._guard.bear_unseen(state.age + seconds + TOUCHDOWN_LIMITS.overdue_time)
        floor = ground - FIRMWARE_LANDING.depth
        self._to_firmware = XYZ(
            "land", np.array([0.0, 0.0, floor, yaw_of(state.q), seconds])
        )
        self.tell_owner(now)

    def tell_owner(self, now: float) -> None:
        """Repeat the command to land by the firmware; the owner takes a silent agent for gone.

        now: s
        """
        if self._to_firmware is not None and now >= self._tell_owner_at:
            self._tell_owner_at = now + FIRMWARE_LANDING.command_interval
            self._body.send(self._to_firmware)

    def fly_unheard(self, state: State, now: float) -> None:
        """Fly the landing of a drone that may not receive its commands.

        The landing begins anew from where the drone is seen, as soon as the plan leaves it behind.

        now: s
        """
        flights = self._clearance.flights
        planned = flights.sample(now)
        if (
            planned is None
            or np.linalg.norm(planned.p - state.p)
            > TOUCHDOWN_LIMITS.replanning_distance
        ):
            start = FullState.at(state.p, state.v, yaw=yaw_of(state.q))
            flights.descend(start, now)
            planned = flights.sample(now)
        assert planned is not None  # noqa: S101 - the landing has just begun
        self._row.fly(planned)
