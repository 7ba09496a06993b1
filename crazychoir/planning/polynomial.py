"""The polynomial of degree 7 between two states."""

import math

import numpy as np

from crazychoir.errors import ConfigError
from crazychoir.numerics.kernels import kernel, real, table, vector
from crazychoir.numerics.math3d import wrap_angle
from crazychoir.planning.piecewise import POLYNOMIAL_DEGREE, Piecewise
from crazychoir.types import FullState, Vec


@kernel(vector, vector, real, table)
def _fill_coefficients(start: Vec, goal: Vec, duration: float, out: Vec) -> None:
    """Compute the coefficients of x, y, z, yaw in t, ascending.

    In s = t / T, c0..c3 are the start, and c4..c7 close the remaining gaps of p, p', p'', p'''
    at s = 1.

    start: (14,)
    goal: (14,)
    duration: s, T
    out: (4, 8): the result
    """
    for axis in range(4):
        c = out[axis]
        if axis < 3:
            p = start[axis]
            v = start[3 + axis]
            a = start[6 + axis]
            j = start[9 + axis]
            end = goal[axis]
            v1 = goal[3 + axis]
            a1 = goal[6 + axis]
            j1 = goal[9 + axis]
        else:
            p = start[12]
            v = start[13]
            a = 0.0
            j = 0.0
            end = start[12] + wrap_angle(goal[12] - start[12])
            v1 = goal[13]
            a1 = 0.0
            j1 = 0.0
        c[0] = p
        c[1] = v * duration
        c[2] = a * duration**2 / 2.0
        c[3] = j * duration**3 / 6.0
        g0 = end - c[0] - c[1] - c[2] - c[3]
        g1 = v1 * duration - c[1] - 2.0 * c[2] - 3.0 * c[3]
        g2 = a1 * duration**2 - 2.0 * c[2] - 6.0 * c[3]
        g3 = j1 * duration**3 - 6.0 * c[3]
        c[4] = 35.0 * g0 - 15.0 * g1 + 2.5 * g2 - g3 / 6.0
        c[5] = -84.0 * g0 + 39.0 * g1 - 7.0 * g2 + 0.5 * g3
        c[6] = 70.0 * g0 - 34.0 * g1 + 6.5 * g2 - 0.5 * g3
        c[7] = -20.0 * g0 + 10.0 * g1 - 2.0 * g2 + g3 / 6.0
        power = 1.0
        for n in range(8):
            c[n] /= power
            power *= duration


class Polynomial7th(Piecewise):
    """One polynomial of degree 7 from any state of the flat output to any other.

        p(t) = sum_n c_n t^n,  n = 0..7:  p, v, a, j are the start's at 0 and the goal's at T

    The yaw turns the short way, with yaw'' = yaw''' = 0 at both ends.

    start: the state at 0
    goal: the state at T
    duration: T, s
    Raises ConfigError for states or a duration that are not finite, or a duration that is not
    positive.
    """

    def __init__(self, start: FullState, goal: FullState, duration: float) -> None:
        name = type(self).__name__
        for side, state in (("start", start.flat), ("goal", goal.flat)):
            if state.shape != (14,) or not np.isfinite(state).all():
                raise ConfigError(
                    f"{name}: {side}",
                    state.tolist(),
                    "14 finite numbers, laid out as FullState.flat",
                )
        if not (math.isfinite(duration) and duration > 0.0):
            raise ConfigError(
                f"{name}: duration", duration, "a positive number of seconds"
            )
        rows = np.empty((4, POLYNOMIAL_DEGREE + 1))
        end = goal.flat.copy()
        _fill_coefficients(start.flat, goal.flat, float(duration), rows)
        end[12] = start.flat[12] + wrap_angle(goal.flat[12] - start.flat[12])
        self._fill(rows, np.array([0.0, duration]), end)

    @property
    def goal(self) -> Vec:
        """(3,) m: the place at the end."""
        return self._end[0:3]
