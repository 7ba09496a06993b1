"""Drones that are in each other's way go round each other, all the same way; who does not get on, the other way."""

import math

from crazychoir.numerics.kernels import kernel
from crazychoir.numerics.math3d import Triple, dot
from crazychoir.types import Vec

HARDEST = 4.0
"""m/s2, of what is turned at most."""
STUCK, MOVED, THERE = 4.0, 0.3, 0.3
"""s, and m: who has not moved farther in that time does not get on, unless it is so near where it wants to be."""
FREE = 1.0
"""s, without having given way, after which it goes round others as all do."""


@kernel()
def turned(u: Triple, planes: Vec, first: int, last: int, turn: float) -> Triple:
    """What is wanted, and for each half space that takes some of it away, `turn` times as much to the side.

        u + turn sum_k max(b_k - n_k . u, 0) e3 x n_k

    n_k points away from the other drone, so both turn about their middle in the same sense, against the clock from
    above: a standstill, in which all that is wanted is taken away, is none with it.
    planes: rows n_k, b_k, of which those from `first` to `last` - 1 are of other drones.
    """
    x = 0.0
    y = 0.0
    for k in range(first, last):
        lack = planes[k, 3] - dot((planes[k, 0], planes[k, 1], planes[k, 2]), u)
        if lack > 0.0:
            x -= turn * min(lack, HARDEST) * planes[k, 1]
            y += turn * min(lack, HARDEST) * planes[k, 0]
    return (u[0] + x, u[1] + y, u[2])


class Side:
    """Which way one drone goes round others: against the clock, as all do, unless it does not get on.

    Between two that stay where they are that way may be a pocket: then it tries the other way, until it is free.
    """

    def __init__(self, drone: int = 0) -> None:
        self.sign = 1.0
        self.patience = STUCK + 0.2 * (drone % 8)
        """s, other ones for each: two that turned at once would stay in each other's way."""
        self._at: list[float] | None = None
        self._since = 0.0
        self._gave_way = -math.inf

    def gives_way(self, p: Vec, goal: Vec, now: float) -> None:
        """It gives way at p, and wants to be at goal, (3,) m each."""
        if now > self._gave_way + FREE:
            self.sign = 1.0
            self._at = None
        self._gave_way = now
        here = p.tolist()
        if (
            self._at is None
            or math.dist(here, self._at) > MOVED
            or math.dist(here, goal.tolist()) < THERE
        ):
            self._at = here
            self._since = now
        elif now > self._since + self.patience:
            self.sign = -self.sign
            self._since = now
