"""One piece of a trajectory, in the firmware's arithmetic of 32-bit floats."""

import math
from typing import Any

import numpy as np

from crazychoir.numerics.kernels import kernel
from crazychoir.simulation.onboard.record import PIECE

F = np.float32
Single = Any
"""A float32 or an array of them: the numbers of the firmware."""
AXES = 4  # x, y, z and yaw
TERMS = 8  # coefficients of an axis
# Places in the result of `evaluate`: each is followed by x, y, z and yaw.
P = 0  # values
V = 4  # first derivatives
A = 8  # second derivatives
J = 12  # third derivatives
ZERO = F(0)
HALF = F(0.5)
ONE = F(1)
TWO = F(2)
SIX = F(6)
TURN = F(2.0 * math.pi)
PI = F(math.pi)
# Rows: c4 to c7. Columns: the gaps g0, g1, g2 left in p, p', p'' at the end, with no jerk there.
CLOSE = np.array(
    [[35, -15, 2.5], [-84, 39, -7], [70, -34, 6.5], [-20, 10, -2]], np.float32
)


@kernel()
def connect(c: Single, axis: int, duration: Single, start: Single, end: Single) -> None:
    """Write the polynomial of degree 7 from start to end into row `axis` of the piece c (33,).

        c0 = p0, c1 = v0, c2 = a0/2, c3 = 0 and c4..c7 by what is left
        at rest, with D = p1 - p0:  c4 = 35 D/T^4, c5 = -84 D/T^5, c6 = 70 D/T^6, c7 = -20 D/T^7

    The jerk is 0 at both ends. If T <= 0, the piece is the end point at once.
    duration: T, s
    start: (3,): p, v, a at the beginning
    end: (3,): p, v, a at the end
    """
    o = axis * TERMS
    for n in range(TERMS):
        c[o + n] = ZERO
    if duration <= ZERO:
        c[o] = end[0]
        return
    c[o] = start[0]
    c[o + 1] = start[1]
    c[o + 2] = HALF * start[2]
    t = duration
    g0 = end[0] - (start[0] + t * (start[1] + t * HALF * start[2]))
    g1 = t * (end[1] - start[1] - t * start[2])
    g2 = t * t * (end[2] - start[2])
    power = t * t * t * t
    for row in range(4):
        c[o + 4 + row] = (
            CLOSE[row, 0] * g0 + CLOSE[row, 1] * g1 + CLOSE[row, 2] * g2
        ) / power
        power *= t


@kernel()
def evaluate(c: Single, t: Single, out: Single) -> None:
    """Write position, yaw and their three derivatives at t into out (16,), by Horner's scheme."""
    for axis in range(AXES):
        p = v = a = j = ZERO
        for n in range(TERMS - 1, -1, -1):
            j = j * t + a
            a = a * t + v
            v = v * t + p
            p = p * t + c[axis * TERMS + n]
        out[P + axis] = p
        out[V + axis] = v
        out[A + axis] = TWO * a
        out[J + axis] = SIX * j


@kernel()
def duration(c: Single) -> Single:
    """Return the duration of a piece in s."""
    return c[PIECE - 1]


@kernel()
def short_way(start: Single, goal: Single) -> Single:
    """Return the goal's angle in rad, shifted by whole turns to the value nearest to start."""
    d = (goal - start) % TURN
    return start + (d - TURN if d > PI else d)
