"""The trim: the errors of a drone's thrust and attitude, learnt in flight."""

import math
from typing import Any, NamedTuple

import numpy as np

from crazychoir.numerics.kernels import Records, kernel, real, rows_of, vector
from crazychoir.numerics.math3d import STANDARD_GRAVITY, clip, rotation_columns
from crazychoir.types import Vec


class TrimLimits(NamedTuple):
    """Bounds of the trim, and the errors from which it learns: only small and lasting ones."""

    largest_thrust_error: float = 0.25
    """Largest error of the thrust, as a share.

    It covers old propellers, a low battery and a wrong mass, but not a wrong thrust map.
    """
    largest_attitude_error: float = 0.6
    """Largest error of the attitude, m/s2: 3.5 degrees."""
    learning_distance: float = 0.12
    """Largest horizontal distance in m from its place at which the trim learns, along each axis.
    """
    learning_height: float = 0.3
    """Largest vertical distance in m from its place at which the trim learns."""
    noise_level: float = 0.005
    """Trim in m/s2 that may be noise: twice what the noise of good cameras produces."""
    learning_speed: float = 0.15
    """Largest speed in m/s of that error at which the trim learns, along each axis."""


TRIM_LIMITS = TrimLimits()

TRIM_ROW = np.dtype(
    [
        ("flat", np.float64, 3),  # s; d (2) m/s2
        ("sure", np.float64, 3),  # s, d without what may be noise
        ("kept_flat", np.float64, 3),  # flat when it was last kept
        ("kept_sure", np.float64, 3),  # sure when it was last kept
        ("is_frozen", np.int64),  # 1 to learn nothing
    ],
    align=True,
)
"""Record of the trim of a drone, with the symbols of Trim."""


# An error tells something about the trim when it is small and lasts. On the return from a large
# error it does not.


@kernel()
def learn_trim(trim: Any, x: Vec, ref: Vec, rates: Vec, h: float) -> None:
    """Apply the law of Trim over h seconds, unless the trim is frozen.

    trim: record of TRIM_ROW, changed in place
    x: (13,): state
    ref: (14,): reference
    rates: (2,): ki_thrust, ki_trim
    h: s
    """
    if trim.is_frozen != 0:
        return
    e = (ref[0] - x[0], ref[1] - x[1], ref[2] - x[2])
    if (
        max(abs(ref[3] - x[3]), abs(ref[4] - x[4]), abs(ref[5] - x[5]))
        > TRIM_LIMITS.learning_speed
    ):
        return
    if (
        max(abs(e[0]), abs(e[1])) > TRIM_LIMITS.learning_distance
        or abs(e[2]) > TRIM_LIMITS.learning_height
    ):
        return
    bx = rotation_columns((x[6], x[7], x[8], x[9]))[0]
    n = 1.0 / math.sqrt(max(bx[0] * bx[0] + bx[1] * bx[1], 1e-12))
    c = bx[0] * n
    s = bx[1] * n
    flat = trim.flat
    sure = trim.sure
    flat[0] = clip(
        flat[0] + h * rates[0] * e[2] / STANDARD_GRAVITY,
        -TRIM_LIMITS.largest_thrust_error,
        TRIM_LIMITS.largest_thrust_error,
    )
    flat[1] = clip(
        flat[1] + h * rates[1] * (c * e[0] + s * e[1]),
        -TRIM_LIMITS.largest_attitude_error,
        TRIM_LIMITS.largest_attitude_error,
    )
    flat[2] = clip(
        flat[2] + h * rates[1] * (c * e[1] - s * e[0]),
        -TRIM_LIMITS.largest_attitude_error,
        TRIM_LIMITS.largest_attitude_error,
    )
    sure[0] = (
        flat[0] if STANDARD_GRAVITY * abs(flat[0]) > TRIM_LIMITS.noise_level else 0.0
    )
    for k in range(1, 3):
        sure[k] = flat[k] if abs(flat[k]) > TRIM_LIMITS.noise_level else 0.0


@kernel(rows_of(TRIM_ROW), vector, vector, vector, real)
def _learn(rows: Records, x: Vec, ref: Vec, rates: Vec, h: float) -> None:
    """Apply `learn_trim` to the first record."""
    learn_trim(rows[0], x, ref, rates, h)


class Trim:
    """Estimates a factor of the thrust and a small angle of the attitude, both bounded.

        s' = ki_thrust e_z / g,   d' = ki_trim Rz^T e_xy,   e = p_d - p
        thrust = (1 + s) m F . R e3,   a = a_d + Rz d + ...

    A wrong thrust is corrected by a factor, because it is wrong in every direction; an integral of
    the height would correct hovering only. Rz turns by the heading: an attitude error is constant in
    body axes. All position laws of one drone share the trim.

    s: error of the thrust
    d: (2,) m/s2, heading axes

    rows: (1,) of TRIM_ROW, where the trim is kept; None for an array of its own
    """

    def __init__(self, rows: Records | None = None) -> None:
        self.rows = np.zeros(1, TRIM_ROW) if rows is None else rows
        """(1,) of TRIM_ROW."""
        self.rows[:] = np.zeros(1, TRIM_ROW)
        self.flat: Vec = self.rows["flat"][0]
        """(3,): s, d."""
        self.sure: Vec = self.rows["sure"][0]
        """(3,): s, d without what may be noise, for laws that only know accelerations.

        The slow modes of a formation turn mm/s2 into centimetres.
        """
        self.frozen = True

    @property
    def frozen(self) -> bool:
        """True to learn nothing: on the ground a height error says nothing about the thrust."""
        return bool(self.rows["is_frozen"][0])

    @frozen.setter
    def frozen(self, frozen: bool) -> None:
        self.rows["is_frozen"] = frozen

    @property
    def thrust(self) -> float:
        """The factor of the commanded thrust."""
        return 1.0 + float(self.flat[0])

    @property
    def tilt(self) -> Vec:
        """(2,) rad, d / g: more tilt about the pitch axis, less about the roll axis."""
        return self.flat[1:3] / STANDARD_GRAVITY

    def keep(self) -> None:
        """Remember the present trim, for `restore`."""
        self.rows["kept_flat"] = self.rows["flat"]
        self.rows["kept_sure"] = self.rows["sure"]

    def restore(self) -> None:
        """Forget what was learnt since `keep`.

        It may come from a floor that was higher than the end of the reference.
        """
        self.rows["flat"] = self.rows["kept_flat"]
        self.rows["sure"] = self.rows["kept_sure"]

    def learn(self, x: Vec, reference: Vec, rates: Vec, h: float) -> None:
        """Take in the error of one tick.

        x: (13,): state
        reference: (14,)
        rates: (2,): ki_thrust, ki_trim
        h: s, since the last tick
        """
        _learn(self.rows, x, reference, rates, h)
