"""Where a drone goes while the cameras do not see it."""

import math
from typing import Protocol

import numpy as np

from crazychoir.numerics.kernels import kernel, memory, real, vector
from crazychoir.numerics.math3d import (
    GRAVITY,
    Triple,
    columns,
    dot,
    exponential,
    product,
    unit,
)
from crazychoir.types import Vec

STEP = 0.01  # s, of the integration at most
RATE_LAG = 0.05  # s, from a commanded body rate to that of the drone, delays of command and measurement included
STANDING = 0.01  # m above the floor that still count as standing on it: the noise of the cameras


class Motion(Protocol):
    """How a state goes on."""

    def after(self, x: Vec, u: Vec, t: float) -> Vec:
        """A new state (13,), t s after x (13,) under the command u (4,) = thrust N, body rates rad/s."""
        ...


@kernel(vector, real, memory)
def coast(x: Vec, t: float, out: Vec) -> None:
    """The state t seconds after x at constant velocity and body rate, into out (13,)."""
    out[:] = x
    for c in range(3):
        out[c] += t * x[3 + c]
    q = product((x[6], x[7], x[8], x[9]), exponential(t * x[10], t * x[11], t * x[12]))
    out[6], out[7], out[8], out[9] = q


class ConstantVelocity:
    """Velocity and body rates stay as they are, whatever is commanded."""

    def after(self, x: Vec, u: Vec, t: float) -> Vec:
        """A new state (13,)."""
        out = np.empty(13)
        coast(x, t, out)
        return out


@kernel()
def _stand(x: Vec) -> None:
    """Neither velocity nor rates."""
    for c in range(3):
        x[3 + c] = x[10 + c] = 0.0


@kernel()
def stands(x: Vec, u: Vec, platform: Vec, floor: float) -> bool:
    """Whether x (13,) is on the floor and its thrust u[0] does not lift it; platform: Platform.flat."""
    upright = 1.0 - 2.0 * (x[6] * x[6] + x[7] * x[7])
    return bool(x[2] < floor + STANDING and u[0] * upright <= platform[0] * GRAVITY)


@kernel()
def _turn(x: Vec, u: Vec, lag: float, h: float) -> None:
    """Attitude and body rates of x, h s later: the lag of the rates is exact, and they turn about their mean axis."""
    keep = math.exp(-h / lag)
    mean = lag * (1.0 - keep)
    turn = exponential(
        h * u[1] + mean * (x[10] - u[1]),
        h * u[2] + mean * (x[11] - u[2]),
        h * u[3] + mean * (x[12] - u[3]),
    )
    x[6], x[7], x[8], x[9] = unit(product((x[6], x[7], x[8], x[9]), turn))
    for c in range(3):
        x[10 + c] = u[1 + c] + keep * (x[10 + c] - u[1 + c])


@kernel()
def fly(
    x: Vec, u: Vec, platform: Vec, floor: float, lag: float, push: Triple, t: float
) -> bool:
    """Replace x (13,) by what the law of Commanded makes of it in t s; returns whether it stands on the floor then.

    lag: s, of the body rates;  push: m/s2, world, a constant acceleration that the law does not know.
    """
    steps = math.ceil(t / STEP)
    lowest = min(
        x[2], floor
    )  # who is seen below the floor stays there: it is not where it was thought to be
    standing = False
    for _ in range(steps):
        h = t / steps
        _turn(x, u, lag, 0.5 * h)
        standing = stands(x, u, platform, floor)
        if standing:
            _stand(x)
            continue
        bx, by, bz = columns((x[6], x[7], x[8], x[9]))
        v = (x[3], x[4], x[5])
        drag = (
            platform[1] * dot(bx, v),
            platform[2] * dot(by, v),
            platform[3] * dot(bz, v) - u[0],
        )
        for c in range(3):
            a = -(drag[0] * bx[c] + drag[1] * by[c] + drag[2] * bz[c]) / platform[0] - (
                GRAVITY if c == 2 else 0.0
            )
            x[c] += h * (v[c] + 0.5 * h * (a + push[c]))
            x[3 + c] += h * (a + push[c])
        _turn(x, u, lag, 0.5 * h)
        if x[2] < lowest:
            x[2] = lowest
            _stand(x)
    return standing


@kernel(vector, vector, vector, real, real, memory)
def _fly(x: Vec, u: Vec, platform: Vec, floor: float, t: float, out: Vec) -> None:
    """The law of Commanded, t s on from x, into out (13,)."""
    out[:] = x
    fly(out, u, platform, floor, RATE_LAG, (0.0, 0.0, 0.0), t)


class Commanded:
    """The paper's dynamics under the command that the drone obeys, and a first-order lag of its body rates.

        p' = v,  v' = -g e3 + (u_1 / m) R e3 - (1/m) R A R^T v,  q' = 1/2 q (w, 0),  w' = (u_2..4 - w) / RATE_LAG

    in steps of at most STEP s, the acceleration taken at their middle. Who stands on the floor stays there until its
    thrust outweighs it.
    platform: (9,), Platform.flat, whose A = diag is the drag;  floor: m, height of the ground.
    """

    def __init__(self, platform: Vec, floor: float) -> None:
        self.platform = platform
        self.floor = floor

    def after(self, x: Vec, u: Vec, t: float) -> Vec:
        """A new state (13,)."""
        out = np.empty(13)
        _fly(x, u, self.platform, self.floor, t, out)
        return out
