"""The air: wind with gusts, and the downwash of each drone on the drones below it."""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numba
import numpy as np
import numpy.typing as npt

from crazychoir.numerics.kernels import kernel, matrix, memory, vector
from crazychoir.numerics.math3d import Triple, clip
from crazychoir.simulation.common.draws import Keys, draw_normals
from crazychoir.types import Vec

# isort: off
from crazychoir.simulation.motor_level.lanes import (
    WIND_X,
    LANE_COUNT,
)
# isort: on

Links = npt.NDArray[np.int64]


class DownwashModel(NamedTuple):
    """The downwash below a drone: strength, length, width and the distances at which it begins and
    ends.
    """

    strength: float = 0.35
    """Share of the upper drone's thrust that pushes a drone straight below it down, at no distance.

    `strength` and `vertical_deviation` are the Gaussian of the vertical distance through what was measured between
    two Crazyflies of 34 g: 10, 8, 6 and 4 g at 0.2, 0.3, 0.4 and 0.5 m (Shi, Hönig, Yue & Chung 2020,
    ICRA, Neural-Swarm).
    """
    vertical_deviation: float = 0.339
    """Standard deviation in m of that Gaussian."""
    width_growth: float = 0.094
    """Growth of the half-width of a round turbulent jet, m a m (Pope 2000, Turbulent Flows)."""
    onset_distance: float = 0.1
    """Vertical distance in m over which the wash grows from none to its full strength.

    A drone at the same height gets none.
    """
    cutoff_deviations: float = 3.5
    """Standard deviations after which the wash ends; less than 0.1 % of the thrust is cut off.
    """
    depth: float = cutoff_deviations * vertical_deviation
    """Vertical distance in m at which the wash ends."""


DOWNWASH_MODEL = DownwashModel()


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
def advance_block_wind(
    m: Vec, keys: Keys, tick: int, mean: Triple, gust: float, decay: float
) -> None:
    """Compute the wind at each drone of a block after a step of dt s, with decay = exp(-dt / T).

        u <- mean + (u - mean) decay + gust sqrt(1 - decay^2) n

    This is Dryden's first-order forming filter for the longitudinal gust (MIL-F-8785C), exact for
    any dt, with the spectrum gust^2 2 T / (1 + (T w)^2), used for all three axes. Gusts of two
    drones are independent.
    """
    b = gust * math.sqrt(1.0 - decay * decay)
    for k in range(LANE_COUNT):
        for c in range(3):
            n, _ = draw_normals(keys[k], np.uint64(3 * tick + c))
            row = WIND_X + c * LANE_COUNT + k
            m[row] = mean[c] + (m[row] - mean[c]) * decay + b * n


@kernel()
def compute_wash_share(down: float, aside2: float, radius: float) -> float:
    """Return the force on a lower drone divided by the thrust of the upper drone.

        F / T = DOWNWASH_MODEL.strength exp(-z^2 / (2 L^2)) exp(-r^2 / (2 s^2)) b(z / DOWNWASH_MODEL.onset_distance)
        s = radius + DOWNWASH_MODEL.width_growth z,  b(x) = x^2 (3 - 2 x)

    Both drones hover or fly slowly. The force points down, and b = 1 from DOWNWASH_MODEL.onset_distance on.
    down: z, m: vertical distance
    aside2: r^2, m2: square of the horizontal distance
    radius: m: radius of the upper drone
    """
    s = radius + DOWNWASH_MODEL.width_growth * down
    x = clip(down / DOWNWASH_MODEL.onset_distance, 0.0, 1.0)
    exponent = 0.5 * (down / DOWNWASH_MODEL.vertical_deviation) ** 2 + 0.5 * aside2 / (
        s * s
    )
    return DOWNWASH_MODEL.strength * math.exp(-exponent) * x * x * (3.0 - 2.0 * x)


@kernel()
def _hash_column(i: int, j: int, mask: int) -> int:
    """Return the bucket of the hash table for the column (i, j) of the room."""
    return (i * 73856093 ^ j * 19349663) & mask


@kernel()
def _sum_force_from_above(
    n: int, x: Vec, lift: Vec, radius: Vec, heads: Links, chain: Links
) -> float:
    """Return the force on drone n from the drones in its column and the eight columns around it."""
    force = 0.0
    for i in range(chain[n, 1] - 1, chain[n, 1] + 2):
        for j in range(chain[n, 2] - 1, chain[n, 2] + 2):
            o = heads[_hash_column(i, j, heads.shape[0] - 1)]
            while o >= 0:
                down = x[o, 2] - x[n, 2]
                if (
                    0.0 < down < DOWNWASH_MODEL.depth
                    and chain[o, 1] == i
                    and chain[o, 2] == j
                ):
                    aside2 = (x[o, 0] - x[n, 0]) ** 2 + (x[o, 1] - x[n, 1]) ** 2
                    if (
                        aside2
                        < (
                            DOWNWASH_MODEL.cutoff_deviations
                            * (radius[o] + DOWNWASH_MODEL.width_growth * down)
                        )
                        ** 2
                    ):
                        force += lift[o] * compute_wash_share(down, aside2, radius[o])
                o = chain[o, 0]
    return force


@kernel(matrix, vector, vector, numba.int64[::1], numba.int64[:, ::1], memory)
def compute_downwash(
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
    width = DOWNWASH_MODEL.cutoff_deviations * (
        radius.max() + DOWNWASH_MODEL.width_growth * DOWNWASH_MODEL.depth
    )
    mask = heads.shape[0] - 1
    heads[:] = -1
    for n in range(x.shape[0]):
        i = math.floor(x[n, 0] / width)
        j = math.floor(x[n, 1] / width)
        b = _hash_column(i, j, mask)
        chain[n, 0] = heads[b]
        chain[n, 1] = i
        chain[n, 2] = j
        heads[b] = n
    for n in range(x.shape[0]):
        out[n] = _sum_force_from_above(n, x, lift, radius, heads, chain)
