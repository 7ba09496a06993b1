"""Changes of the time of a trajectory: slower, within limits, or resumed after a stop."""

import math

import numpy as np

from crazychoir.errors import ConfigError
from crazychoir.numerics.math3d import STANDARD_GRAVITY
from crazychoir.planning.feasibility import (
    THRUST_COLUMN,
    Limits,
    compute_demands,
    sample_references,
)
from crazychoir.planning.piecewise import Piecewise
from crazychoir.planning.trajectory import Trajectory
from crazychoir.types import FullState, Mat, Vec

LARGEST_SLOWDOWN = 1e4
"""Largest factor of the time: a path that breaks the limits then always does."""
PICK_UP_TIME = 2.0  # s, in which a path that was stopped gets its own pace again
LIMIT_HEADROOM = 1e-3
"""Share of each limit that is left for the times between two checks."""


def _slow_down_references(references: Mat, factor: float) -> Mat:
    """Return the references (n, 14) of the path in `factor` times the time."""
    powers = factor ** -np.array(
        [*[0.0] * 3, *[1.0] * 3, *[2.0] * 3, *[3.0] * 3, 0.0, 1.0]
    )
    return np.asarray(references * powers)


class SlowedTrajectory:
    """A trajectory in `factor` times the time.

        q(t) = p(t / k),  q' = p' / k,  q'' = p'' / k^2,  q''' = p''' / k^3

    Raises ConfigError for a factor that is not positive.
    """

    def __init__(self, trajectory: Trajectory, factor: float) -> None:
        if not (math.isfinite(factor) and factor > 0.0):
            raise ConfigError("Slowed: factor", factor, "a positive number")
        self.trajectory = trajectory
        self.factor = float(factor)
        self.duration = factor * trajectory.duration

    def sample(self, t: float) -> FullState:
        """Return the reference t seconds after the start."""
        return FullState(
            _slow_down_references(
                self.trajectory.sample(t / self.factor).flat, self.factor
            )
        )

    def done(self, t: float) -> bool:
        """Return whether the end is reached at t."""
        return t >= self.duration


def compute_slowdown(trajectory: Trajectory, limits: Limits) -> float:
    """Return the smallest k such that the path in k times the time keeps the limits, to 1e-4.

    Below 1 there is time to spare.
    Raises ConfigError if the path leaves the fence, which no time changes, or if no k to 10 000 is
    enough.
    """
    _, x = sample_references(trajectory)
    limits.check_places(x[:, 0:3], "trajectory: set-point")
    largest = _subtract_headroom(limits)

    def keeps(k: float) -> bool:
        return bool(
            np.all(compute_demands(_slow_down_references(x, k), limits.mass) <= largest)
        )

    fast = 1.0 / LARGEST_SLOWDOWN
    slow = LARGEST_SLOWDOWN
    if not keeps(slow):
        raise ConfigError(
            "trajectory: scaling",
            f"{LARGEST_SLOWDOWN:g} times as slow",
            "limits that it keeps at some speed",
        )
    while slow / fast > 1.0 + 1e-4:
        middle = math.sqrt(fast * slow)
        fast, slow = (fast, middle) if keeps(middle) else (middle, slow)
    return slow


def _subtract_headroom(limits: Limits) -> Vec:
    """Return (9,): what the checked times may demand.

    Of the thrust, the headroom is a share of the part above the weight.
    """
    largest = limits.largest * (1.0 - LIMIT_HEADROOM)
    weight = limits.mass * STANDARD_GRAVITY
    largest[THRUST_COLUMN] = weight + (limits.thrust_max - weight) * (
        1.0 - LIMIT_HEADROOM
    )
    return largest


def fit_to_limits(trajectory: Trajectory, limits: Limits) -> Trajectory:
    """Return the trajectory, slowed down as little as the limits need; itself if it keeps them.

    A trajectory that starts or ends moving then does so more slowly. If that is not allowed, plan
    it anew with more time.
    """
    k = max(1.0, compute_slowdown(trajectory, limits))
    return trajectory if k == 1.0 else slow_down(trajectory, k)


def slow_down(trajectory: Trajectory, factor: float) -> Trajectory:
    """Return the trajectory in `factor` times the time; pieces stay pieces."""
    return (
        trajectory.slowed(factor)
        if isinstance(trajectory, Piecewise)
        else SlowedTrajectory(trajectory, factor)
    )


class ResumedTrajectory:
    """The rest of a trajectory from t_0 s on, entered from rest.

        q(t) = p(tau),  q' = p' tau',  q'' = p'' tau'^2 + p' tau''
        jerk: j tau'^3 + 3 p'' tau' tau'' + p' d tau''/dt
        tau = t_0 + R (u^3 - u^4 / 2),  u = t / R, for t < R
        tau = t_0 + t - R / 2 from then on

    Within R it gets the pace of the trajectory. With R >= 4 v / a it demands 1.1 a at most; v and a
    are those of the trajectory. Near the end of the trajectory, t_0 is a little earlier.

    trajectory: the trajectory
    t_0: s
    gets_up: s, R
    Raises ConfigError for a t_0 outside the trajectory.
    """

    def __init__(
        self, trajectory: Trajectory, t_0: float, gets_up: float = PICK_UP_TIME
    ) -> None:
        whole = trajectory.duration
        if not 0.0 <= t_0 < whole:
            raise ConfigError(
                "Resumed: t_0", t_0, f"a time before the end at {whole:g} s"
            )
        self.trajectory = trajectory
        self._gets_up = min(gets_up, 2.0 * whole)
        self.t_0 = min(float(t_0), whole - 0.5 * self._gets_up)
        self.duration = whole - self.t_0 + 0.5 * self._gets_up

    def sample(self, t: float) -> FullState:
        """Return the reference t seconds after the start."""
        gets_up = self._gets_up
        u = min(max(t / gets_up, 0.0), 1.0)
        tau = self.t_0 + gets_up * u**3 * (1.0 - 0.5 * u) + max(t - gets_up, 0.0)
        x = self.trajectory.sample(tau).flat
        if u == 1.0:
            return FullState(x)
        d_1 = u * u * (3.0 - 2.0 * u)
        d_2 = 6.0 * u * (1.0 - u) / gets_up
        d_3 = (6.0 - 12.0 * u) / gets_up**2
        p = x[0:3]
        v = x[3:6]
        a = x[6:9]
        j = x[9:12]
        jerk = j * d_1**3 + 3.0 * a * d_1 * d_2 + v * d_3
        return FullState(
            np.array([*p, *v * d_1, *a * d_1**2 + v * d_2, *jerk, x[12], x[13] * d_1])
        )

    def done(self, t: float) -> bool:
        """Return whether the end is reached at t."""
        return t >= self.duration
