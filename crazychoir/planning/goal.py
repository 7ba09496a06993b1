"""Flights to goals: up, down, to a place, and to lists of goals with times."""

from dataclasses import replace

import numpy as np
import numpy.typing as npt

from crazychoir.errors import ConfigError
from crazychoir.planning.feasibility import Limits, check_limits, sample_references
from crazychoir.planning.landing import Landing
from crazychoir.planning.piecewise import Piecewise, join_pieces
from crazychoir.planning.point_to_point import (
    PointToPoint,
    compute_flight_time,
    plan_stop,
)
from crazychoir.types import FullState, Vec

GOAL_LIMITS = Limits(v_max=1.0, a_max=2.0, yaw_rate_max=2.0)
"""Default limits."""


def goto(
    start: FullState,
    goal: Vec,
    yaw: float | None = None,
    duration: float = 0.0,
    limits: Limits = GOAL_LIMITS,
) -> PointToPoint:
    """Return the flight from any state to rest at a goal.

    It takes `duration` s, or longer if speed, acceleration and yaw rate need it.

    start: the state at the begin
    goal: (3,) m world
    yaw: rad, None to keep the heading
    duration: s
    limits: speed, acceleration, yaw rate and fence
    Raises ConfigError if the flight leaves the fence.
    """
    if np.shape(goal) != (3,):
        raise ConfigError("goto: goal", np.asarray(goal).tolist(), "three numbers, m")
    limits.check_places(np.array([goal]), "goto: goal")
    heading = start.yaw if yaw is None else yaw
    fastest = compute_flight_time(
        start, goal, heading, limits.v_max, limits.a_max, limits.yaw_rate_max
    )
    flight = PointToPoint(
        start, np.asarray(goal, dtype=float), heading, max(duration, fastest)
    )
    limits.check_places(sample_references(flight)[1][:, 0:3], "goto: set-point")
    return flight


def takeoff(
    start: FullState, height: float, duration: float = 0.0, limits: Limits = GOAL_LIMITS
) -> PointToPoint:
    """Return the flight straight up to rest at z = height m, world.

    Raises ConfigError unless the height is above the start.
    """
    if not height > start.p[2]:
        raise ConfigError(
            "takeoff: height",
            height,
            f"more than the height at the start, {start.p[2]:.3f} m",
        )
    return goto(start, np.array([*start.p[0:2], height]), None, duration, limits)


def land(
    start: FullState,
    ground: float = 0.0,
    speed: float = 0.3,
    limits: Limits = GOAL_LIMITS,
) -> Landing:
    """Return the flight from any state to rest, then straight down.

    start: the state at the begin
    ground: m, world: height of the end
    speed: m/s, largest descent speed
    limits: speed, acceleration, yaw rate and fence
    Raises ConfigError unless the ground is below the place at rest.
    """
    stop = plan_stop(start, limits.a_max)
    if not ground < stop.goal[2]:
        raise ConfigError(
            "land: ground",
            ground,
            f"less than the height at rest, {stop.goal[2]:.3f} m",
        )
    limits.check_places(sample_references(stop)[1][:, 0:3], "land: set-point")
    above = FullState.at(stop.goal, yaw=start.yaw)
    floor = np.array([*stop.goal[0:2], ground])
    return Landing(
        stop, goto(above, floor, limits=replace(limits, v_max=min(speed, limits.v_max)))
    )


def timed_goals(
    start: FullState, goals: npt.ArrayLike, limits: Limits = GOAL_LIMITS
) -> Piecewise:
    """Return the flight from `start` at t = 0 to each goal in turn, at rest there at its time.

    start: the state at t = 0
    goals: (k, 5) rows t s, x, y, z m world, yaw rad; the times increase. A first row at t = 0 is
        the place of the start.
    limits: of the flight
    Raises ConfigError, with the row, for times that do not increase, numbers that are not finite, a
    goal outside of the fence, or a goal too far for its time.
    """
    rows = _check_goals(goals)
    limits.check_places(rows[:, 1:4], "goals")
    legs = []
    here = start
    before = 0.0
    for k, (t, x, y, z, yaw) in enumerate(rows.tolist()):
        if k == 0 and t == 0.0:
            _check_start(start, rows[0, 1:4])
            continue
        leg = PointToPoint(here, np.array([x, y, z]), yaw, t - before)
        try:
            check_limits(leg, limits)
        except ConfigError as error:
            raise ConfigError(
                f"goals[{k}]: {error.where}", str(error.found), error.allowed, error.do
            ) from error
        legs.append(leg)
        here = leg.sample(leg.duration)
        before = t
    return join_pieces(legs)


def _check_goals(goals: npt.ArrayLike) -> npt.NDArray[np.float64]:
    """Return the goals as rows; raise ConfigError for wrong ones."""
    rows = np.asarray(goals, dtype=float)
    if rows.ndim != 2 or rows.shape[1] != 5 or len(rows) == 0:
        raise ConfigError(
            "goals", f"shape {rows.shape}", "(k, 5): rows of t, x, y, z, yaw"
        )
    finite = np.isfinite(rows).all(axis=1)
    if not finite.all():
        raise ConfigError(
            f"goals[{int(np.argmin(finite))}]",
            rows[int(np.argmin(finite))].tolist(),
            "finite numbers",
        )
    increasing = np.diff(rows[:, 0], prepend=0.0) > 0.0
    increasing[0] |= rows[0, 0] == 0.0 and len(rows) > 1
    if not increasing.all():
        k = int(np.argmin(increasing))
        raise ConfigError(
            f"goals[{k}]: t", float(rows[k, 0]), "more than the time before, from 0 on"
        )
    return rows


def _check_start(start: FullState, first: Vec) -> None:
    """Raise ConfigError if the first goal is not the place of the start."""
    if np.linalg.norm(start.p - first) > 0.05:
        raise ConfigError(
            "goals[0]: at t = 0",
            first.tolist(),
            f"the place of the start, {start.p.round(3).tolist()}",
            "Give the first goal the time that the way there needs.",
        )
