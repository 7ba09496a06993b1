"""The paths to a goal among which a drone chooses: straight, later, by a waypoint, or in part."""

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from crazychoir.numerics.math3d import E3
from crazychoir.safety.collision.agreed.paths import (
    braking,
    end,
    flight,
    hold,
    leaves,
    moving,
    seconds,
)
from crazychoir.safety.collision.agreed.rest_goal import NEAR, Aim
from crazychoir.safety.rules.guard import INSET, Fence
from crazychoir.types import Mat, Vec

DELAYS = (0.0, 0.5, 1.0, 1.5, 2.0, 3.0, 4.0, 6.0)
"""s, delays after the drone has come to rest."""
SHARES = (0.25, 0.5, 0.75, 0.9)
"""Shares of the straight path at which the drone may wait, or turn aside and back."""
ASIDE = (0.5, 0.9)
"""m, distances beside the straight path."""
ABOVE = 0.95
"""m, distance above and below the straight path."""
DRAWN = 10
"""Number of waypoints that are drawn at random."""
AROUND = np.array([0.9, 0.9, 1.0])
"""m, margin around the box of the straight path in which waypoints are drawn."""
DIP = 0.15
"""Largest depth in m below the lowest waypoint for a drone that cannot stop before.

The floor is there.
"""
TURN = 0.3
"""Cost in s of each further flight of a path beside its duration: each must be worth it."""


@dataclass(frozen=True)
class Option:
    """A path and its cost."""

    cost: float
    """s."""
    way: Mat
    """(k, 25): the path."""


class Detours:
    """Finds paths from a motion to a goal, cheapest first.

    v_max: m/s, of go_to
    a_max: m/s2, of go_to
    fence: where paths and their waypoints are
    draw: source of the random waypoints
    """

    def __init__(
        self, v_max: float, a_max: float, fence: Fence, draw: np.random.Generator
    ) -> None:
        self.v_max = v_max
        self.a_max = a_max
        self.fence = fence
        self.draw = draw

    def options(self, start: Vec, aim: Aim, most: float) -> list[Option]:
        """Return all paths that cost less than `most` s and stay INSET inside the fence.

        A path may be nearer to the fence, or outside, if the drone cannot stop before, or if its
        goal is there; but no deeper than DIP.

        start: (12,): motion at the beginning
        aim: the goal, where the path ends at rest
        most: s
        """
        places = np.array([start[0:3], aim.goal, end(braking(start, self.a_max))])
        low = np.minimum(places.min(axis=0), np.array(self.fence.low) + INSET)
        low[2] = max(low[2], min(start[2], aim.goal[2], self.fence.low[2] - DIP))
        high = np.maximum(places.max(axis=0), np.array(self.fence.high) - INSET)
        found = [
            option
            for option in (*self._straight(start, aim), *self._by_waypoints(start, aim))
            if option.cost < most and not leaves(option.way, low, high)
        ]
        return sorted(found, key=lambda option: option.cost)

    def _option(self, aim: Aim, *pieces: Mat) -> Option:
        """Return the path of these pieces with its cost."""
        way = pieces[0] if len(pieces) == 1 else np.concatenate(pieces)
        return Option(seconds(way) + aim.missing(end(way)) + TURN * (len(way) - 1), way)

    def _straight(self, start: Vec, aim: Aim) -> Iterator[Option]:
        """Yield the straight paths: at once, or after a delay."""
        yield self._option(aim, flight(start, aim.goal, self.v_max, self.a_max))
        rest = braking(start, self.a_max)
        stopped = moving(rest, seconds(rest))
        later = flight(stopped, aim.goal, self.v_max, self.a_max)
        for delay in DELAYS:
            yield self._option(aim, rest, hold(stopped[0:3], delay), later)

    def _by_waypoints(self, start: Vec, aim: Aim) -> Iterator[Option]:
        """Yield the paths over a waypoint, or to it only."""
        for point in self._waypoints(start[0:3], aim.goal):
            first = flight(start, point, self.v_max, self.a_max)
            yield self._option(aim, first)
            there = moving(first, seconds(first))
            yield self._option(
                aim, first, flight(there, aim.goal, self.v_max, self.a_max)
            )

    def _waypoints(self, p: Vec, goal: Vec) -> Iterator[Vec]:
        """Yield waypoints: on the straight path, beside, above and below it, and random ones."""
        straight = goal - p
        flat = math.hypot(straight[0], straight[1])
        side = (
            np.array([-straight[1], straight[0], 0.0]) / flat
            if flat > NEAR
            else np.array([0.0, 1.0, 0.0])
        )
        for share in SHARES:
            on = p + share * straight
            yield self._inside(on)
            if share < SHARES[-1]:
                for far in ASIDE:
                    yield self._inside(on + far * side)
                    yield self._inside(on - far * side)
                yield self._inside(on + ABOVE * E3)
                yield self._inside(on - ABOVE * E3)
        low = np.minimum(p, goal) - AROUND
        high = np.maximum(p, goal) + AROUND
        for point in self.draw.uniform(low, high, (DRAWN, 3)):
            yield self._inside(point)

    def _inside(self, p: Vec) -> Vec:
        """Return the place inside the fence that is nearest to p."""
        return self.fence.nearest(p)
