"""The interface of all references over time, and their set-points."""

import math
from typing import Protocol

import numpy as np

from crazychoir.errors import ConfigError
from crazychoir.planning.piecewise import Piecewise
from crazychoir.types import FullState, Mat, Vec

MOST_SETPOINTS = 1_000_000
"""Largest number of set-points of one trajectory; a larger rate or duration is a mistake."""


class Trajectory(Protocol):
    """A reference over time, with t = 0 at its start.

    Before, it stands at its start; after the end, at its last place.
    """

    @property
    def duration(self) -> float:
        """s."""
        ...

    def sample(self, t: float) -> FullState:
        """Return the reference t seconds after the start."""
        ...

    def done(self, t: float) -> bool:
        """Return whether the end is reached at t."""
        ...


def compute_instants(duration: float, rate: float) -> Vec:
    """Return t_k = k / rate from 0 to the duration, and the duration itself.

    duration: s
    rate: Hz
    Raises ConfigError for a rate that is not positive, or too many set-points.
    """
    if not (math.isfinite(rate) and rate > 0.0):
        raise ConfigError("set-points: rate", rate, "a positive number of hertz")
    if duration * rate > MOST_SETPOINTS:
        raise ConfigError(
            "set-points: number",
            duration * rate,
            f"at most {MOST_SETPOINTS}",
            "Lower the rate.",
        )
    t = np.arange(math.ceil(duration * rate - 1e-9)) / rate
    return np.append(t, duration)


def sample_setpoints(trajectory: Trajectory, rate: float) -> tuple[Vec, Mat]:
    """Return the set-points of a trajectory.

    rate: Hz; the end is a further set-point
    Returns times (n,) s and references (n, 14), rows as FullState.flat.
    Raises ConfigError if a sample is not a FullState of 14 numbers, or as `compute_instants`.
    """
    t = compute_instants(trajectory.duration, rate)
    if isinstance(trajectory, Piecewise):
        return t, trajectory.samples(t)
    rows = [trajectory.sample(k).flat for k in t.tolist()]
    try:
        found = np.array(rows, dtype=float)
    except ValueError:  # rows of several lengths
        found = np.empty(0)
    if found.shape == (len(t), 14):
        return t, found
    wrong = next(k for k, row in enumerate(rows) if np.shape(row) != (14,))
    raise ConfigError(
        f"trajectory: sample({t[wrong]:.2f})",
        f"a FullState of shape {np.shape(rows[wrong])}",
        "a FullState of 14 numbers",
    )
