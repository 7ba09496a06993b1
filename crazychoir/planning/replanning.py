"""New plans in flight: on from any state, without a jump."""

import numpy as np

from crazychoir.errors import ConfigError
from crazychoir.numerics.math3d import wrap
from crazychoir.planning.feasibility import TOLERANCE, Limits, demands, references
from crazychoir.planning.point_to_point import SHORTEST
from crazychoir.planning.polynomial import Polynomial7th
from crazychoir.planning.trajectory import Trajectory
from crazychoir.types import FullState

GROWTH, TRIES = 1.05, 150  # of the durations that are tried: 0.1 s to 2.5 minutes


class Joined:
    """A way onto a trajectory, then what is left of it, from `at` s after its start; the yaw goes on without a turn.

    p, v, a and j are continuous where the way ends in the trajectory's state at `at`.
    """

    def __init__(self, way: Polynomial7th, trajectory: Trajectory, at: float) -> None:
        self.way = way
        self.trajectory = trajectory
        self.at = at
        self.duration = way.duration + max(trajectory.duration - at, 0.0)
        end = way.sample(way.duration).yaw
        there = trajectory.sample(at).yaw
        self._turns = end - there - wrap(end - there)

    def sample(self, t: float) -> FullState:
        """The reference t seconds after the start."""
        if t < self.way.duration:
            return self.way.sample(t)
        flat = self.trajectory.sample(t - self.way.duration + self.at).flat.copy()
        flat[12] += self._turns
        return FullState(flat)

    def done(self, t: float) -> bool:
        """Is the end reached at t?"""
        return t >= self.duration


def join(
    start: FullState,
    trajectory: Trajectory,
    now: float,
    limits: Limits,
    duration: float | None = None,
) -> Joined:
    """Onto a running trajectory, `now` s after its start: T s later the drone is where it would have been anyhow.

        p(t) = polynomial of degree 7 from `start` to trajectory(now + T), t < T;  trajectory(now + t), t >= T

    start: where the drone is, with its v, a and, where it is known, j;  duration: T s; without it the first of a row
    that grows by 5 % from 0.1 s with which the way keeps the limits, or exceeds them by no more than its ends do.
    Errors: ConfigError where no such T is found, or the given one breaks the limits.
    """
    durations = (
        [duration]
        if duration is not None
        else [SHORTEST * GROWTH**n for n in range(TRIES)]
    )
    for seconds in durations:
        way = Polynomial7th(start, trajectory.sample(now + seconds), seconds)
        if _keeps(way, limits):
            return Joined(way, trajectory, now + seconds)
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


def _keeps(way: Polynomial7th, limits: Limits) -> bool:
    """Whether the way keeps the limits, or what its two ends ask for."""
    _, x = references(way)
    asked = demands(x, limits.mass)
    allowed = np.maximum(limits.largest, np.maximum(asked[0], asked[-1])) * (
        1.0 + TOLERANCE
    )
    places = x[:, 0:3]
    ends = x[[0, -1], 0:3]
    low = np.minimum(limits.low, ends.min(axis=0))
    high = np.maximum(limits.high, ends.max(axis=0))
    return bool(np.all((places >= low) & (places <= high)) and np.all(asked <= allowed))
