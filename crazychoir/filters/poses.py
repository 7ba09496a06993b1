"""Poses of motion capture: which of them are readable, and when they were measured."""

import math
from typing import NamedTuple

from crazychoir.numerics.kernels import kernel, vector
from crazychoir.types import Vec


class PoseTiming(NamedTuple):
    """How the times of poses follow the steady rate of the cameras."""

    same_pose_time: float = 1e-6
    """s, least time by which a new pose is newer than the last pose."""
    seen_time_weight: float = 0.002
    """Weight of the arrival in the time of a measurement; the rest comes from the rate of the
    cameras.
    """
    rounding: float = 1e-9
    """s, differences below it are rounding."""
    early_share: float = 0.25
    """Share of a period by which a pose may seem early; by the rest of the period it may seem
    late.
    """
    least_period_share: float = 0.2
    """Least share of a period between two poses that are on time.

    Poses that come sooner were late and arrive together, for example after the program stood still.
    Their delays are unknown, but the cameras saw them one period apart. With the times of arrival, a
    drone at 1 m/s would seem to fly at 50 m/s.
    """


POSE_TIMING = PoseTiming()


@kernel(vector)
def is_readable(pose: Vec) -> bool:
    """Return whether a pose (7,) is finite and its quaternion needs no more than normalising."""
    for c in range(7):
        if not math.isfinite(pose[c]):
            return False
    squared = pose[3] ** 2 + pose[4] ** 2 + pose[5] ** 2 + pose[6] ** 2
    return bool(0.25 <= squared <= 4.0)


@kernel()
def time_pose(age: float, h: float, period: float) -> tuple[float, float, bool]:
    """Return when a pose was measured, by the rate of the cameras.

    age: s since the pose was measured, by its arrival
    h: s since the pose before, by its arrival
    period: s, between two poses of the cameras; 0 if they have no steady rate
    Returns age in s, h in s, and whether the pose arrived together with the pose before.
    """
    if not period > 0.0:
        return age, h, False
    whole = period * int(h / period + POSE_TIMING.early_share)
    late = h - whole
    if whole > 0.0 and abs(late) > POSE_TIMING.rounding:
        late = (1.0 - POSE_TIMING.seen_time_weight) * late
        age = age + late
        h = h - late
    if h < POSE_TIMING.least_period_share * period:
        return age, period, True
    return age, h, False
