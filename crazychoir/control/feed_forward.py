"""Feed-forward of turn rates: what the controls on board would find too late, and the moment of speed."""

import math
from typing import Any

import numpy as np

from crazychoir.control.attitude import (
    FIRMWARE_ATTITUDE_GAIN,
    FIRMWARE_ATTITUDE_INTEGRAL,
    AttitudeKind,
)
from crazychoir.control.margin import compute_rate_authority
from crazychoir.control.position import FLATNESS_LAYOUT
from crazychoir.numerics.kernels import (
    Records,
    kernel,
    real,
    rows_of,
    vector,
    whole,
)
from crazychoir.numerics.math3d import (
    STANDARD_GRAVITY,
    Triple,
    clip,
    dot,
    rotation_columns,
)
from crazychoir.platforms import Platform
from crazychoir.types import State, Vec

LONGEST_GAP = 0.1
"""Seconds between two calls beyond which nothing is known of the integrals on board."""
LARGEST_OPPOSED_RATE = 1.0
"""rad/s: largest rate against the moment of speed, that of 3 m/s for a Crazyflie 2.1."""
ANGLE_CORNER = FIRMWARE_ATTITUDE_INTEGRAL / FIRMWARE_ATTITUDE_GAIN
"""1/s: slower rates are found by the attitude control on board."""

FEED_FORWARD_ROW = np.dtype(
    [
        ("shares", np.float64, 2),  # m / (b kp), rad/s per m/s, about x and y
        ("drags", np.float64, 2),  # A / m, 1/s, along x and y
        ("ahead", np.float64),  # T, s
        ("corner", np.float64),  # ki / kp, 1/s
        ("slow", np.float64, 4),  # slow parts of r, and of the rates for angles
        ("called_at", np.float64),  # s
        ("desired", np.float64, FLATNESS_LAYOUT.desired_size),  # result
    ],
    align=True,
)
"""Record of the feed-forward, with the symbols of RateFeedForward."""


@kernel()
def _compute_opposed_rates(row: Any, x: Vec) -> Triple:
    """Return - d(t + T) / (b kp) about the body's axes, rad/s.

    row: record of FEED_FORWARD_ROW
    x: (13,): state
    """
    bx, by, bz = rotation_columns((x[6], x[7], x[8], x[9]))
    v = (x[3], x[4], x[5])
    ax = dot(bx, v)
    ay = dot(by, v)
    az = dot(bz, v)
    rise_x = -STANDARD_GRAVITY * bx[2] - row.drags[0] * ax + x[12] * ay - x[11] * az
    rise_y = -STANDARD_GRAVITY * by[2] - row.drags[1] * ay + x[10] * az - x[12] * ax
    return (
        -row.shares[0] * (ay + row.ahead * rise_y),
        row.shares[1] * (ax + row.ahead * rise_x),
        0.0,
    )


@kernel()
def lead_rates(row: Any, kind: int, x: Vec, desired: Vec, now: float) -> None:
    """Write the desired attitude with the rates of RateFeedForward into its record.

    row: record of FEED_FORWARD_ROW
    kind: AttitudeKind
    x: (13,): state
    desired: (13,), of a PositionControl
    now: s
    """
    out = row.desired
    for c in range(FLATNESS_LAYOUT.desired_size):
        out[c] = desired[c]
    has_moment = row.shares[0] != 0.0 or row.shares[1] != 0.0
    sends_angles = kind == AttitudeKind.ANGLES
    if not (has_moment or sends_angles):
        return
    h = now - row.called_at
    row.called_at = now
    slow = row.slow
    has_history = 0.0 <= h < LONGEST_GAP
    if not has_history:
        h = 0.0
        slow[2] = 0.0
        slow[3] = 0.0
    if has_moment:
        wanted = _compute_opposed_rates(row, x)
        if not has_history:
            slow[0] = wanted[0]
            slow[1] = wanted[1]
        share = 1.0 - math.exp(-row.corner * h)
        slow[0] += share * (wanted[0] - slow[0])
        slow[1] += share * (wanted[1] - slow[1])
        most = LARGEST_OPPOSED_RATE
        rx = clip(wanted[0] - slow[0], -most, most)
        ry = clip(wanted[1] - slow[1], -most, most)
        bx, by, _ = rotation_columns((x[6], x[7], x[8], x[9]))
        r = (
            rx * bx[0] + ry * by[0],
            rx * bx[1] + ry * by[1],
            rx * bx[2] + ry * by[2],
        )
        for c in range(3):
            axis = (desired[1 + 3 * c], desired[2 + 3 * c], desired[3 + 3 * c])
            out[10 + c] += dot(axis, r)
    if sends_angles:
        share = 1.0 - math.exp(-ANGLE_CORNER * h)
        for c in range(2):
            slow[2 + c] += share * (out[10 + c] - slow[2 + c])
            out[10 + c] -= slow[2 + c]


@kernel(rows_of(FEED_FORWARD_ROW), whole, vector, vector, real)
def _lead_rates(rows: Records, kind: int, x: Vec, desired: Vec, now: float) -> None:
    """Apply `lead_rates` to the first record."""
    lead_rates(rows[0], kind, x, desired, now)


class RateFeedForward:
    """Turns the rates of a desired attitude into those to be asked for.

        w = w_d + r,   for a sender of angles   w = s / (s + kia / ka) (w_d + r)

    *Angles.* The attitude control on board makes (ka + kia / s) (phi_c - phi) of an angle phi_c. With
    phi_c = phi_d + w / ka that is w_d, while phi = phi_d.

    *Moment of speed.* About each axis the rate control on board, with the rotors behind it and the moment d, is

        w' = b / (lag s + 1) ((kp + ki / s) (w_c - w) - kd w) + d
        d = m a_y about x,   d = -m a_x about y

    so that r = - (lag s + 1) / (b kp) s / (s + ki / kp) d makes it turn as without d. A drone obeys late, so d is
    needed early. With both lags as one, (1 + T s) d = m (a + T a'), and

        a = R^T v,   a' = -g R^T e3 - A/m a - w x a

    Only the part that the integrals do not find alone is sent. Without a known moment r = 0.

    a: m/s, body: speed
    m: rad/s2 per m/s, moment over inertia
    b: authority of the rates, see `compute_rate_authority`
    kp, ki, kd: of the rate control on board
    ka, kia: of the attitude control on board
    T: s, delay of commands and lag of the rotors

    rows: (1,) of FEED_FORWARD_ROW, where figures and memory are kept
    Source: the moment was found in flights, see `platforms.BodyEffects`.
    """

    def __init__(self, rows: Records) -> None:
        self.rows = rows
        """(1,) of FEED_FORWARD_ROW."""
        self.rows[:] = np.zeros(1, FEED_FORWARD_ROW)
        self.rows["called_at"] = -math.inf
        self._desired: Vec = self.rows["desired"][0]

    def know_moment(self, platform: Platform, ahead: float) -> None:
        """Cancel the moment of speed of a drone from the next call on.

        platform: of the drone, with its effects
        ahead: T, s
        """
        about_x, about_y = platform.effects.speed_moment or (0.0, 0.0)
        kp, ki, _ = platform.firmware.rate_pid
        k = [kp * compute_rate_authority(platform, axis) for axis in range(2)]
        x, y, _ = platform.inertia
        self.rows["shares"] = (about_x / (x * k[0]), about_y / (y * k[1]))
        self.rows["drags"] = np.array(platform.drag[:2]) / platform.mass
        self.rows["corner"] = ki / kp
        self.rows["ahead"] = ahead

    def lead(self, kind: AttitudeKind, state: State, desired: Vec, now: float) -> Vec:
        """Return the desired (13,) with other rates; the array is valid until the next call.

        kind: what is sent
        state: of the drone
        desired: (13,), of a PositionControl
        now: s
        """
        _lead_rates(self.rows, kind, state.flat, desired, now)
        return self._desired
