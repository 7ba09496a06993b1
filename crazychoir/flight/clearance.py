"""How one drone keeps clear of the others: the collision filter bends what it wants, or it flies agreed ways."""

import math

from crazychoir.flight.point_flights import LONGEST_WAIT, Flights
from crazychoir.numerics.math3d import yaw_of
from crazychoir.planning.point_to_point import PointToPoint
from crazychoir.safety.collision.agreed.planned import Future, PlannedFlights
from crazychoir.safety.collision.filter import CollisionFilter
from crazychoir.types import Acceleration, FullState, State, Vec

BACK, BEHIND, AHEAD = 0.05, 0.15, 0.5
"""m from its plan: one that was pushed aside is back; one that lands does so where it is; the plan waits for it: so far
ahead it is beyond who stands in the way."""

ALONE = 0.5
"""s after which who gives way does so for the first time."""
STAYS, LEAVES = 3.0, 15.0
"""s for which one that lands is kept up by one on the floor, or by one that flies, before it comes down beside."""
SOON, UNHEARD = 1.0, 5.0
"""s without an answer before it is said, and before one that needs it lands."""
RETURN = 2.0
"""s since the filter acted last, in which it comes back gently."""

DEAF = 4.0
"""s of being cut off, after which a drone lands: in GONE s at most it is down, and out of the way of all."""


class Clearance:
    """Either a collision filter, or agreed ways, or neither; and what becomes of the flights that are planned.

    flights: of its pilot, which wait, or go on, for a drone that was pushed aside;  period: s, of a tick.
    """

    def __init__(
        self,
        collision: CollisionFilter | PlannedFlights | None,
        flights: Flights,
        period: float,
    ) -> None:
        self.filter = collision if isinstance(collision, CollisionFilter) else None
        self.planned = collision if isinstance(collision, PlannedFlights) else None
        self.flights = flights
        self.period = period
        self.traffic = None if collision is None else collision.traffic
        self.aside = False
        """Whether it was pushed off its plan, and is not back."""
        self.ticks = 0
        """In which the collision filter has flown it."""
        self.gave_way = -math.inf
        """s, when it last gave way to another drone."""
        self._cut_off = math.inf  # since when
        self._kept_up = (
            -math.inf
        )  # s, since when it has done so, or has chosen another place to land for it

    def evasion(
        self,
        state: State,
        reference: Acceleration | FullState,
        gains: Vec,
        now: float,
        lands: bool = False,
    ) -> Vec | None:
        """The acceleration (3,) that keeps it clear of the others; None: it is clear, and may fly as it wants.

        lands: whether it comes down, for which it does not wait until it hears everybody.
        """
        collision = self.filter
        if collision is None:
            return None
        collision.look(now)
        if isinstance(reference, FullState):
            safe = collision.full_state(state, reference.flat, gains, now, lands=lands)
        else:
            safe = collision.acceleration(state, reference.a, gains, now)
        self._cut_off = min(self._cut_off, now) if collision.cut_off else math.inf
        if safe is not None:
            self.gave_way = now
            self.ticks += 1
        return safe

    def deaf(self, now: float) -> bool:
        """Whether it has been cut off from half of those that fly, or more, for too long."""
        return now >= self._cut_off + DEAF

    def astray(self, state: State, planned: FullState, now: float) -> bool:
        """Whether a drone that was pushed aside is far from its plan: one that lands does so where it is.

        After RETURN s it is wind that keeps it from coming back, which is fought with all that the control has.
        """
        far = math.dist(planned.p.tolist(), state.p.tolist())
        self.aside = far > BACK and now < self.gave_way + RETURN
        return far > BEHIND

    def awaited(self, state: State, planned: FullState, now: float) -> FullState:
        """The reference for a drone that was pushed aside: far off it goes on from where it is, or its plan waits."""
        flights = self.flights
        if math.dist(planned.p.tolist(), state.p.tolist()) <= AHEAD:
            return planned
        if flights.resume(FullState.at(state.p, yaw=yaw_of(state.q)), now):
            return flights.sample(now) or planned
        if flights.wait(self.period):
            return FullState.at(
                planned.p, yaw=planned.yaw
            )  # a plan that waits stands still
        return planned

    def planned_flight(
        self,
        planned: PlannedFlights,
        state: State,
        wanted: FullState,
        now: float,
        lands: bool = False,
        must_land: bool = False,
    ) -> FullState:
        """The plan's reference, as far as the others have agreed to it; who must land asks nobody unheard."""
        if must_land and not planned.hears(state, now):
            return planned.lands(wanted, now)
        flights = self.flights
        plan = flights.plan
        whole = flights.remaining(now) if isinstance(plan, PointToPoint) else 0.0
        waits = flights.waited < LONGEST_WAIT
        future: Future = lambda later: flights.sample(now + later) or wanted  # noqa: E731
        flown = self.agreed(state, wanted, future, whole, now, lands, waits)
        if planned.delayed:
            arrives = isinstance(plan, PointToPoint) and planned.comes_to(plan.goal)
            flights.wait(planned.left(now) - whole if arrives else self.period)
        return flown

    def agreed(
        self,
        state: State,
        wanted: FullState,
        future: Future,
        whole: float,
        now: float,
        lands: bool = False,
        waits: bool = False,
    ) -> FullState:
        """What a drone that tells its ways may fly instead of `wanted`; others may fly that."""
        planned = self.planned
        if planned is None:
            return wanted
        flown = planned.fly(state, wanted, future, whole, now, lands, waits)
        if self.delayed_by is not None:
            if not lands or now > self.gave_way + ALONE:
                self._kept_up = now
            self.gave_way = now
        return flown

    def rest(self, now: float) -> None:
        """It is on the ground: whether it is cut off is asked anew when it flies."""
        self._cut_off = math.inf
        if self.planned is not None:
            self.planned.rest(now)

    def begins_landing_anew(
        self, planned: PlannedFlights, wanted: FullState, now: float
    ) -> bool:
        """Whether one that lands, and is not answered, rests elsewhere than where it was to come down."""
        rests = planned.unanswered and planned.delayed and planned.left(now) == 0.0
        return rests and not planned.comes_to(wanted.p)

    def lands_beside(self, p: Vec, now: float) -> Vec | None:
        """(3,) m, where one that is kept up above p by others comes down instead; None: it waits, or there is none."""
        planned = self.planned
        if planned is None or self.delayed_by is None or planned.left(now) > 0.0:
            return None
        if now - self._kept_up < (
            STAYS if planned.obstacles.stands(self.delayed_by) else LEAVES
        ):
            return None
        self._kept_up = now
        return planned.obstacles.beside(p, self.flights.fence)

    @property
    def silent(self) -> str:
        """What keeps it from flying where it is wanted: somebody who does not answer; empty if nobody does."""
        mine = None if self.planned is None else self.planned.agreement
        return (
            ""
            if mine is None or mine.in_vain < SOON
            else f"drone {mine.lacking} does not answer"
        )

    @property
    def gives_up(self) -> bool:
        """Whether it has waited so long for an answer that it had better land."""
        return self.planned is not None and self.planned.agreement.in_vain > UNHEARD

    @property
    def delayed_by(self) -> int | None:
        """Whose way it waits for, or turns aside from, of those that have told theirs."""
        return (
            None
            if self.planned is None or not self.planned.delayed
            else self.planned.gives_way_to
        )
