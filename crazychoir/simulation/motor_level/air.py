"""The air: wind with gusts, and the downwash of each drone on the drones below it."""

import math
from dataclasses import dataclass

import numba
import numpy as np
import numpy.typing as npt

from crazychoir.numerics.kernels import kernel, matrix, memory, vector
from crazychoir.numerics.math3d import Triple, clip
from crazychoir.simulation.common.draws import Keys, normals
from crazychoir.types import Vec

# isort: off
from crazychoir.simulation.motor_level.lanes import (
    AIRX,
    LANES,
)
# isort: on

Links = npt.NDArray[np.int64]

WASH = 0.35
"""Share of the upper drone's thrust that pushes a drone straight below it down, at no distance.

WASH and WASH_LENGTH are the Gaussian of the vertical distance through what was measured between
two Crazyflies of 34 g: 10, 8, 6 and 4 g at 0.2, 0.3, 0.4 and 0.5 m (Shi, Hönig, Yue & Chung 2020,
ICRA, Neural-Swarm).
"""
WASH_LENGTH = 0.339
"""Standard deviation in m of that Gaussian."""
SPREAD = 0.094
"""Growth of the half-width of a round turbulent jet, m a m (Pope 2000, Turbulent Flows)."""
BESIDE = 0.1
"""Vertical distance in m over which the wash grows from none to its full strength.

A drone at the same height gets none.
"""
WIDTHS = 3.5
"""Standard deviations after which the wash ends; less than 0.1 % of the thrust is cut off."""
DEPTH = WIDTHS * WASH_LENGTH  # m: vertical distance at which the wash ends


@dataclass(frozen=True)
class Wind:
    """The wind in a room or a yard."""

    mean: Triple = (0.0, 0.0, 0.0)
    """Mean wind in m/s, world."""
    gust: float = 0.0
    """Standard deviation of the gusts in m/s, on each axis."""
    time: float = 2.0
    """Seconds that a gust lasts.

    It is Dryden's length scale divided by the speed of the mean wind: about 2 m over 1 m/s behind
    a fan, 100 m over 5 m/s outdoors.
    """


@kernel()
def blow(
    m: Vec, keys: Keys, tick: int, mean: Triple, gust: float, decay: float
) -> None:
    """Compute the wind at each drone of a block after a step of dt s, with decay = exp(-dt / T).

        u <- mean + (u - mean) decay + gust sqrt(1 - decay^2) n

    This is Dryden's first-order forming filter for the longitudinal gust (MIL-F-8785C), exact for
    any dt, with the spectrum gust^2 2 T / (1 + (T w)^2), used for all three axes. Gusts of two
    drones are independent.
    """
    b = gust * math.sqrt(1.0 - decay * decay)
    for k in range(LANES):
        for c in range(3):
            n, _ = normals(keys[k], np.uint64(3 * tick + c))
            row = AIRX + c * LANES + k
            m[row] = mean[c] + (m[row] - mean[c]) * decay + b * n


@kernel()
def wash(down: float, aside2: float, radius: float) -> float:
    """Return the force on a lower drone divided by the thrust of the upper drone.

        F / T = WASH exp(-z^2 / (2 L^2)) exp(-r^2 / (2 s^2)) b(z / BESIDE)
        s = radius + SPREAD z,  b(x) = x^2 (3 - 2 x)

    Both drones hover or fly slowly. The force points down, and b = 1 from BESIDE on.
    down: z, m: vertical distance
    aside2: r^2, m2: square of the horizontal distance
    radius: m: radius of the upper drone
    """
    s = radius + SPREAD * down
    x = clip(down / BESIDE, 0.0, 1.0)
    exponent = 0.5 * (down / WASH_LENGTH) ** 2 + 0.5 * aside2 / (s * s)
    return WASH * math.exp(-exponent) * x * x * (3.0 - 2.0 * x)


@kernel()
def _bucket(i: int, j: int, mask: int) -> int:
    """Return the bucket of the hash table for the column (i, j) of the room."""
    return (i * 73856093 ^ j * 19349663) & mask


@kernel()
def _from_above(
    n: int, x: Vec, lift: Vec, radius: Vec, heads: Links, chain: Links
) -> float:
    """Return the force on drone n from the drones in its column and the eight columns around it."""
    force = 0.0
    for i in range(chain[n, 1] - 1, chain[n, 1] + 2):
        for j in range(chain[n, 2] - 1, chain[n, 2] + 2):
            o = heads[_bucket(i, j, heads.shape[0] - 1)]
            while o >= 0:
                down = x[o, 2] - x[n, 2]
                if 0.0 < down < DEPTH and chain[o, 1] == i and chain[o, 2] == j:
                    aside2 = (x[o, 0] - x[n, 0]) ** 2 + (x[o, 1] - x[n, 1]) ** 2
                    if aside2 < (WIDTHS * (radius[o] + SPREAD * down)) ** 2:
                        force += lift[o] * wash(down, aside2, radius[o])
                o = chain[o, 0]
    return force


@kernel(matrix, vector, vector, numba.int64[::1], numba.int64[:, ::1], memory)
def downwash(
    x: Vec, lift: Vec, radius: Vec, heads: Links, chain: Links, out: Vec
) -> None:
    """Compute the downward force on every drone from all drones above it.

    Drones with x and y in one square, as wide as the wash reaches, are in one list, so the time
    grows with the number of neighbours.
    x: (N, 13): states
    lift: (N,) N: thrusts
    radius: (N,) m: radii of the drones
    heads: (2^k,): work space, first drone of each bucket
    chain: (N, 3): work space, next drone of the bucket and column of each drone
    out: (N,) N: result
    """
    width = WIDTHS * (radius.max() + SPREAD * DEPTH)
    mask = heads.shape[0] - 1
    heads[:] = -1
    for n in range(x.shape[0]):
        i = math.floor(x[n, 0] / width)
        j = math.floor(x[n, 1] / width)
        b = _bucket(i, j, mask)
        chain[n, 0] = heads[b]
        chain[n, 1] = i
        chain[n, 2] = j
        heads[b] = n
    for n in range(x.shape[0]):
        out[n] = _from_above(n, x, lift, radius, heads, chain)
