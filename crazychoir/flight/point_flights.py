"""The flights that a pilot plans itself: to a place, to rest, down; within fence and limits."""

from dataclasses import dataclass

import numpy as np

from crazychoir.config.tables import FlightTable
from crazychoir.errors import Refused
from crazychoir.flight.flight_limits import TOUCHDOWN_LIMITS
from crazychoir.numerics.array_like import to_floats
from crazychoir.numerics.kernels import Record
from crazychoir.numerics.math3d import STANDARD_GRAVITY, yaw_of
from crazychoir.planning.landing import STRAIGHT_DOWN, Descent, FlightLegs, Landing
from crazychoir.planning.piecewise import Piecewise
from crazychoir.planning.plan_row import (
    NO_PLAN,
    PLAN_ROW,
    PlanKind,
    clear_plan,
    load_pieces,
)
from crazychoir.planning.point_to_point import (
    PEAK_SPEED,
    PointToPoint,
    compute_flight_time,
    plan_stop,
)
from crazychoir.planning.trajectory import Trajectory
from crazychoir.platforms import Platform
from crazychoir.safety.rules.guard import FENCE_INSET, Fence
from crazychoir.types import FullState, State, Vec


@dataclass(frozen=True, slots=True)
class FlightPatience:
    """How much time a planned flight gets beyond the estimate, and how long it waits."""

    detour_factor: float = 2.0
    """Time for a robot that finds its own way to a pose, as a multiple of a straight drive."""
    parking_time: float = 4.0
    """Further seconds that such a robot gets to come to rest."""
    longest_wait: float = 60.0
    """Longest time in s that a plan waits for its drone while others keep the drone off the plan."""
    restart_wait: float = 1.5
    """Seconds that a plan waits before it begins anew."""


FLIGHT_PATIENCE = FlightPatience()


def compute_braking_limit(
    limits: FlightTable, platform: Platform, share: float
) -> float:
    """Return the acceleration in m/s2 with which a drone comes to rest from any direction.

    share: largest share of its thrust that acts upwards
    """
    # The acceleration that stops a fall.
    lift = share * platform.max_thrust / platform.mass - STANDARD_GRAVITY
    return min(limits.acceleration_limit, lift)


class PointFlights:
    """The planned flight, if there is one, and the start of new flights.

    limits: [flight]
    fence: where the drone flies, from the ground up at most
    a_max: m/s2, with which it brakes
    row: record of PLAN_ROW in the batch of the drone, None for a record of its own
    """

    def __init__(
        self,
        limits: FlightTable,
        fence: Fence,
        a_max: float,
        row: Record | None = None,
    ) -> None:
        self.limits = limits
        self.fence = fence
        self.a_max = a_max
        self._row: Record = np.zeros(1, PLAN_ROW)[0] if row is None else row
        self._plan: Trajectory | None = None
        self.descent: Descent = STRAIGHT_DOWN
        """How the drone lands, in its present or next landing."""
        self.lacks_set_point = False
        """Whether the plan in Python gave no finite set-point for this tick."""

    @property
    def plan(self) -> Trajectory | None:
        """The plan; None without one."""
        return self._plan if self._row["kind"] != NO_PLAN else None

    @property
    def start(self) -> float:
        """When the plan began, in s."""
        return float(self._row["start"])

    @property
    def waited(self) -> float:
        """Seconds that this plan has waited for its drone."""
        return float(self._row["waited"])

    def clear(self) -> None:
        """Remove the plan."""
        clear_plan(self._row)
        self._plan = None

    def load(self, now: float) -> None:
        """Write what the stages of the tick at `now`, in s, need of the plan into its record."""
        t = now - self.start
        plan = self._plan
        self.lacks_set_point = False
        if isinstance(plan, Piecewise) and type(plan).sample is Piecewise.sample:
            load_pieces(self._row, plan, t)
        elif plan is not None:
            self._load_sample(plan, t)
            self._row["is_over"] = plan.done(t)

    def _load_sample(self, plan: Trajectory, t: float) -> None:
        """Write the set-point of a plan in Python after t s; without one, that of the last tick at rest."""
        row = self._row
        sampled = to_floats(plan.sample(t).flat, (14,))
        if sampled is not None and np.isfinite(sampled).all():
            row["sampled"] = sampled
            return
        self.lacks_set_point = True
        row["sampled"][3:12] = 0.0
        row["sampled"][13] = 0.0

    def sample(self, now: float) -> FullState | None:
        """Return the set-point of the plan at the time `now` in s; None without a plan.

        A plan in Python that gives no finite one stays at that of the last tick.
        """
        plan = self.plan
        if plan is None:
            return None
        if self.lacks_set_point:
            return FullState(self._row["sampled"].copy())
        return plan.sample(now - self.start)

    def done(self, now: float, late: float = 0.0) -> bool:
        """Return whether the plan has been over for `late` s; False without a plan."""
        plan = self.plan
        return plan is not None and plan.done(now - self.start - late)

    def remaining(self, now: float) -> float:
        """Return s until the plan is over; 0 without a plan."""
        plan = self.plan
        if plan is None:
            return 0.0
        return max(0.0, self.start + plan.duration - now)

    def departure(self, state: State, now: float) -> FullState:
        """Return where a new plan begins: on the present plan, else at the state and its speed."""
        return self.sample(now) or FullState.at(state.p, state.v, yaw=yaw_of(state.q))

    def go_to(
        self, start: FullState, goal: Vec, yaw: float, duration: float, now: float
    ) -> float:
        """Fly to rest at a goal, in `duration` s or as fast as the limits allow.

        start: the first set-point
        goal: (3,) m, world
        yaw: rad, at the goal
        duration: s, used if it is longer than the fastest flight
        Returns s that the flight takes.
        """
        limits = self.limits
        fastest = compute_flight_time(
            start, goal, yaw, limits.speed_limit, limits.acceleration_limit
        )
        return self.fly(PointToPoint(start, goal, yaw, max(duration, fastest)), now)

    def drive_to(
        self, start: FullState, goal: Vec, yaw: float, duration: float, now: float
    ) -> float:
        """Reach a pose on a path that the robot finds itself; return the s that it gets for this.

        start: the first set-point
        goal: (3,) m, world
        yaw: rad, at the goal
        duration: s, used if it is longer than the estimate
        """
        v_max = self.limits.speed_limit
        a_max = self.limits.acceleration_limit
        fastest = compute_flight_time(
            FullState.at(start.p, yaw=start.yaw), goal, yaw, v_max, a_max
        )
        there = FullState.at(goal, yaw=yaw)
        return self.fly(
            PointToPoint(
                there,
                goal,
                yaw,
                max(
                    duration,
                    FLIGHT_PATIENCE.detour_factor * fastest
                    + FLIGHT_PATIENCE.parking_time,
                ),
            ),
            now,
        )

    def brake(self, start: FullState, now: float) -> float:
        """Come to rest inside the fence by the shortest path; return s that this takes."""
        return self.fly(FlightLegs(*self._stop(start, self.fence)), now)

    def descend(
        self,
        start: FullState,
        now: float,
        beside: Vec | None = None,
    ) -> float:
        """Come to rest, then fly straight down.

        start: the first set-point
        beside: (3,) m, world: fly there before coming down; None to come down from here
        Returns s until the drone counts as landed.
        """
        limits = self.limits
        descent = self.descent
        stop = self._stop(start, self.fence.with_floor(limits.ground - FENCE_INSET))
        if beside is not None:
            here = FullState.at(stop[-1].goal, yaw=start.yaw)
            duration = compute_flight_time(
                here, beside, start.yaw, limits.speed_limit, limits.acceleration_limit
            )
            stop = [*stop, PointToPoint(here, beside, start.yaw, duration)]
        above = FullState.at(stop[-1].goal, yaw=start.yaw)
        floor = stop[-1].goal.copy()
        floor[2] = limits.ground + descent.height - 0.05
        fastest = compute_flight_time(
            above, floor, start.yaw, limits.speed_limit, limits.acceleration_limit
        )
        slow = PEAK_SPEED * (above.p[2] - floor[2]) / limits.landing_speed
        down = PointToPoint(above, floor, start.yaw, max(slow, fastest))
        landing = Landing(*stop, down)
        touchdown = limits.ground + descent.height + TOUCHDOWN_LIMITS.floor_height
        stopping = landing.duration - down.duration
        descending = landing.reaches(touchdown) - stopping
        if 0.0 < descending < descent.duration:
            longer = down.duration * descent.duration / descending
            landing = Landing(*stop, PointToPoint(above, floor, start.yaw, longer))
        self.fly(landing, now)
        return landing.reaches(touchdown)

    def _stop(self, start: FullState, fence: Fence) -> list[PointToPoint]:
        """Return the flight to rest by the shortest path.

        If it ends outside the fence, a second flight leads from there to the nearest place inside.
        """
        stop = plan_stop(start, self.a_max)
        inside = fence.nearest(stop.goal)
        if np.array_equal(inside, stop.goal):
            return [stop]
        outside = FullState.at(stop.goal, yaw=start.yaw)
        duration = compute_flight_time(
            outside, inside, start.yaw, self.limits.speed_limit, self.a_max
        )
        return [stop, PointToPoint(outside, inside, start.yaw, duration)]

    def wait(self, seconds: float) -> bool:
        """Shift the plan by `seconds` s, later or earlier.

        Returns False if the plan has waited for FLIGHT_PATIENCE.longest_wait s and is to wait longer.
        """
        if seconds > 0.0 and self.waited >= FLIGHT_PATIENCE.longest_wait:
            return False
        self._row["start"] += seconds
        self._row["waited"] += seconds
        return True

    def stand(self, place: FullState) -> None:
        """Let the waiting plan stand at this set-point in this tick."""
        self._row["is_waiting"] = 1
        self._row["sampled"] = place.flat

    def resume(self, start: FullState, now: float) -> bool:
        """Continue to the goal of a point-to-point flight from a start off its path.

        The flight takes the time that is left if the limits allow it. A longer time counts as
        waiting.
        Returns False as `wait` does, for a plan that has not waited `restart_wait` s since it last began
        anew, and for other plans.
        """
        plan = self.plan
        left = self.remaining(now)
        waited = self.waited
        if (
            not isinstance(plan, PointToPoint)
            or waited >= FLIGHT_PATIENCE.longest_wait
            or waited - self._row["resumed"] < FLIGHT_PATIENCE.restart_wait
        ):
            return False
        yaw = plan.sample(plan.duration).yaw
        longer = self.go_to(start, plan.goal, yaw, left, now) - left
        self._row["waited"] = waited + longer
        self._row["resumed"] = waited + longer
        return True

    def fly(self, plan: Trajectory, now: float) -> float:
        """Begin this plan now; return s that it takes.

        Raises Refused if it has no finite set-point for its beginning.
        """
        self._plan = plan
        row = self._row
        row["kind"] = PlanKind.BY_HAND
        row["start"] = now
        row["waited"] = 0.0
        row["resumed"] = 0.0
        self.load(now)
        if self.lacks_set_point:
            self.clear()
            raise Refused("trajectory", "it must begin with finite numbers")
        return plan.duration
