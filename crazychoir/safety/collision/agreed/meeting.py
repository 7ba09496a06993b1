"""Where two ways meet: the first time at which two drones that fly theirs come too near to each other."""

import math

import numpy as np

from crazychoir.numerics.kernels import kernel, matrix, real, vector
from crazychoir.safety.collision.agreed.paths import (
    braking,
    hold,
    moving,
    place,
    seconds,
)
from crazychoir.types import Mat, Vec

STEP = 0.05
"""s between two looks: at 2 m/s of relative speed a distance of 0.3 m is seen 4 mm too large at most."""
NEARER = 1e-3
"""m: two that are too near already may come that much nearer: rounding."""
WIDEST = 0.15
"""m, of what is added for a way that is only guessed."""
GROWS = 0.15
"""m/s, by which such a guess becomes worse."""
APART = 0.1
"""s between the places on a way at which a silent drone may be."""
COLUMN = 0.3
"""m between the heights at which one that may have come down may be."""
GOES_ON = 0.3
"""s that one who tells no way is taken to go on as he does, before he comes to rest."""

FIRST, COUNT, BEGAN, FLOOR, GUESS, TAG, COLUMNS = range(7)
"""Columns of what is known of another's way: the first row and the number of its pieces; s, when it began; whether he
stands on the floor; m/s, by which it is unsure; whose it is."""


@kernel(matrix, real, matrix, matrix, real, vector)
def meets(
    way: Mat, began: float, pieces: Mat, others: Mat, now: float, f: Vec
) -> tuple[float, float]:
    """The first time s at which a way meets one of the others, infinite if it never does; and whose that is.

        |S (p_i(t) - p_j(t))| < min(D, |S (p_i - p_j)| when both have begun),   S = diag(1, s_x / s_y, s_x / s_z)

    so that two that are too near part again.  others: rows of FIRST ... TAG, of ways in pieces (., 25);  f: (4,) = the
    diagonal of S without its first, D m, and the width m of one on the floor, for whom S = 1.
    """
    duration = 0.0
    for k in range(way.shape[0]):
        duration += way[k, 0]
    soonest = math.inf
    whose = -1.0
    for row in range(others.shape[0]):
        other = others[row]
        first = int(other[FIRST])
        theirs = pieces[first : first + int(other[COUNT])]
        lasts = 0.0
        for k in range(theirs.shape[0]):
            lasts += theirs[k, 0]
        sy, sz, width = (1.0, 1.0, f[3]) if other[FLOOR] > 0.0 else (f[0], f[1], f[2])
        t = max(now, began, other[BEGAN])
        ends = min(max(began + duration, other[BEGAN] + lasts) + STEP, soonest)
        nearest = math.inf
        while t < ends:
            p = place(way, t - began)
            q = place(theirs, t - other[BEGAN])
            d = math.sqrt(
                (p[0] - q[0]) ** 2
                + (sy * (p[1] - q[1])) ** 2
                + (sz * (p[2] - q[2])) ** 2
            )
            nearest = min(nearest, d - NEARER) if nearest == math.inf else nearest
            if d < min(width + min(other[GUESS] * (t - now), WIDEST), nearest):
                soonest = t
                whose = other[TAG]
                break
            t += STEP
    return soonest, whose


class Meeting:
    """The ways of the others that a way must not meet.

    figures: as f of `meets`;  a_max: m/s2, with which one who tells no way is taken to brake.
    """

    def __init__(self, figures: Vec, a_max: float) -> None:
        self.figures = figures
        self.a_max = a_max
        self._pieces: list[Mat] = []
        self._rows: list[tuple[float, ...]] = []
        self._count = 0
        self._packed: tuple[Mat, Mat] | None = None

    def way(
        self, j: int, way: Mat, began: float, guess: float = 0.0, floor: bool = False
    ) -> None:
        """Drone j flies this."""
        self._rows.append((self._count, len(way), began, float(floor), guess, j))
        self._pieces.append(way)
        self._count += len(way)

    def somewhere(self, j: int, way: Mat, began: float, heard: float) -> None:
        """Drone j is silent since `heard`, s: it may have stopped anywhere on what was left of its way then."""
        lasts = seconds(way)
        for t in np.arange(
            min(max(0.0, heard - began), lasts), lasts + APART, APART
        ).tolist():
            self.way(j, hold(moving(way, t)[0:3], 0.0), -math.inf)

    def below(self, j: int, p: Vec) -> None:
        """Drone j may have come down from p (3,) m, to the ground."""
        for z in np.arange(p[2], -APART, -COLUMN).tolist():
            self.way(j, hold(np.array([p[0], p[1], z]), 0.0), -math.inf)

    def stands(self, j: int, p: Vec) -> None:
        """Drone j stands on the floor."""
        self.way(j, hold(p, 0.0), -math.inf, floor=True)

    def guessed(self, j: int, p: Vec, v: Vec, born: float) -> None:
        """Drone j tells no way: it goes on a little, and brakes."""
        start = np.concatenate([p, v, np.zeros(6)])
        going = hold(p, GOES_ON)
        going[0, 2], going[0, 10], going[0, 18] = v
        start[0:3] += GOES_ON * v
        self.way(
            j, np.concatenate([going, braking(start, self.a_max)]), born, guess=GROWS
        )

    def first(
        self, way: Mat, began: float, now: float, room: float = 0.0
    ) -> tuple[float, int | None]:
        """s, when a way first meets one of them, and whom; infinite and None if it is clear. room: m, more to keep."""
        if not self._rows:
            return math.inf, None
        if self._packed is None:
            self._packed = np.concatenate(self._pieces), np.array(self._rows)
        figures = self.figures.copy()
        figures[2] += room
        time, whose = meets(way, began, *self._packed, now, figures)
        return time, None if whose < 0.0 else int(whose)

    def clear(self, way: Mat, began: float, now: float) -> bool:
        """Whether it meets nobody."""
        return self.first(way, began, now)[1] is None
