"""The goal where a drone wants to rest, and the cost of resting elsewhere."""

import math
from dataclasses import dataclass

import numpy as np

from crazychoir.planning.point_to_point import PEAK_ACCELERATION, PEAK_SPEED
from crazychoir.types import Vec

ARRIVAL_DISTANCE = 0.05
"""Distance in m from the goal within which the drone has arrived."""


@dataclass(frozen=True, slots=True)
class RestCosts:
    """The costs of a path that ends elsewhere than at its goal."""

    elsewhere: float = 1.0
    """Cost in s of a path that does not end at the goal."""
    remaining_flight: float = 2.0
    """Further cost of such a path, as a multiple of the time of the remaining flight."""
    awaited_place: float = 5.0
    """Cost in s of resting where another drone wants to rest.

    It is more than the time of a flight aside and back.
    """


REST_COSTS = RestCosts()


@dataclass(frozen=True)
class RestGoal:
    """A goal among the goals of others."""

    goal: Vec
    """(3,) m, world."""
    v_max: float
    """m/s, of go_to."""
    a_max: float
    """m/s2, of go_to."""
    awaited: tuple[Vec, ...]
    """(3,) m each: where others want to rest but cannot."""
    figures: Vec
    """(4,), as f of `find_first_meeting`."""

    def missing(self, p: Vec) -> float:
        """Return the cost in s of a path that ends at p, (3,) m, instead of at the goal.

            REST_COSTS.elsewhere + REST_COSTS.remaining_flight T(|p - goal|)
            + REST_COSTS.awaited_place where p is in the way,   T: s, of a flight
            T within ARRIVAL_DISTANCE

        It is more than the time of a flight from p to the goal. A drone away from its goal leaves
        the place of another drone that waits for it. Otherwise two drones on each other's goals
        would stay there for ever, because neither would gain by leaving alone.
        """
        gap = math.dist(p, self.goal)
        left = max(
            PEAK_SPEED * gap / self.v_max,
            math.sqrt(PEAK_ACCELERATION * gap / self.a_max),
        )
        if gap <= ARRIVAL_DISTANCE:
            return left
        return (
            REST_COSTS.elsewhere
            + REST_COSTS.remaining_flight * left
            + REST_COSTS.awaited_place
            * any(self._occupies(p, place) for place in self.awaited)
        )

    def _occupies(self, p: Vec, place: Vec) -> bool:
        """Return whether a drone at p blocks a place, both (3,) m: |S (p - q)| < D."""
        sy, sz, width, _ = self.figures.tolist()
        d = np.array([1.0, sy, sz]) * (p - place)
        return bool(np.linalg.norm(d) < width)
