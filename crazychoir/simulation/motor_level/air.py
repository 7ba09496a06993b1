"""The air: wind with gusts, and the downwash of one drone on another."""

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

WASH, WASH_LENGTH = 0.35, 0.339
"""Share of the upper drone's thrust, and m: a Gaussian of the vertical distance through what was measured between two
Crazyflies of 34 g, 10, 8, 6 and 4 g at 0.2, 0.3, 0.4 and 0.5 m (Shi, Hönig, Yue & Chung 2020, ICRA, Neural-Swarm)."""
SPREAD = 0.094
"""By which the half-width of a round turbulent jet grows, m a m (Pope 2000, Turbulent Flows)."""
BESIDE = 0.1
"""m of vertical distance, over which the wash of a drone begins: one at the same height gets none."""
WIDTHS = 3.5
"""Standard deviations, after which the wash ends; what is cut off is less than 0.1 % of the thrust."""
DEPTH = WIDTHS * WASH_LENGTH


@dataclass(frozen=True)
class Wind:
    """Wind of a room or a yard.

    mean: m/s, world;  gust: m/s, standard deviation an axis;  time: s, for which a gust lasts: Dryden's length scale
    over the mean wind's speed, so about 2 m over 1 m/s behind a fan, 100 m over 5 m/s outdoors.
    """

    mean: Triple = (0.0, 0.0, 0.0)
    gust: float = 0.0
    time: float = 2.0


@kernel()
def blow(
    m: Vec, keys: Keys, tick: int, mean: Triple, gust: float, decay: float
) -> None:
    """The wind at each drone of a block after a step of dt s, decay = exp(-dt / T).

        u <- mean + (u - mean) decay + gust sqrt(1 - decay^2) n

    It is Dryden's first-order forming filter for the longitudinal gust (MIL-F-8785C), exact for any dt, with the
    spectrum gust^2 2 T / (1 + (T w)^2), taken for all three axes; gusts of two drones are independent.
    """
    b = gust * math.sqrt(1.0 - decay * decay)
    for k in range(LANES):
        for c in range(3):
            n, _ = normals(keys[k], np.uint64(3 * tick + c))
            row = AIRX + c * LANES + k
            m[row] = mean[c] + (m[row] - mean[c]) * decay + b * n


@kernel()
def wash(down: float, aside2: float, radius: float) -> float:
    """Force on a lower drone over the thrust of the upper one; both hover or fly slowly.

        F / T = WASH exp(-z^2 / (2 L^2)) exp(-r^2 / (2 s^2)) b(z / BESIDE)
        s = radius + SPREAD z,  b(x) = x^2 (3 - 2 x)

    down: z, m;  aside2: r^2, m2;  radius: m, of the upper drone;  b = 1 from BESIDE on. The force points down.
    """
    s = radius + SPREAD * down
    x = clip(down / BESIDE, 0.0, 1.0)
    exponent = 0.5 * (down / WASH_LENGTH) ** 2 + 0.5 * aside2 / (s * s)
    return WASH * math.exp(-exponent) * x * x * (3.0 - 2.0 * x)


@kernel()
def _bucket(i: int, j: int, mask: int) -> int:
    """Where the column (i, j) of the room is kept."""
    return (i * 73856093 ^ j * 19349663) & mask


@kernel()
def _from_above(
    n: int, x: Vec, lift: Vec, radius: Vec, heads: Links, chain: Links
) -> float:
    """What drone n gets from the drones of its column and of the eight around it."""
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
    """Force N downwards on every drone from all above it, in a time that grows with the number of neighbours.

    x: (N, 13) states;  lift: (N,) N, thrusts;  radius: (N,) m;  out: (N,).  heads (2^k,) and chain (N, 3) are room for
    the columns of the room: drones whose x and y lie in one square, as wide as the wash reaches, are in one list.
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
