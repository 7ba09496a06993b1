"""Attitude control: from a desired attitude to body rates, or to angles for a control on board."""

import math
from enum import IntEnum
from typing import Any, Protocol

import numpy as np

from crazychoir.control.gains import STANDARD_GAINS, Gains, TunedStrategy
from crazychoir.numerics.kernels import Records, kernel, memory, rows_of, vector
from crazychoir.numerics.math3d import clip, dot, rotation_columns
from crazychoir.platforms import PAPER_PLATFORM, Platform
from crazychoir.types import State, Vec

FIRMWARE_ATTITUDE_GAIN = 6.0  # 1/s, kp of the firmware's roll and pitch control
FIRMWARE_ATTITUDE_INTEGRAL = 3.0  # 1/s2, ki of the same
LARGEST_ANGLE = 1.0  # rad, of a roll or pitch that is asked for


class AttitudeKind(IntEnum):
    """The laws of attitude control that ship."""

    RATES = 0
    """GeometryAttitudeCtrl."""
    ANGLES = 1
    """AngleAttitudeCtrl."""


ATTITUDE_ROW = np.dtype(
    [
        ("kind", np.int64),  # AttitudeKind
        ("figures", np.float64, 6),  # of the law of this kind
    ],
    align=True,
)
"""Record of the attitude control of a drone."""


class AttitudeControl(Protocol):
    """The strategy that turns a desired attitude into the input of a sender."""

    gains: Gains
    """The gains; new ones act from the next call on."""

    def command(self, state: State, desired: Vec) -> Vec:
        """Return a new input (4,): thrust N, then body rates rad/s or angles.

        state: of the drone
        desired: (13,), of a PositionControl
        """
        ...


@kernel(vector, vector, vector, memory)
def _compute_body_rates(x: Vec, desired: Vec, figures: Vec, out: Vec) -> None:
    """Apply the law of GeometryAttitudeCtrl.

    x: (13,): state
    desired: (13,), of a PositionControl
    figures: (6,): kr, largest rates
    out: (4,): the result
    """
    r = rotation_columns((x[6], x[7], x[8], x[9]))
    d = (
        (desired[1], desired[2], desired[3]),
        (desired[4], desired[5], desired[6]),
        (desired[7], desired[8], desired[9]),
    )
    e = (
        0.5 * (dot(d[2], r[1]) - dot(r[2], d[1])),
        0.5 * (dot(d[0], r[2]) - dot(r[0], d[2])),
        0.5 * (dot(d[1], r[0]) - dot(r[1], d[0])),
    )
    w = (
        d[0][0] * desired[10] + d[1][0] * desired[11] + d[2][0] * desired[12],
        d[0][1] * desired[10] + d[1][1] * desired[11] + d[2][1] * desired[12],
        d[0][2] * desired[10] + d[1][2] * desired[11] + d[2][2] * desired[12],
    )
    out[0] = desired[0]
    for c in range(3):
        out[1 + c] = clip(
            dot(r[c], w) - figures[c] * e[c], -figures[3 + c], figures[3 + c]
        )


@kernel(vector, vector, vector, memory)
def _compute_angles(x: Vec, desired: Vec, figures: Vec, out: Vec) -> None:
    """Apply the law of AngleAttitudeCtrl.

    x: (13,): state
    desired: (13,), of a PositionControl
    figures: (4,): k, K_R of the yaw, largest yaw rate, largest angle
    out: (4,): the result
    """
    bx = rotation_columns((x[6], x[7], x[8], x[9]))[0]
    n = 1.0 / math.sqrt(max(bx[0] * bx[0] + bx[1] * bx[1], 1e-12))
    c = bx[0] * n
    s = bx[1] * n
    z = (c * desired[7] + s * desired[8], c * desired[8] - s * desired[7], desired[9])
    look = (c * desired[1] + s * desired[2], c * desired[2] - s * desired[1])
    w = (desired[10], desired[11], desired[12])
    turn = math.atan2(look[1], look[0])
    ahead = (
        w[0] * math.cos(turn) - w[1] * math.sin(turn),
        w[0] * math.sin(turn) + w[1] * math.cos(turn),
    )
    out[0] = desired[0]
    out[1] = clip(
        math.asin(clip(-z[1], -1.0, 1.0)) + ahead[0] / figures[0],
        -figures[3],
        figures[3],
    )
    out[2] = clip(
        math.atan2(z[0], z[2]) + ahead[1] / figures[0], -figures[3], figures[3]
    )
    out[3] = clip(w[2] + figures[1] * turn, -figures[2], figures[2])


@kernel()
def compute_input(attitude: Any, x: Vec, desired: Vec, out: Vec) -> None:
    """Write the input of a law of attitude control.

    attitude: record of ATTITUDE_ROW
    x: (13,): state
    desired: (13,), of a PositionControl
    out: (4,): the result
    """
    if attitude.kind == AttitudeKind.ANGLES:
        _compute_angles(x, desired, attitude.figures[:], out)
    else:
        _compute_body_rates(x, desired, attitude.figures[:], out)


@kernel(rows_of(ATTITUDE_ROW), vector, vector, memory)
def _compute_input(rows: Records, x: Vec, desired: Vec, out: Vec) -> None:
    """Apply `compute_input` to the first record."""
    compute_input(rows[0], x, desired, out)


class GeometryAttitudeCtrl(TunedStrategy):
    """Geometric attitude control on SO(3) with body rates as output.

        e_R = 1/2 (R_d^T R - R^T R_d)^vee,   w = - K_R e_R + R^T R_d w_d

    R: body to world
    w_d: rad/s, feed-forward in the axes of R_d

    Each rate is clipped to the platform's limit.

    rows: (1,) of ATTITUDE_ROW, where the figures are kept; None for an array of its own
    Source: Lee, Leok & McClamroch 2010, IEEE CDC, its attitude error; the rate loop flies on board.
    """

    def __init__(
        self,
        gains: Gains = STANDARD_GAINS,
        platform: Platform = PAPER_PLATFORM,
        rows: Records | None = None,
    ) -> None:
        self.platform = platform
        super().__init__(gains, np.zeros(1, ATTITUDE_ROW) if rows is None else rows)
        self.rows["kind"] = AttitudeKind.RATES

    def _tuned(self, gains: Gains) -> Vec:
        return np.array([*gains.kr, *self.platform.max_rate])

    def command(self, state: State, desired: Vec) -> Vec:
        """Return a new (4,): thrust N, body rates rad/s."""
        out = np.empty(4)
        _compute_input(self.rows, state.flat, desired, out)
        return out


class AngleAttitudeCtrl(TunedStrategy):
    """Roll, pitch and yaw rate for an attitude control on board, which turns by k times the error.

        phi = asin(-z_2) + w_x / k,   theta = atan2(z_1, z_3) + w_y / k,   psi' = w_z + K_R psi_e

    z: z_b of R_d in the axes of the drone's heading; so the force keeps its direction if the heading
        is wrong
    psi_e: rad, the yaw error, the short way
    w: rad/s, feed-forward
    k: 1/s, of the attitude control on board

    rows: (1,) of ATTITUDE_ROW, where the figures are kept; None for an array of its own
    """

    def __init__(
        self,
        gains: Gains = STANDARD_GAINS,
        platform: Platform = PAPER_PLATFORM,
        rows: Records | None = None,
    ) -> None:
        self.platform = platform
        super().__init__(gains, np.zeros(1, ATTITUDE_ROW) if rows is None else rows)
        self.rows["kind"] = AttitudeKind.ANGLES

    def _tuned(self, gains: Gains) -> Vec:
        return np.array(
            [
                FIRMWARE_ATTITUDE_GAIN,
                gains.kr[2],
                self.platform.max_rate[2],
                LARGEST_ANGLE,
            ]
        )

    def command(self, state: State, desired: Vec) -> Vec:
        """Return a new (4,): thrust N, roll and pitch rad, yaw rate rad/s."""
        out = np.empty(4)
        _compute_input(self.rows, state.flat, desired, out)
        return out
