"""New plans in flight: on from any state, without a jump."""

import numpy as np

from crazychoir.errors import ConfigError
from crazychoir.numerics.math3d import wrap_angle
from crazychoir.planning.feasibility import (
    FEASIBILITY_CHECK,
    Limits,
    compute_demands,
    sample_references,
)
from crazychoir.planning.point_to_point import SHORTEST_FLIGHT
from crazychoir.planning.polynomial import Polynomial7th
from crazychoir.planning.trajectory import Trajectory
from crazychoir.types import FullState

DURATION_GROWTH = 1.05
"""Ratio of successive durations that are tried."""
DURATION_TRIALS = 150
"""Number of durations that are tried: from 0.1 s to 2.5 minutes."""


class JoinedTrajectory:
    """A path onto a trajectory, then the rest of the trajectory.

    p, v, a and j are continuous where the path meets the trajectory. The yaw goes on without a
    turn.

    way: the path
    trajectory: the trajectory
    at: s after its start, where the path meets it
    """

    def __init__(self, way: Polynomial7th, trajectory: Trajectory, at: float) -> None:
        self.way = way
        self.trajectory = trajectory
        self.at = at
        self.duration = way.duration + max(trajectory.duration - at, 0.0)
        end = way.sample(way.duration).yaw
        there = trajectory.sample(at).yaw
        self._turns = end - there - wrap_angle(end - there)

    def sample(self, t: float) -> FullState:
        """Return the reference t seconds after the start."""
        if t < self.way.duration:
            return self.way.sample(t)
        flat = self.trajectory.sample(t - self.way.duration + self.at).flat.copy()
        flat[12] += self._turns
        return FullState(flat)

    def done(self, t: float) -> bool:
        """Return whether the end is reached at t."""
        return t >= self.duration


def join_trajectory(
    start: FullState,
    trajectory: Trajectory,
    now: float,
    limits: Limits,
    duration: float | None = None,
) -> JoinedTrajectory:
    """Return the flight onto a running trajectory.

        p(t) = polynomial of degree 7 from `start` to trajectory(now + T), t < T
        trajectory(now + t), t >= T

    T s later the drone is where it would have been on the trajectory.

    start: where the drone is, with its v, a and, if known, j
    trajectory: the trajectory
    now: s after its start
    limits: of the path
    duration: T s. None for the first of a series that grows by 5 % from 0.1 s with which the path
        keeps the limits, or exceeds them by no more than its ends do.
    Raises ConfigError if there is no such T, or if the given one breaks the limits.
    """
    durations = (
        [duration]
        if duration is not None
        else [SHORTEST_FLIGHT * DURATION_GROWTH**n for n in range(DURATION_TRIALS)]
    )
    for seconds in durations:
        way = Polynomial7th(start, trajectory.sample(now + seconds), seconds)
        if _is_way_within_limits(way, limits):
            return JoinedTrajectory(way, trajectory, now + seconds)
    tried = (
        f"{durations[0]:g} s"
        if duration is not None
        else f"{durations[0]:g} to {durations[-1]:.0f} s"
    )
    raise ConfigError(
        "join: duration",
        tried,
        "a time in which the way keeps the limits",
        "Give more time, wider limits or a wider fence, or stop first.",
    )


def _is_way_within_limits(way: Polynomial7th, limits: Limits) -> bool:
    """Return whether the path keeps the limits, or the demands of its two ends."""
    _, x = sample_references(way)
    asked = compute_demands(x, limits.mass)
    allowed = np.maximum(limits.largest, np.maximum(asked[0], asked[-1])) * (
        1.0 + FEASIBILITY_CHECK.tolerance
    )
    places = x[:, 0:3]
    ends = x[[0, -1], 0:3]
    low = np.minimum(limits.low, ends.min(axis=0))
    high = np.maximum(limits.high, ends.max(axis=0))
    return bool(np.all((places >= low) & (places <= high)) and np.all(asked <= allowed))
