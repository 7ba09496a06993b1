"""The flights that a pilot plans itself: to a place, to rest, down; inside the fence and the limits of [flight]."""

import numpy as np

from crazychoir.config.tables import Flight
from crazychoir.flight.goals import require_setpoint
from crazychoir.numerics.math3d import GRAVITY, yaw_of
from crazychoir.planning.landing import Landing, Legs
from crazychoir.planning.point_to_point import (
    PEAK_SPEED,
    PointToPoint,
    duration_for,
    stopping,
)
from crazychoir.planning.trajectory import Trajectory
from crazychoir.platforms import Platform
from crazychoir.safety.rules.guard import INSET, Fence
from crazychoir.types import FullState, State, Vec

DETOUR, PARKING = 2.0, 4.0
"""A robot that finds its own way to a pose is given so many times what a straight one takes, and s to come to rest."""
LONGEST_WAIT, IN_VAIN = 60.0, 1.5
"""s that a plan waits for a drone that others keep off it, and before it begins anew."""


def braking(limits: Flight, platform: Platform, share: float) -> float:
    """m/s2, with which a drone comes to rest from any direction; share: of its thrust that goes upwards at most."""
    lift = (
        share * platform.max_thrust / platform.mass - GRAVITY
    )  # with which a fall is stopped
    return min(limits.acceleration_limit, lift)


class Flights:
    """The flight that is planned, if any, and how a new one begins.

    fence: where it flies, from the ground up at most;  a_max: m/s2, with which it brakes.
    """

    def __init__(self, limits: Flight, fence: Fence, a_max: float) -> None:
        self.limits = limits
        self.fence = fence
        self.a_max = a_max
        self.plan: Trajectory | None = None
        self.start = 0.0
        self.waited = 0.0
        """s that this plan has waited for its drone."""
        self._resumed = 0.0  # s that it had waited when it was begun anew the last time

    def clear(self) -> None:
        """Nothing is planned."""
        self.plan = None

    def sample(self, now: float) -> FullState | None:
        """The reference of the plan."""
        if self.plan is None:
            return None
        t = now - self.start
        return require_setpoint(self.plan.sample(t), t)

    def done(self, now: float, late: float = 0.0) -> bool:
        """Is the plan, if any, over, and has been for `late` s?"""
        return self.plan is not None and self.plan.done(now - self.start - late)

    def remaining(self, now: float) -> float:
        """s until the plan is over."""
        return (
            0.0
            if self.plan is None
            else max(0.0, self.start + self.plan.duration - now)
        )

    def departure(self, state: State, now: float) -> FullState:
        """Where a new plan begins: on the plan that is flown, else at the state, with the speed it has."""
        return self.sample(now) or FullState.at(state.p, state.v, yaw=yaw_of(state.q))

    def go_to(
        self, start: FullState, goal: Vec, yaw: float, duration: float, now: float
    ) -> float:
        """Fly to rest at goal (3,) m, in `duration` s or as fast as the limits allow; returns the time it takes."""
        limits = self.limits
        fastest = duration_for(
            start, goal, yaw, limits.speed_limit, limits.acceleration_limit
        )
        return self.fly(PointToPoint(start, goal, yaw, max(duration, fastest)), now)

    def drive_to(
        self, start: FullState, goal: Vec, yaw: float, duration: float, now: float
    ) -> float:
        """Be at a pose, on a way that the robot finds; returns the time that it is given for that."""
        v_max = self.limits.speed_limit
        a_max = self.limits.acceleration_limit
        fastest = duration_for(
            FullState.at(start.p, yaw=start.yaw), goal, yaw, v_max, a_max
        )
        there = FullState.at(goal, yaw=yaw)
        return self.fly(
            PointToPoint(there, goal, yaw, max(duration, DETOUR * fastest + PARKING)),
            now,
        )

    def brake(self, start: FullState, now: float) -> float:
        """Come to rest, the shortest way, and inside the fence."""
        return self.fly(Legs(*self._stop(start, self.fence)), now)

    def descend(
        self, start: FullState, now: float, touchdown: float, beside: Vec | None = None
    ) -> float:
        """Come to rest, then straight down; returns s until it is at the height `touchdown` m.

        beside: (3,) m, where it first flies, to come down there.
        """
        limits = self.limits
        stop = self._stop(start, self.fence.with_floor(limits.ground - INSET))
        if beside is not None:
            here = FullState.at(stop[-1].goal, yaw=start.yaw)
            duration = duration_for(
                here, beside, start.yaw, limits.speed_limit, limits.acceleration_limit
            )
            stop = [*stop, PointToPoint(here, beside, start.yaw, duration)]
        above = FullState.at(stop[-1].goal, yaw=start.yaw)
        floor = stop[-1].goal.copy()
        floor[2] = limits.ground - 0.05
        fastest = duration_for(
            above, floor, start.yaw, limits.speed_limit, limits.acceleration_limit
        )
        slow = PEAK_SPEED * (above.p[2] - floor[2]) / limits.landing_speed
        landing = Landing(
            *stop, PointToPoint(above, floor, start.yaw, max(slow, fastest))
        )
        self.fly(landing, now)
        return landing.reaches(touchdown)

    def _stop(self, start: FullState, fence: Fence) -> list[PointToPoint]:
        """To rest, the shortest way; where that ends outside a fence, from there to the nearest place inside."""
        stop = stopping(start, self.a_max)
        inside = fence.nearest(stop.goal)
        if np.array_equal(inside, stop.goal):
            return [stop]
        outside = FullState.at(stop.goal, yaw=start.yaw)
        duration = duration_for(
            outside, inside, start.yaw, self.limits.speed_limit, self.a_max
        )
        return [stop, PointToPoint(outside, inside, start.yaw, duration)]

    def wait(self, seconds: float) -> bool:
        """The plan goes on so much later, or earlier; False if it has waited for LONGEST_WAIT s and is to wait more."""
        if seconds > 0.0 and self.waited >= LONGEST_WAIT:
            return False
        self.start += seconds
        self.waited += seconds
        return True

    def resume(self, start: FullState, now: float) -> bool:
        """Go on to the place where a flight to one leads, in the time that is left if the limits allow it, from a start
        off its way; the time that this costs counts as waiting. False as in `wait`, and for other plans.
        """
        plan = self.plan
        left = self.remaining(now)
        waited = self.waited
        if (
            not isinstance(plan, PointToPoint)
            or waited >= LONGEST_WAIT
            or waited - self._resumed < IN_VAIN
        ):
            return False
        yaw = plan.sample(plan.duration).yaw
        self.waited = self._resumed = (
            waited + self.go_to(start, plan.goal, yaw, left, now) - left
        )
        return True

    def fly(self, plan: Trajectory, now: float) -> float:
        """Begin this one; returns the time it takes."""
        self.plan = plan
        self.start = now
        self.waited = 0.0
        self._resumed = 0.0
        return plan.duration
