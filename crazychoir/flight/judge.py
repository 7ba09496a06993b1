"""The judge of one drone: what it does in a tick in which something happens to it.

The compiled stage finds the drones for which nothing happens, see stages.find_rows_to_judge. For
each of the others its judge decides by the safety table, its mode, and its surroundings.
"""

import numpy as np

from crazychoir.flight.batch import Course, DroneRow
from crazychoir.flight.body import DroneBody
from crazychoir.flight.flight_limits import SEEN_AGE, TOUCHDOWN_LIMITS
from crazychoir.flight.follower import FlightFollower, Rise
from crazychoir.flight.ground_watch import LANDS_ASTRAY, GroundWatch
from crazychoir.flight.homecoming import Homecoming
from crazychoir.flight.notes import FlightNotes
from crazychoir.flight.permission import Permission
from crazychoir.flight.setup import FlightSetup
from crazychoir.flight.touchdown import Touchdown
from crazychoir.runtime.clock import NS_PER_SECOND
from crazychoir.safety.rules.guard import Action, Guard, SafetyVerdict
from crazychoir.safety.rules.modes import (
    GROUND_MODE,
    GUIDED_MODES,
    HOVER_MODE,
    LAND_MODE,
    MOTORS_OFF_MODES,
    RETURN_MODE,
    TAKEOFF_MODE,
    ModeEvent,
    get_refusal,
)
from crazychoir.types import Point, State, Vec

LOW_MODES = (TAKEOFF_MODE, LAND_MODE)
"""Modes in which the drone leaves the fence downwards."""
CUT_OFF_TEXT = "hears no more than half of the drones that fly: landing"
"""Reason of the landing of a drone that is cut off from the others."""


class Judge:
    """Decides the course of one drone in a tick, and acts on the safety table.

    setup: of the drone
    row: of the drone in its batch
    body: of the drone
    guard: of the drone
    notes: of the drone
    permission: of the drone
    follower: of the drone, which plans its flights
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
        self.touchdown = Touchdown(setup, row, body, guard, notes, permission, follower)
        self.ground_watch = GroundWatch(setup, row, body, guard, notes)
        self.braked = 0
        """Number of times the safety table has braked the drone in this flight."""
        self._rise = Rise(row, follower)
        self.watch_always()

    def watch_always(self) -> None:
        """Let this judge decide in each tick if something outside of the batch counts."""
        self._row.drone["is_by_hand"] = (
            self._body.is_watched
            or self._permission.takes_over
            or self._clearance.planned is not None
        )

    def decide(self, state: State, now: float) -> None:
        """Decide what the drone does in this tick, and write its course.

        now: s
        """
        row = self._row
        row.drone["course"] = Course.NOTHING
        if self._permission.takes_over and state.age <= SEEN_AGE:
            self._land_found(now)
        if row.mode in MOTORS_OFF_MODES:
            self._clearance.rest(now)
            is_others = self._permission.takes_over and row.mode is GROUND_MODE
            row.drone["course"] = Course.NOTHING if is_others else Course.IDLE
            return
        if self._body.is_unheard():
            self._guard.bear_unseen(state.age + TOUCHDOWN_LIMITS.overdue_time)
        verdict = self._check(state, now)
        if verdict.action is not Action.NOMINAL or row.obeyed is not Action.NOMINAL:
            self.obey(verdict, now)
            if not self._permission.airborne:
                row.drone["course"] = Course.IDLE
                return
        if self._setup.has_radio:
            self._watch_radio_drone(state, now)
        if self._is_held_at_fence(verdict, now):
            row.drone["fence_ticks"] += 1
        self._land_if_alone(now)
        if (
            row.mode is RETURN_MODE
            and row.obeyed is Action.NOMINAL
            and self._follower.flights.done(now)
        ):
            self._fly_next_leg(state, now)
        self._choose_course(state, now)

    def _choose_course(self, state: State, now: float) -> None:
        """Let the drone fly on, unless its landing is over or is not the pilot's."""
        row = self._row
        touchdown = self.touchdown
        is_landing = row.mode is LAND_MODE
        if is_landing and touchdown.is_down(state, now):
            self._end_flight()
            row.drone["course"] = Course.IDLE
        elif touchdown.is_handed_over:
            touchdown.tell_owner(now)
        elif self._permission.takes_over:
            return
        elif touchdown.is_unreached and is_landing:
            touchdown.fly_unheard(state, now)
        else:
            self._follower.prepare(state, now)

    def _check(self, state: State, now: float) -> SafetyVerdict:
        """Return the verdict of the safety table."""
        row = self._row
        if not row.has_reference:
            is_low = row.mode in LOW_MODES
            return self._guard.check(now, state, state.age, None, is_low)
        age_ns = int(row.drone["ticked_ns"]) - int(row.drone["reference_ns"])
        return self._guard.check(now, state, state.age, age_ns / NS_PER_SECOND)

    def obey(self, verdict: SafetyVerdict, now: float) -> None:
        """Act on a verdict of the safety table when its action changes.

        now: s
        """
        if verdict.action is not Action.NOMINAL:
            rule = f"{verdict.action.name} {verdict.measure}"
            is_grave = verdict.action >= Action.LAND
            self._notes.say(rule, verdict.reason, is_grave)
            if self._row.mode is TAKEOFF_MODE and self._rise.is_late(now):
                self._permission.change(ModeEvent.ARRIVED)
        if verdict.action is self._row.obeyed:
            return
        self._row.obeyed = verdict.action
        self.braked += verdict.action is Action.BRAKE
        if verdict.action is Action.CUT:
            self.cut(verdict.reason)
        elif verdict.action is Action.LAND:
            self._give_up(verdict.reason, now)
        elif verdict.action is Action.BRAKE and self._row.mode is not LAND_MODE:
            self._rise.brake(now)
            self._follower.brake(now)
        elif self._row.mode is TAKEOFF_MODE:
            self._rise.go_on(now)

    def begin_anew(self, now: float) -> None:
        """Come to rest and hover, or continue to land, after a failed tick.

        now: s
        """
        self._follower.forget()
        if self._row.mode is LAND_MODE:
            self.touchdown.descend(now)
        elif self._row.mode in GUIDED_MODES:
            self._permission.change(ModeEvent.HOLD)

    def lose_guidance(self, reason: str) -> bool:
        """Note that guidance is gone for this reason; return whether the drone must come down."""
        airborne = self._permission.airborne
        does = "hovering, then landing" if airborne else "stays on the ground"
        text = f"guidance failed ({reason}): {does}"
        self._notes.say("guidance", text, is_grave=True)
        if airborne:
            self._permission.unguided = reason
            self._permission.commanded = False
        return airborne

    def cut(self, reason: str) -> None:
        """Stop the motors, for good."""
        self._permission.change(ModeEvent.STOP)
        self._permission.cut_for = self._permission.cut_for or reason
        self._body.cut()
        self._notes.say("cut", reason, is_grave=True)

    def _give_up(self, reason: str, now: float) -> None:
        """Land, whatever the mission wants."""
        if self.touchdown.land(reason, True, now) > 0.0:
            self._notes.brought_down = self._notes.brought_down or reason

    def _watch_radio_drone(self, state: State, now: float) -> None:
        """Act on what radio and cameras say against the flight of a drone behind a radio."""
        row = self._row
        if row.mode is TAKEOFF_MODE:
            self.ground_watch.watch_lift_off(state, self._follower.flights, now)
        if not self.touchdown.is_handed_over:
            self.ground_watch.watch_motion(state)
        is_astray = self._guard.told("astray") == LANDS_ASTRAY
        if row.mode is LAND_MODE and self.touchdown.must_hand_over(state, is_astray):
            self.touchdown.hand_over(state, now)
        if why := self.ground_watch.explain_fall(state, now):
            self._give_up(why, now)

    def _is_held_at_fence(self, verdict: SafetyVerdict, now: float) -> bool:
        """Return whether the fence keeps the drone from where guidance wants it.

        Either the safety table keeps it inside, or a flight to a place outside has ended at the
        fence.
        """
        if self._row.mode not in GUIDED_MODES or self._permission.held:
            return False
        is_beyond = bool(self._row.drone["is_beyond"])
        return verdict.measure == "stop" or (
            is_beyond and self._follower.flights.done(now)
        )

    def _land_if_alone(self, now: float) -> None:
        """Land a drone that hears too few others, or waits too long for an answer."""
        if self._row.mode is not LAND_MODE and self._clearance.is_deaf(now):
            self._give_up(CUT_OFF_TEXT, now)
        if self._row.mode is not LAND_MODE and self._clearance.gives_up:
            self._give_up(f"{self._clearance.silent}: landing", now)

    def _land_found(self, now: float) -> None:
        """Land from where the drone is seen, in the air, where others have flown it."""
        self._permission.takes_over = False
        self.watch_always()
        if self._row.mode is GROUND_MODE:
            self._permission.change(ModeEvent.FOUND)
            why = "found in the air, where others have flown it: landing"
            self.touchdown.land(why, False, now)
        elif self._row.mode is LAND_MODE:
            self._follower.flights.clear()
            self.touchdown.descend(now)

    def may_fly(self, commanded: bool) -> bool:
        """Return whether a flight may begin now, which needs no reference.

        It may not if the drone is not in the air, is held, waits for its operator's start, or brakes
        because the safety table says so. A missing reference is no obstacle.

        commanded: whether the operator wants the flight
        """
        if not self._permission.may_fly(commanded):
            return False
        self._guard.excuse("reference")
        return not self._guard.acts

    def begin_take_off(
        self, height: float | None, now: float, duration: float = 0.0
    ) -> float:
        """Begin to rise, and return the time it will take in s; 0 if the drone does not.

        height: m above the ground; None for the height of [flight]
        now: s
        duration: s; the rise takes longer if the limits demand it
        """
        state = self._row.state
        if get_refusal(self._row.mode, ModeEvent.TAKE_OFF) or state is None:
            return 0.0
        if not self._setup.controls.takes_off:
            self._permission.skip_take_off()
            return 0.0
        seconds = self._rise.begin(height, now, duration)
        self.ground_watch.begin_take_off(float(state.p[2]), now)
        self._guard.forget()
        self._permission.change(ModeEvent.TAKE_OFF)
        return seconds

    def hold(self, on: bool, now: float) -> None:
        """Keep the drone where it is for its operator, or let it go on; not while it lands.

        now: s
        """
        permission = self._permission
        if permission.refuses(ModeEvent.HOLD if on else ModeEvent.GO):
            return
        permission.hold(on)
        if on and permission.airborne:
            self._follower.rest(now)
        is_hovering = self._row.mode is HOVER_MODE
        if is_hovering and not on and self._follower.homecoming is not None:
            permission.change(ModeEvent.HOME)

    def begin_return(self, home: Point, level: float, now: float) -> None:
        """Come to rest, then fly home at a height of `level` m, and land there.

        home: (3,) m, world: home if the drone has not taken off; else it lands where it took off
            first
        now: s
        """
        self._permission.hold(False)
        started_at = self._permission.started_at
        place = home if started_at is None else started_at
        above = np.array([*self._row.get_state().p[:2], level])
        inside: Vec = self._guard.room.nearest(above, inset=0.0)
        self._follower.homecoming = Homecoming(inside, place, inside[2])
        self._row.set_reference(None)
        self._follower.brake(now)
        self._permission.change(ModeEvent.HOME)

    def _fly_next_leg(self, state: State, now: float) -> None:
        """Begin the next leg of the way home.

        Land at the end of the way, or where the drone makes no progress.
        """
        way = self._follower.homecoming
        leg = None if way is None else way.leg(state.p)
        if leg is not None:
            self._follower.fly_leg(leg, now)
            return
        is_stuck = way is not None and way.stuck
        why = "does not get home: lands where it is" if is_stuck else "home: landing"
        self.touchdown.land(why, False, now)

    def _end_flight(self) -> None:
        """Forget a flight that is over, and say how often the safety table has braked it."""
        self.touchdown.end()
        self._row.obeyed = Action.NOMINAL
        self._guard.forget()
        if self.braked > 1:
            times = f"{self.braked} times in this flight"
            self._notes.report("braked", f"the safety table has braked it {times}")
        self.braked = 0
