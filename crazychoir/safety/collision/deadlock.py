"""Drones that are in each other's way go round each other, all the same way."""

from crazychoir.math3d import Triple, Vec, dot, kernel

HARDEST = 4.0
"""m/s2, of what is turned at most."""


@kernel()
def turned(u: Triple, planes: Vec, first: int, last: int, turn: float) -> Triple:
    """What is wanted, and for each half space that takes some of it away, `turn` times as much to the side.

        u + turn sum_k max(b_k - n_k . u, 0) e3 x n_k

    n_k points away from the other drone, so both turn about their middle in the same sense, against the clock from
    above: a standstill, in which all that is wanted is taken away, is none with it.
    planes: rows n_k, b_k, of which those from `first` to `last` - 1 are of other drones.
    """
    x, y = 0.0, 0.0
    for k in range(first, last):
        lack = planes[k, 3] - dot((planes[k, 0], planes[k, 1], planes[k, 2]), u)
        if lack > 0.0:
            x -= turn * min(lack, HARDEST) * planes[k, 1]
            y += turn * min(lack, HARDEST) * planes[k, 0]
    return (u[0] + x, u[1] + y, u[2])
