"""Velocity control: from a reference to a velocity, for drones with velocity control on board."""

import math
from typing import Any, NamedTuple

import numpy as np

from crazychoir.numerics.kernels import Records, kernel, memory, rows_of, vector
from crazychoir.numerics.math3d import (
    STANDARD_GRAVITY,
    compute_yaw,
    is_finite,
    wrap_angle,
)
from crazychoir.types import State, Vec


class FirmwareGains(NamedTuple):
    """Gains of the firmware's own control of velocity, position and yaw."""

    velocity: float = math.radians(25.0) * STANDARD_GRAVITY
    """1/s, kp of the firmware's control of a velocity by a tilt."""
    position: float = 2.0
    """1/s, kp of the firmware's control of a place by a velocity."""
    yaw: float = 6.0
    """1/s, kp of the firmware's control of the yaw by a rate."""


FIRMWARE_GAINS = FirmwareGains()

VELOCITY_ROW = np.dtype(
    [
        ("gains", np.float64, 4),  # kp, kd, k_yaw, largest speed
    ],
    align=True,
)
"""Record of the velocity control of a drone."""


@kernel()
def compute_velocity(velocity: Any, x: Vec, ref: Vec, out: Vec) -> bool:
    """Apply the law of VelocityCtrlStrategy.

    velocity: record of VELOCITY_ROW
    x: (13,): state
    ref: (14,): reference
    out: (4,): the result
    Returns False if x or ref is not finite.
    """
    if not (is_finite(x) and is_finite(ref)):
        return False
    gains = velocity.gains
    heading = compute_yaw((x[6], x[7], x[8], x[9]))
    squares = 0.0
    for c in range(3):
        ahead = ref[6 + c] / FIRMWARE_GAINS.velocity if c < 2 else 0.0
        out[c] = (
            ref[3 + c]
            + ahead
            + gains[0] * (ref[c] - x[c])
            + gains[1] * (ref[3 + c] - x[3 + c])
        )
        squares += out[c] ** 2
    share = min(1.0, gains[3] / math.sqrt(squares)) if squares > 0.0 else 1.0
    for c in range(3):
        out[c] *= share
    out[3] = ref[13] + gains[2] * wrap_angle(ref[12] - heading)
    return True


@kernel(rows_of(VELOCITY_ROW), vector, vector, memory)
def _compute_velocity(rows: Records, x: Vec, ref: Vec, out: Vec) -> bool:
    """Apply `compute_velocity` to the first record."""
    return bool(compute_velocity(rows[0], x, ref, out))


class VelocityCtrlStrategy:
    """Proportional-derivative control of the position by a velocity.

        u = v_d + S a_d / k_v + kp (p_d - p) + kd (v_d - v)
        yaw' = yaw_d' + k_yaw (yaw_d - yaw), the short way

    S a_d: horizontal part of a_d; the firmware makes an acceleration of a velocity error by its
        gain k_v in 1/s
    kp: 1/s
    kd: 1
    k_yaw: 1/s
    v_max: m/s, largest |u|
    rows: (1,) of VELOCITY_ROW, where the gains are kept; None for an array of its own
    """

    def __init__(
        self,
        kp: float = 2.0,
        kd: float = 0.1,
        k_yaw: float = 2.0,
        v_max: float = 3.0,
        rows: Records | None = None,
    ) -> None:
        self.rows = np.zeros(1, VELOCITY_ROW) if rows is None else rows
        """(1,) of VELOCITY_ROW."""
        self.rows["gains"] = kp, kd, k_yaw, v_max

    def velocity(self, state: State, reference: Vec) -> Vec | None:
        """Return a new u (4,): velocity m/s world, yaw rate rad/s.

        Returns None if state or reference (14,) is not finite.
        """
        out = np.empty(4)
        is_usable = _compute_velocity(self.rows, state.flat, reference, out)
        return out if is_usable else None
