"""What a drone's thrust and attitude are off by, learnt in flight."""

import math

import numpy as np

from crazychoir.numerics.kernels import kernel, memory, real, vector
from crazychoir.numerics.math3d import GRAVITY, clip, columns
from crazychoir.types import Vec

MOST_THRUST = 0.25  # share of the thrust: old propellers, a low battery, a wrong mass; not a wrong thrust map
MOST_TRIM = 0.6  # m/s2: an attitude that is 3.5 degrees off
# An error says something about the trim when it is small and stays: on the way back from a larger one it does not.
NEAR, NEAR_IN_HEIGHT = 0.12, 0.3  # m from its place, along each axis
DOUBT = 0.005  # m/s2: what the noise of good cameras makes of it, twice over
SLOW = 0.15  # m/s, of that error, along each axis


@kernel(vector, vector, vector, real, memory, memory)
def _learn(x: Vec, ref: Vec, rates: Vec, h: float, trim: Vec, sure: Vec) -> None:
    """The law of Trim over h seconds; rates: (2,) = ki_thrust, ki_trim."""
    e = (ref[0] - x[0], ref[1] - x[1], ref[2] - x[2])
    if max(abs(ref[3] - x[3]), abs(ref[4] - x[4]), abs(ref[5] - x[5])) > SLOW:
        return
    if max(abs(e[0]), abs(e[1])) > NEAR or abs(e[2]) > NEAR_IN_HEIGHT:
        return
    bx = columns((x[6], x[7], x[8], x[9]))[0]
    n = 1.0 / math.sqrt(max(bx[0] * bx[0] + bx[1] * bx[1], 1e-12))
    c = bx[0] * n
    s = bx[1] * n
    trim[0] = clip(trim[0] + h * rates[0] * e[2] / GRAVITY, -MOST_THRUST, MOST_THRUST)
    trim[1] = clip(
        trim[1] + h * rates[1] * (c * e[0] + s * e[1]), -MOST_TRIM, MOST_TRIM
    )
    trim[2] = clip(
        trim[2] + h * rates[1] * (c * e[1] - s * e[0]), -MOST_TRIM, MOST_TRIM
    )
    sure[0] = trim[0] if GRAVITY * abs(trim[0]) > DOUBT else 0.0
    for k in range(1, 3):
        sure[k] = trim[k] if abs(trim[k]) > DOUBT else 0.0


class Trim:
    """Estimate of a thrust that is off by a factor and of an attitude that is off by a small angle, both bounded.

        s' = ki_thrust e_z / g,   d' = ki_trim Rz^T e_xy,   e = p_d - p
        thrust = (1 + s) m F . R e3,   a = a_d + Rz d + ...

    A thrust that is off by a factor pulls too hard sideways as well, so it is mended as a factor, where an integral of
    the height would only mend hovering. Rz turns by the heading: an attitude that is off is so in body axes, whatever
    way the drone looks.  s: of the thrust;  d: (2,) m/s2, heading axes.
    flat: (3,) = s, d;  sure: (3,) the same without what may be noise: for who only knows accelerations, as the slow
    modes of a formation turn mm/s2 into centimetres. The position laws of one drone share it.
    frozen: learn nothing: on the ground, where an error of the height does not say what the thrust does.
    """

    def __init__(self) -> None:
        self.flat = np.zeros(3)
        self.sure = np.zeros(3)
        self.frozen = True
        self._kept = np.zeros(3), np.zeros(3)

    @property
    def thrust(self) -> float:
        """By how much the commanded thrust is multiplied."""
        return 1.0 + float(self.flat[0])

    @property
    def tilt(self) -> Vec:
        """(2,) rad, by which the drone is tilted more about its pitch axis and less about its roll axis: d / g."""
        return self.flat[1:3] / GRAVITY

    def keep(self) -> None:
        """Remember what is known now, for `restore`."""
        self._kept = self.flat.copy(), self.sure.copy()

    def restore(self) -> None:
        """Forget what was learnt since `keep`, as from a floor that was higher than where the reference went."""
        self.flat[:], self.sure[:] = self._kept

    def learn(self, x: Vec, reference: Vec, rates: Vec, h: float) -> None:
        """Take in the error of one tick; rates: (2,) = ki_thrust, ki_trim;  h: s since the last one."""
        if not self.frozen:
            _learn(x, reference, rates, h, self.flat, self.sure)
