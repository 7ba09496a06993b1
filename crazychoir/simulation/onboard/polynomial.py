"""One piece of a trajectory, in the firmware's arithmetic of 32-bit floats."""

import math
from typing import Any, NamedTuple

import numpy as np

from crazychoir.firmware.memories import TRAJECTORY_MEMORY
from crazychoir.numerics.kernels import kernel

float32 = np.float32
Single = Any
"""A float32 or an array of them: the numbers of the firmware."""


class PolynomialLayout(NamedTuple):
    """Sizes of a piece, and places in the result of evaluate_piece; each place is followed by x,
    y, z and yaw.
    """

    axis_count: int = 4
    """Axes of a piece: x, y, z and yaw."""
    term_count: int = 8
    """Coefficients of an axis."""
    position: int = 0
    """First place of the values."""
    velocity: int = 4
    """First place of the first derivatives."""
    acceleration: int = 8
    """First place of the second derivatives."""
    jerk: int = 12
    """First place of the third derivatives."""


POLYNOMIAL_LAYOUT = PolynomialLayout()


class SingleNumbers(NamedTuple):
    """Numbers as 32-bit floats, with which the arithmetic stays in 32 bits."""

    zero: np.float32 = float32(0)
    """0."""
    half: np.float32 = float32(0.5)
    """1/2."""
    one: np.float32 = float32(1)
    """1."""
    two: np.float32 = float32(2)
    """2."""
    six: np.float32 = float32(6)
    """6."""
    turn: np.float32 = float32(2.0 * math.pi)
    """rad of a whole turn."""
    pi: np.float32 = float32(math.pi)
    """rad of half a turn."""


SINGLE_NUMBERS = SingleNumbers()


# Rows: c4 to c7. Columns: the gaps g0, g1, g2 left in p, p', p'' at the end, with no jerk there.
END_GAP_COEFFICIENTS = np.array(
    [[35, -15, 2.5], [-84, 39, -7], [70, -34, 6.5], [-20, 10, -2]], np.float32
)


@kernel()
def connect_ends(
    c: Single, axis: int, duration: Single, start: Single, end: Single
) -> None:
    """Write the polynomial of degree 7 from start to end into row `axis` of the piece c (33,).

        c0 = p0, c1 = v0, c2 = a0/2, c3 = 0 and c4..c7 by what is left
        at rest, with D = p1 - p0:  c4 = 35 D/T^4, c5 = -84 D/T^5, c6 = 70 D/T^6, c7 = -20 D/T^7

    The jerk is 0 at both ends. If T <= 0, the piece is the end point at once.
    duration: T, s
    start: (3,): p, v, a at the beginning
    end: (3,): p, v, a at the end
    """
    o = axis * POLYNOMIAL_LAYOUT.term_count
    for n in range(POLYNOMIAL_LAYOUT.term_count):
        c[o + n] = SINGLE_NUMBERS.zero
    if duration <= SINGLE_NUMBERS.zero:
        c[o] = end[0]
        return
    c[o] = start[0]
    c[o + 1] = start[1]
    c[o + 2] = SINGLE_NUMBERS.half * start[2]
    t = duration
    g0 = end[0] - (start[0] + t * (start[1] + t * SINGLE_NUMBERS.half * start[2]))
    g1 = t * (end[1] - start[1] - t * start[2])
    g2 = t * t * (end[2] - start[2])
    power = t * t * t * t
    for row in range(4):
        c[o + 4 + row] = (
            END_GAP_COEFFICIENTS[row, 0] * g0
            + END_GAP_COEFFICIENTS[row, 1] * g1
            + END_GAP_COEFFICIENTS[row, 2] * g2
        ) / power
        power *= t


@kernel()
def evaluate_piece(c: Single, t: Single, out: Single) -> None:
    """Write position, yaw and their three derivatives at t into out (16,), by Horner's scheme."""
    for axis in range(POLYNOMIAL_LAYOUT.axis_count):
        p = v = a = j = SINGLE_NUMBERS.zero
        for n in range(POLYNOMIAL_LAYOUT.term_count - 1, -1, -1):
            j = j * t + a
            a = a * t + v
            v = v * t + p
            p = p * t + c[axis * POLYNOMIAL_LAYOUT.term_count + n]
        out[POLYNOMIAL_LAYOUT.position + axis] = p
        out[POLYNOMIAL_LAYOUT.velocity + axis] = v
        out[POLYNOMIAL_LAYOUT.acceleration + axis] = SINGLE_NUMBERS.two * a
        out[POLYNOMIAL_LAYOUT.jerk + axis] = SINGLE_NUMBERS.six * j


@kernel()
def read_duration(c: Single) -> Single:
    """Return the duration of a piece in s."""
    return c[TRAJECTORY_MEMORY.piece_size - 1]


@kernel()
def unwrap_angle(start: Single, goal: Single) -> Single:
    """Return the goal's angle in rad, shifted by whole turns to the value nearest to start."""
    d = (goal - start) % SINGLE_NUMBERS.turn
    return start + (d - SINGLE_NUMBERS.turn if d > SINGLE_NUMBERS.pi else d)
