"""The law of VelocityFilter, on the record of one drone."""

import math

from crazychoir.filters.motion import advance_flight, coast, compute_speed
from crazychoir.filters.poses import POSE_TIMING, is_readable, time_pose
from crazychoir.filters.rows import FilterRow
from crazychoir.numerics.kernels import kernel
from crazychoir.numerics.math3d import (
    normalize_quaternion,
    quaternion_conjugate,
    quaternion_product,
    rotation_logarithm,
)


@kernel()
def _start_at_rest(row: FilterRow, now: float) -> None:
    """Start from the pose, which is readable, at rest.

    row: record of the filter
    now: s
    """
    pose = row.pose[:]
    x = row.measured_state[:]
    x[0:3] = pose[0:3]
    x[6], x[7], x[8], x[9] = normalize_quaternion((pose[3], pose[4], pose[5], pose[6]))
    row.measured = now - row.pose_age
    row.state[:] = x
    row.age = row.pose_age
    row.is_known = 1


@kernel()
def _differentiate_pose(row: FilterRow, h: float) -> None:
    """Take a readable pose into the state at the last measurement.

    row: record of the filter
    h: s since the pose before
    """
    pose = row.pose[:]
    x = row.measured_state[:]
    keep = math.exp(-row.cutoff * h)
    gain = (1.0 - keep) / h
    q = normalize_quaternion((pose[3], pose[4], pose[5], pose[6]))
    turn = rotation_logarithm(
        quaternion_product(quaternion_conjugate((x[6], x[7], x[8], x[9])), q)
    )
    for c in range(3):
        x[3 + c] = keep * x[3 + c] + gain * (pose[c] - x[c])
        x[10 + c] = keep * x[10 + c] + gain * turn[c]
        x[c] = pose[c]
    x[6], x[7], x[8], x[9] = q


@kernel()
def _take_in_pose(row: FilterRow, now: float) -> bool:
    """Take in the new pose, and return whether the state of the record is then that of `now`.

    Otherwise the state is older and is to be predicted, as without a new pose.

    row: record of the filter
    now: s
    """
    if not math.isfinite(row.pose_age):
        row.refused += 1
        return False
    h = now - row.pose_age - row.measured
    if h <= POSE_TIMING.same_pose_time:  # a repeated or an older pose says nothing new
        return False
    if not is_readable(row.pose[:]):
        row.refused += 1
        return False
    if row.is_known == 0:
        _start_at_rest(row, now)
        return False
    age, h, _ = time_pose(row.pose_age, h, row.period)
    _differentiate_pose(row, h)
    row.state[:] = row.measured_state[:]
    coast(row.state[:], min(age, row.horizon))
    row.measured = now - age
    row.age = age
    row.speed = compute_speed(row.state[:])
    return True


@kernel()
def _predict_state(row: FilterRow, now: float) -> None:
    """Advance the state of the record to `now` s, at most to the horizon."""
    age = now - row.measured
    further = max(min(age, row.horizon) - min(row.age, row.horizon), 0.0)
    if row.knows_commands > 0:
        advance_flight(
            row.state[:],
            row.command[:],
            row.platform[:],
            row.floor_height,
            row.rate_lag,
            (0.0, 0.0, 0.0),
            further,
        )
    else:
        coast(row.state[:], further)
    row.age = age
    row.speed = compute_speed(row.state[:])


@kernel()
def estimate_derivative_row(row: FilterRow, now: float) -> None:
    """Bring the state of a record to `now` by the law of VelocityFilter, with a new pose or without.

    row: record of the filter
    now: s
    """
    is_done = row.has_pose > 0 and _take_in_pose(row, now)
    if not is_done and row.is_known > 0:
        _predict_state(row, now)
