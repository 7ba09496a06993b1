"""The way home of a drone whose operator calls it back: up, across above the others, and then down."""

import math
from collections.abc import Iterable

import numpy as np

from crazychoir.types import Point, Vec

THERE = 0.2
"""m from the end of a leg that counts as there."""
TRIES = 5
"""How often a leg is begun before the drone lands where it is."""
CLEARANCE = 0.6
"""m above another: two semi-axes of 0.3 m of the ellipsoids that downwash fills."""
ASIDE = 0.5
"""m beside the straight way home within which another is in the way."""


class Homecoming:
    """The legs of a return from p (3,) m to above home (3,) m, at the height z m or higher."""

    def __init__(self, p: Vec, home: Point, z: float) -> None:
        level = max(z, float(p[2]))
        self.legs: list[Vec] = [
            np.array([p[0], p[1], level]),
            np.array([home[0], home[1], level]),
        ]
        self.tries = 0

    def leg(self, p: Vec) -> Vec | None:
        """Where to fly next from p; None: it is above home, or does not get there."""
        while self.legs and math.dist(p, self.legs[0]) < THERE:
            del self.legs[0]
            self.tries = 0
        self.tries += 1
        return self.legs[0] if self.legs and self.tries <= TRIES else None

    @property
    def stuck(self) -> bool:
        """Whether it has given up on the way."""
        return bool(self.legs)


def level_above(
    p: Point, home: Point, others: Iterable[Point], rank: int, top: float
) -> float:
    """m, the height of a return that is above the others in the way; at most `top`.

        z = max(z of those within ASIDE of the way from p to home, own z) + CLEARANCE, + rank CLEARANCE

    others: (3,) m each, of which it knows;  rank: among those that return at the same time, who fly at levels of their
    own, as far as the room is high enough.
    """
    a = np.asarray(p[:2], dtype=float)
    b = np.asarray(home[:2], dtype=float)
    highest = [
        float(q[2])
        for q in others
        if _beside(np.asarray(q[:2], dtype=float), a, b) < ASIDE
    ]
    if not highest and rank == 0:
        return min(float(p[2]), top)
    return min(max([float(p[2]), *highest]) + (bool(highest) + rank) * CLEARANCE, top)


def _beside(q: Vec, a: Vec, b: Vec) -> float:
    """m from q (2,) to the segment from a to b."""
    way = b - a
    share = float(np.clip((q - a) @ way / max(float(way @ way), 1e-12), 0.0, 1.0))
    return float(np.linalg.norm(q - a - share * way))
