"""Where a drone wants to come to rest, and what it costs to do so elsewhere."""

import math
from dataclasses import dataclass

import numpy as np

from crazychoir.planning.point_to_point import PEAK_ACCELERATION, PEAK_SPEED
from crazychoir.types import Vec

NEAR = 0.05
"""m from the goal that counts as there."""
UNENDED = 1.0
"""s that a way costs that does not end at the goal; and more for what is left, REST times what it takes."""
REST = 2.0
AWAITED = 5.0
"""s that it costs beside, to rest where another one waits to come to: more than a flight aside, and back, takes."""


@dataclass(frozen=True)
class Aim:
    """A goal, among those of others.

    goal: (3,) m;  v_max m/s, a_max m/s2: of go_to;  awaited: (3,) m each, where others want to rest, and cannot come
    to;  figures: as f of `meets`.
    """

    goal: Vec
    v_max: float
    a_max: float
    awaited: tuple[Vec, ...]
    figures: Vec

    def missing(self, p: Vec) -> float:
        """s that a way costs which ends at p (3,) m instead of at the goal: more than a flight from there takes.

            UNENDED + REST T(|p - goal|) + AWAITED where p is in the way,   T: s, of a flight;  T within NEAR

        Who is not at its goal leaves the place of another who waits for it: two that stand on each other's goals would
        do so for ever, if neither gained anything by going away alone.
        """
        gap = math.dist(p, self.goal)
        left = max(
            PEAK_SPEED * gap / self.v_max,
            math.sqrt(PEAK_ACCELERATION * gap / self.a_max),
        )
        if gap <= NEAR:
            return left
        return (
            UNENDED
            + REST * left
            + AWAITED * any(self._occupies(p, place) for place in self.awaited)
        )

    def _occupies(self, p: Vec, place: Vec) -> bool:
        """Whether nobody can rest at a place (3,) m while another one does at p (3,) m: |S (p - q)| < D."""
        sy, sz, width, _ = self.figures.tolist()
        d = np.array([1.0, sy, sz]) * (p - place)
        return bool(np.linalg.norm(d) < width)
