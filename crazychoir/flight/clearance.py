"""The clearance of one drone from the others, by a collision filter or by agreed paths."""

import math
from typing import NamedTuple

from crazychoir.flight.batch import DroneRow
from crazychoir.flight.point_flights import FLIGHT_PATIENCE, PointFlights
from crazychoir.numerics.math3d import yaw_of
from crazychoir.planning.landing import FlightLegs
from crazychoir.planning.point_to_point import PointToPoint
from crazychoir.safety.collision.agreed.path_choice import FutureReference
from crazychoir.safety.collision.agreed.planned import PlannedFlights
from crazychoir.safety.collision.filter import CollisionFilter
from crazychoir.types import FullState, State, Vec


class PlanDeviation(NamedTuple):
    """What a drone that was pushed aside does, by its distance from its plan."""

    back_distance: float = 0.05
    """Distance in m from its plan at which a drone that was pushed aside is back."""
    landing_distance: float = 0.15
    """Distance in m from its plan at which a landing drone lands where it is."""
    waiting_distance: float = 0.5
    """Distance in m between drone and plan at which the plan waits for the drone.

    With this lead the plan is already beyond a drone that stands in the way.
    """
    gentle_return_time: float = 2.0
    """Seconds since the collision filter last acted, during which the drone comes back gently.
    """


PLAN_DEVIATION = PlanDeviation()


class ClearanceTimes(NamedTuple):
    """How long a drone waits for others before it reports this, turns aside, or lands."""

    first_time_gap: float = 0.5
    """Seconds without giving way after which the wait for another drone counts from 0 again."""
    reference_wait: float = 2.0
    """Seconds for which a trajectory waits for a drone that others delay.

    Then the trajectory goes on without the drone, and the drone goes round the others until it is back.
    Otherwise drones that wait on their trajectories, each for another one, would wait in vain.
    """
    standing_drone_wait: float = 3.0
    """Seconds for which a drone on the floor may keep a landing drone in the air.

    Then the landing drone lands beside it.
    """
    flying_drone_wait: float = 15.0
    """Seconds for which a flying drone may keep a landing drone in the air.

    Then the landing drone lands beside it.
    """
    reference_end: float = 0.5
    """Seconds before the end of a trajectory within which it waits for its drone like a goal."""
    answer_report: float = 1.0
    """Seconds without an answer before this is reported."""
    answer_timeout: float = 5.0
    """Seconds without an answer before a drone that needs it lands."""
    cut_off_timeout: float = 4.0
    """Seconds of being cut off after which a drone lands.

    Then it is down before NEIGHBOUR_AGES.gone s have passed and the others count it as down.
    """


CLEARANCE_TIMES = ClearanceTimes()


class Clearance:
    """Keeps a drone clear by a collision filter, by agreed paths, or not at all.

    It also decides what happens to the planned flights.

    collision: the collision filter, or the planner of agreed paths; None for neither
    flights: of the pilot; they wait, or go on, for a drone that was pushed aside
    period: s, of a tick
    row: of the drone in its batch
    """

    def __init__(
        self,
        collision: CollisionFilter | PlannedFlights | None,
        flights: PointFlights,
        period: float,
        row: DroneRow,
    ) -> None:
        self.filter = collision if isinstance(collision, CollisionFilter) else None
        self.planned = collision if isinstance(collision, PlannedFlights) else None
        self.flights = flights
        self.period = period
        self.traffic = None if collision is None else collision.traffic
        self._row = row
        row.drone["avoids"] = self.filter is not None
        if self.traffic is not None:
            row.drone["listener"] = self.traffic.listener
        # Time in s since when others keep it up, or when it last chose another place to land.
        self._kept_up = -math.inf
        # Seconds for which the trajectory has waited since the drone was last on it.
        self._reference_waited = 0.0

    @property
    def is_aside(self) -> bool:
        """Whether the drone was pushed off its plan and is not back."""
        return bool(self._row.drone["is_aside"])

    @property
    def ticks(self) -> int:
        """Number of ticks that the collision filter has flown the drone."""
        return int(self._row.drone["evasion_ticks"])

    @property
    def gave_way(self) -> float:
        """Time in s when the drone last gave way to another drone."""
        return float(self._row.drone["gave_way"])

    def find_departure(self, state: State, now: float) -> FullState:
        """Return the state from which a new plan begins.

        state: of the drone
        now: s
        """
        # The plan of a drone that was pushed aside does not say where it is.
        if self.is_aside:
            return FullState.at(state.p, state.v, yaw=yaw_of(state.q))
        flown = self._row.flown
        if self.planned is not None and flown is not None:
            elsewhere = self.planned.departure(flown.yaw, now)
            if elsewhere is not None:
                return elsewhere
        return self.flights.departure(state, now)

    def is_deaf(self, now: float) -> bool:
        """Return whether the drone has been cut off from half of the flying drones for too long."""
        since = float(self._row.drone["cut_off_since"])
        return now >= since + CLEARANCE_TIMES.cut_off_timeout

    def wait_for_drone(self, state: State, now: float) -> None:
        """Let the plan wait for a drone that was pushed far off it, or begin anew from where it is.

        state: of the drone
        now: s
        """
        flights = self.flights
        planned = flights.sample(now)
        if flights.resume(FullState.at(state.p, yaw=yaw_of(state.q)), now):
            return
        if planned is not None and flights.wait(self.period):
            flights.stand(FullState.at(planned.p, yaw=planned.yaw))

    def planned_flight(
        self,
        planned: PlannedFlights,
        state: State,
        wanted: FullState,
        now: float,
        lands: bool = False,
        must_land: bool = False,
    ) -> FullState:
        """Return the reference of the plan as far as the others have agreed to it.

        A drone that must land does not ask drones that it cannot hear.

        planned: the planner of agreed paths
        state: of the drone
        wanted: the reference of the plan
        now: s
        lands: whether the drone is landing
        must_land: whether the safety table demands the landing
        """
        if must_land and not planned.hears(state, now):
            return planned.lands(wanted, now)
        flights = self.flights
        plan = flights.plan
        whole = flights.remaining(now) if isinstance(plan, PointToPoint) else 0.0
        may_be_late = lands or isinstance(plan, (PointToPoint, FlightLegs))
        waits = flights.waited < FLIGHT_PATIENCE.longest_wait and (
            may_be_late
            or self._reference_waited < CLEARANCE_TIMES.reference_wait
            or flights.remaining(now) < CLEARANCE_TIMES.reference_end
        )
        future: FutureReference = lambda later: flights.sample(now + later) or wanted  # noqa: E731
        flown = self.agreed(state, wanted, future, whole, now, lands, waits)
        if not planned.delayed:
            self._reference_waited = 0.0
        elif waits:
            arrives = isinstance(plan, PointToPoint) and planned.agreement.comes_to(
                plan.goal
            )
            flights.wait(
                planned.agreement.left(now) - whole if arrives else self.period
            )
            if not may_be_late:
                self._reference_waited += self.period
        return flown

    def agreed(
        self,
        state: State,
        wanted: FullState,
        future: FutureReference,
        whole: float,
        now: float,
        lands: bool = False,
        waits: bool = False,
    ) -> FullState:
        """Return the reference to fly: the part of `wanted` to which the other drones have agreed.

        Without agreed paths it is `wanted` itself.

        state: of the drone
        wanted: the reference of the plan or of the mission
        future: returns the reference a number of s from now
        whole: s until the reference ends at rest, if a single point-to-point flight leads there; else 0
        now: s
        lands: whether the drone is landing
        waits: whether the reference stands still while the drone is delayed
        """
        planned = self.planned
        if planned is None:
            return wanted
        flown = planned.fly(state, wanted, future, whole, now, lands, waits)
        if self.delayed_by is not None:
            if not lands or now > self.gave_way + CLEARANCE_TIMES.first_time_gap:
                self._kept_up = now
            self._row.drone["gave_way"] = now
        return flown

    def rest(self, now: float) -> None:
        """Note that the drone is on the ground.

        Whether it is cut off is judged anew in its next flight.
        """
        self._row.drone["cut_off_since"] = math.inf
        if self.planned is not None:
            self.planned.rest(now)

    def begins_landing_anew(self, wanted: FullState, now: float) -> bool:
        """Return whether a landing drone that gets no answer rests away from its landing place."""
        planned = self.planned
        if planned is None:
            return False
        rests = (
            planned.unanswered
            and planned.delayed
            and planned.agreement.left(now) == 0.0
        )
        return rests and not planned.agreement.comes_to(wanted.p)

    def lands_beside(self, p: Vec, now: float) -> Vec | None:
        """Return the place (3,) m where a drone comes down if others keep it in the air above p.

        p: (3,) m, world
        now: s
        Returns None if the drone still waits, or there is no such place.
        """
        planned = self.planned
        if (
            planned is None
            or self.delayed_by is None
            or planned.agreement.left(now) > 0.0
        ):
            return None
        if now - self._kept_up < (
            CLEARANCE_TIMES.standing_drone_wait
            if planned.obstacles.stands(self.delayed_by)
            else CLEARANCE_TIMES.flying_drone_wait
        ):
            return None
        self._kept_up = now
        return planned.obstacles.beside(p, self.flights.fence)

    @property
    def silent(self) -> str:
        """Text that names the drone with the missing answer that delays this drone; empty if there is none."""
        mine = None if self.planned is None else self.planned.agreement
        return (
            ""
            if mine is None or mine.in_vain < CLEARANCE_TIMES.answer_report
            else f"drone {mine.lacking} does not answer"
        )

    @property
    def gives_up(self) -> bool:
        """Whether the drone has waited so long for an answer that it should land."""
        return (
            self.planned is not None
            and self.planned.agreement.in_vain > CLEARANCE_TIMES.answer_timeout
        )

    @property
    def delayed_by(self) -> int | None:
        """Id of the drone with agreed paths for which this one waits or turns aside; else None."""
        return (
            None
            if self.planned is None or not self.planned.delayed
            else self.planned.choice.gives_way_to
        )
