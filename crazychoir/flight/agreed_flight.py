"""The flight of a drone with a planner on board: it flies only paths to which the others have agreed."""

from collections.abc import Callable
from functools import partial

from crazychoir.flight.batch import DroneRow
from crazychoir.flight.clearance import Clearance
from crazychoir.flight.flight_limits import SEEN_AGE
from crazychoir.flight.notes import FlightNotes
from crazychoir.flight.references import extrapolate_reference
from crazychoir.safety.rules.guard import Action
from crazychoir.safety.rules.limits import ReferenceLimits
from crazychoir.safety.rules.modes import LAND_MODE, TAKEOFF_MODE
from crazychoir.types import FullState, Reference, State, Vec, Velocity


class AgreedFlight:
    """Flies the part of a reference or plan to which the other drones have agreed.

    row: of the drone in its batch
    notes: of the drone
    clearance: of the drone, with the planner of agreed paths and its planned flights
    descend: begins a landing at a time in s, beside a place (3,) m or from here; returns its s
    """

    def __init__(
        self,
        row: DroneRow,
        notes: FlightNotes,
        clearance: Clearance,
        descend: Callable[[float, Vec | None], float],
    ) -> None:
        self._row = row
        self._notes = notes
        self._clearance = clearance
        self._flights = clearance.flights
        self._descend = descend

    def fly(
        self,
        state: State,
        reference: Reference | None,
        limits: ReferenceLimits,
        now: float,
    ) -> None:
        """Fly what the other drones have agreed to.

        state: of the drone
        reference: of guidance, None if the drone flies its plan
        limits: of references
        now: s
        """
        row = self._row
        if isinstance(reference, Velocity):
            reference = FullState.at(state.p, reference.v, yaw=reference.yaw)
        if isinstance(reference, FullState):
            wanted: FullState = reference
            cut = limits.full_state(reference, state)
            flown = self._clearance.agreed(
                state, cut, partial(extrapolate_reference, reference), 0.0, now
            )
            self._flights.clear()
        else:
            wanted, flown = self._get_agreed_plan(state, now)
        self._say_delayed()
        is_low = (
            row.mode is TAKEOFF_MODE and state.flat[2] < row.drone["lift_off_height"]
        )
        learns = not is_low and state.age <= SEEN_AGE and flown is wanted
        row.fly(flown, learns_trim=learns)

    def _get_agreed_plan(self, state: State, now: float) -> tuple[FullState, FullState]:
        """Return the set-point of the plan, and the part of it to which the others have agreed."""
        planner = self._clearance.planned
        wanted = self._flights.sample(now)
        assert planner is not None  # noqa: S101 - callers have looked
        assert wanted is not None  # noqa: S101 - there is a plan
        lands = self._row.mode is LAND_MODE
        planned = self._land_elsewhere(wanted, now) if lands else wanted
        must_land = self._row.obeyed is Action.LAND
        flown = self._clearance.planned_flight(
            planner, state, planned, now, lands, must_land
        )
        return wanted, flown

    def _land_elsewhere(self, planned: FullState, now: float) -> FullState:
        """Return the reference of a landing drone that the others may keep up.

        It lands beside drones that keep it up for too long, or where it is if no other drone
        answers.
        """
        clearance = self._clearance
        beside = clearance.lands_beside(planned.p, now)
        if beside is not None:
            self._notes.say(
                "beside",
                f"cannot come down for drone {clearance.delayed_by}: lands beside",
            )
        elif not clearance.begins_landing_anew(planned, now):
            return planned
        self._descend(now, beside)
        return self._flights.sample(now) or planned

    def _say_delayed(self) -> None:
        """Say which drone this one waits for."""
        other = self._clearance.delayed_by
        if silent := self._clearance.silent:
            self._notes.say("silent", silent)
        elif other is not None:
            self._notes.say("collision", f"keeps clear of drone {other}")
