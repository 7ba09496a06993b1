"""Estimate the mounting of a tracked body, from its pose at rest and while the drone turns.

No I/O: the functions take poses (k, 7) of the body as tracked, and return estimates. The mounting
is that of
mocap/mounting.py: q_b = q q_m, p_b = p + R(q) o.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from crazychoir.errors import ConfigError
from crazychoir.mocap.mounting import quaternion_of_rpy
from crazychoir.numerics.math3d import (
    quaternion_conjugate,
    quaternion_product,
    rotation,
    rotation_logarithm,
)
from crazychoir.types import Mat, Vec


@dataclass(frozen=True, slots=True)
class CalibrationLimits:
    """What the poses of a calibration must satisfy."""

    rest_distance: float = 0.01
    """m: a body that moves by more is not at rest."""
    rest_angle: float = math.radians(1.0)
    """rad: a body that turns by more is not at rest."""
    least_turn: float = math.radians(180.0)
    """rad: least turn of the drone; with less, its offset cannot be separated from its position.
    """
    least_poses: int = 20
    """Least number of poses."""


CALIBRATION_LIMITS = CalibrationLimits()


@dataclass(frozen=True)
class RestEstimate:
    """The estimate from a drone at rest."""

    rotation: tuple[float, float, float]
    """Roll, pitch, yaw in rad of the body on the drone."""
    height: float
    """m: height of the tracked centre above the drone's centre."""
    spread: float
    """m: standard deviation of the position."""
    poses: int
    """Number of poses."""


@dataclass(frozen=True)
class TurnEstimate:
    """The estimate from a turn of the drone."""

    offset: tuple[float, float, float]
    """(3,) m, drone's axes: position of the tracked centre."""
    deviation: float
    """m: root mean square residual of the fit, per axis."""
    error: float
    """m: standard error of the horizontal offset."""
    angle: float
    """rad: angle by which the drone has turned."""


def mean_attitude(q: Mat) -> Vec:
    """Return the unit quaternion (4,) nearest to all of q (k, 4).

        max_x  sum (x . q_i)^2,  |x| = 1

    The solution is the eigenvector of sum q q^T with the largest eigenvalue. The signs of the q_i
    do not matter.

    Source: Markley et al. 2007, J. Guidance 30(4).
    """
    _, vectors = np.linalg.eigh(q.T @ q)
    x: Vec = vectors[:, -1]
    return x if x[3] >= 0.0 else -x


def roll_pitch_yaw_of(q: Vec) -> tuple[float, float, float]:
    """Return roll, pitch, yaw in rad of R(q) = Rz(yaw) Ry(pitch) Rx(roll)."""
    r = rotation(q)
    pitch = math.asin(max(-1.0, min(1.0, -float(r[2, 0]))))
    return math.atan2(r[2, 1], r[2, 2]), pitch, math.atan2(r[1, 0], r[0, 0])


def estimate_from_rest(
    poses: Mat, home_z: float, heading: float | None = None, yaw: float = 0.0
) -> RestEstimate:
    """Return rotation and height of a body while its drone stands level.

        R(q_b) = Rz(psi) R(q_m):  roll and pitch of q_b are those of q_m
        yaw of q_m = yaw of q_b - psi

    poses: (k, 7), as tracked
    home_z: m: height of the drone's centre
    heading: rad: psi, the drone's heading; None if unknown: the yaw stays as it is
    yaw: rad: yaw of q_m if the heading is unknown
    Raises ConfigError if the body was not at rest, or there are too few poses.
    """
    _require_enough_poses(poses)
    q = mean_attitude(poses[:, 3:7])
    p = poses[:, 0:3].mean(axis=0)
    far = float(np.linalg.norm(poses[:, 0:3] - p, axis=1).max())
    swing = max(
        float(
            np.linalg.norm(
                rotation_logarithm(
                    quaternion_product(quaternion_conjugate(tuple(q)), tuple(one))
                )
            )
        )
        for one in poses[:, 3:7]
    )
    if far > CALIBRATION_LIMITS.rest_distance or swing > CALIBRATION_LIMITS.rest_angle:
        found = f"it moved by {far:.3f} m and {math.degrees(swing):.1f} deg"
        raise ConfigError(
            "calibration at rest",
            found,
            f"{CALIBRATION_LIMITS.rest_distance} m and 1 deg at most",
            "Put it down, and leave it.",
        )
    roll, pitch, about = roll_pitch_yaw_of(q)
    spread = float(np.sqrt(poses[:, 0:3].var(axis=0).sum()))
    turn = yaw if heading is None else math.remainder(about - heading, 2.0 * math.pi)
    return RestEstimate((roll, pitch, turn), float(p[2]) - home_z, spread, len(poses))


def estimate_from_turn(
    times: Vec, poses: Mat, mounted: Sequence[float], height: float
) -> TurnEstimate:
    """Return the offset of the tracked centre, from a turn of the drone.

    The drone turns about its own centre, which may drift slowly.

        p_b,k = c + d t_k + R_k o,   R_k = R(q_b,k q_m^-1),   o = (o_x, o_y, height)

    The equation is solved for c (3,), d (3,), o_x and o_y by least squares. A turn about one axis
    cannot separate the height from c, so the height is given.

    times: (k,) s: t_k
    poses: (k, 7), as tracked
    mounted: rad: roll, pitch, yaw of q_m
    height: m: o_z
    Raises ConfigError if the turn is less than half a turn, or there are too few poses.
    """
    _require_enough_poses(poses)
    drone = np.array(
        [
            quaternion_product(
                tuple(q), quaternion_conjugate(tuple(quaternion_of_rpy(mounted)))
            )
            for q in poses[:, 3:7]
        ]
    )
    turns = np.array([rotation(q) for q in drone])
    angle = float(np.ptp(np.unwrap(np.arctan2(turns[:, 1, 0], turns[:, 0, 0]))))
    if angle < CALIBRATION_LIMITS.least_turn:
        do = "Turn it about itself, slowly, once around."
        raise ConfigError(
            "calibration by a turn",
            f"a turn of {math.degrees(angle):.0f} deg",
            "180 deg or more",
            do,
        )
    rows = _regression_rows(times - times.mean(), turns)
    sides = (poses[:, 0:3] - height * turns[:, :, 2]).ravel()
    found, *_ = np.linalg.lstsq(rows, sides, rcond=None)
    deviation = float(np.sqrt(np.mean((rows @ found - sides) ** 2)))
    covariance = deviation**2 * np.linalg.inv(rows.T @ rows)
    error = math.sqrt(covariance[6, 6] + covariance[7, 7])
    return TurnEstimate(
        (float(found[6]), float(found[7]), height), deviation, error, angle
    )


def _regression_rows(times: Vec, turns: Mat) -> Mat:
    """Return (3 k, 8): the effect of c, d, o_x and o_y on each coordinate."""
    eye = np.eye(3)
    blocks = [
        np.hstack([eye, t * eye, r[:, 0:2]]) for t, r in zip(times, turns, strict=True)
    ]
    return np.vstack(blocks)


def _require_enough_poses(poses: Mat) -> None:
    if len(poses) < CALIBRATION_LIMITS.least_poses:
        raise ConfigError(
            "calibration",
            f"{len(poses)} poses",
            f"{CALIBRATION_LIMITS.least_poses} or more",
            "Look for longer; is the body seen?",
        )
