"""Models of a drone's motion while the cameras do not see it."""

import math

import numpy as np

from crazychoir.numerics.kernels import kernel, memory, real, vector
from crazychoir.numerics.math3d import (
    STANDARD_GRAVITY,
    Triple,
    dot,
    normalize_quaternion,
    quaternion_product,
    rotation_columns,
    rotation_exponential,
)
from crazychoir.types import Vec

MOTION_STEP = 0.01  # s, longest step of the integration
RATE_LAG = 0.05
"""Lag in s from a commanded body rate to that of the drone.

It includes the delays of command and measurement.
"""
STANDING_TOLERANCE = 0.01  # m above the floor that still count as standing on it: the noise of the cameras


@kernel()
def coast(x: Vec, t: float) -> None:
    """Advance a state by t seconds of constant velocity and body rates.

    x: (13,), changed in place
    t: s
    """
    for c in range(3):
        x[c] += t * x[3 + c]
    x[6], x[7], x[8], x[9] = quaternion_product(
        (x[6], x[7], x[8], x[9]), rotation_exponential(t * x[10], t * x[11], t * x[12])
    )


@kernel()
def compute_speed(x: Vec) -> float:
    """Return the speed in m/s of a state (13,)."""
    return math.sqrt(x[3] * x[3] + x[4] * x[4] + x[5] * x[5])


@kernel()
def _stop_moving(x: Vec) -> None:
    """Set velocity and rates to zero."""
    for c in range(3):
        x[3 + c] = x[10 + c] = 0.0


@kernel()
def is_standing(x: Vec, u: Vec, platform: Vec, floor: float) -> bool:
    """Return whether x is on the floor and the thrust u[0] does not lift it.

    x: (13,): state
    u: (4,): command
    platform: Platform.flat
    floor: m
    """
    upright = 1.0 - 2.0 * (x[6] * x[6] + x[7] * x[7])
    return bool(
        x[2] < floor + STANDING_TOLERANCE
        and u[0] * upright <= platform[0] * STANDARD_GRAVITY
    )


@kernel()
def _advance_attitude(x: Vec, u: Vec, lag: float, h: float) -> None:
    """Advance attitude and body rates of x by h s.

    The lag of the rates is exact; the attitude turns about their mean axis.
    """
    keep = math.exp(-h / lag)
    mean = lag * (1.0 - keep)
    turn = rotation_exponential(
        h * u[1] + mean * (x[10] - u[1]),
        h * u[2] + mean * (x[11] - u[2]),
        h * u[3] + mean * (x[12] - u[3]),
    )
    x[6], x[7], x[8], x[9] = normalize_quaternion(
        quaternion_product((x[6], x[7], x[8], x[9]), turn)
    )
    for c in range(3):
        x[10 + c] = u[1 + c] + keep * (x[10 + c] - u[1 + c])


@kernel()
def advance_flight(
    x: Vec, u: Vec, platform: Vec, floor: float, lag: float, push: Triple, t: float
) -> bool:
    """Advance a state by the law of CommandedMotion, and return whether it then stands on the floor.

    x: (13,), changed in place
    u: (4,): command
    platform: Platform.flat
    floor: m
    lag: s, of the body rates
    push: m/s2, world: a constant further acceleration
    t: s
    """
    steps = math.ceil(t / MOTION_STEP)
    # A drone seen below the floor stays there: the floor is not where it was thought to be.
    lowest = min(x[2], floor)
    standing = False
    for _ in range(steps):
        h = t / steps
        _advance_attitude(x, u, lag, 0.5 * h)
        standing = is_standing(x, u, platform, floor)
        if standing:
            _stop_moving(x)
            continue
        bx, by, bz = rotation_columns((x[6], x[7], x[8], x[9]))
        v = (x[3], x[4], x[5])
        drag = (
            platform[1] * dot(bx, v),
            platform[2] * dot(by, v),
            platform[3] * dot(bz, v) - u[0],
        )
        for c in range(3):
            a = -(drag[0] * bx[c] + drag[1] * by[c] + drag[2] * bz[c]) / platform[0] - (
                STANDARD_GRAVITY if c == 2 else 0.0
            )
            x[c] += h * (v[c] + 0.5 * h * (a + push[c]))
            x[3 + c] += h * (a + push[c])
        _advance_attitude(x, u, lag, 0.5 * h)
        if x[2] < lowest:
            x[2] = lowest
            _stop_moving(x)
    return standing


@kernel(vector, vector, vector, real, real, memory)
def _predict_flight(
    x: Vec, u: Vec, platform: Vec, floor: float, t: float, out: Vec
) -> None:
    """Compute the state after t s by the law of CommandedMotion.

    x: (13,)
    u: (4,)
    platform: Platform.flat
    floor: m
    t: s
    out: (13,): the result
    """
    out[:] = x
    advance_flight(out, u, platform, floor, RATE_LAG, (0.0, 0.0, 0.0), t)


class CommandedMotion:
    """The paper's dynamics under the present command, with a first-order lag of the body rates.

        p' = v,  v' = -g e3 + (u_1 / m) R e3 - (1/m) R A R^T v
        q' = 1/2 q (w, 0),  w' = (u_2..4 - w) / RATE_LAG

    It is integrated in steps of at most MOTION_STEP s with the acceleration in their middle. A drone on
    the floor stays there until its thrust outweighs it.

    platform: (9,), Platform.flat; its A = diag is the drag
    floor: m, height of the ground
    """

    def __init__(self, platform: Vec, floor: float) -> None:
        self.platform = platform
        self.floor = floor

    def after(self, x: Vec, u: Vec, t: float) -> Vec:
        """Return a new state (13,)."""
        out = np.empty(13)
        _predict_flight(x, u, self.platform, self.floor, t, out)
        return out
