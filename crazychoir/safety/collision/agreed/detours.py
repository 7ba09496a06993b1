"""The paths to a goal among which a drone chooses: straight, later, by a waypoint, or in part."""

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from crazychoir.numerics.math3d import UPWARD_AXIS
from crazychoir.safety.collision.agreed.paths import (
    PATH_SEARCH,
    compute_end_place,
    compute_motion,
    compute_path_duration,
    find_peak_speed,
    is_outside_box,
    plan_braking,
    plan_flight,
    plan_hold,
)
from crazychoir.safety.collision.agreed.rest_goal import ARRIVAL_DISTANCE, RestGoal
from crazychoir.safety.rules.guard import FENCE_INSET, Fence
from crazychoir.types import Mat, Vec


@dataclass(frozen=True, slots=True)
class DetourChoices:
    """The paths that a drone tries when its straight path is taken, and what they cost."""

    delays: tuple[float, ...] = (0.0, 0.5, 1.0, 1.5, 2.0, 3.0, 4.0, 6.0)
    """s, delays after the drone has come to rest."""
    waypoint_shares: tuple[float, ...] = (0.25, 0.5, 0.75, 0.9)
    """Shares of the straight path at which the drone may wait, or turn aside and back."""
    side_distances: tuple[float, ...] = (0.5, 0.9)
    """m, distances beside the straight path."""
    vertical_distance: float = 0.95
    """m, distance above and below the straight path."""
    random_waypoints: int = 10
    """Number of waypoints that are drawn at random."""
    largest_dip: float = 0.15
    """Largest depth in m below the lowest waypoint for a drone that cannot stop before.

    The floor is there.
    """
    extra_flight_cost: float = 0.3
    """Cost in s of each further flight of a path beside its duration: each must be worth it."""


DETOUR_CHOICES = DetourChoices()


SPEED_TOLERANCE = 1e-6
"""Difference in m/s between two equal speeds, for rounding."""
RANDOM_WAYPOINT_MARGIN = np.array([0.9, 0.9, 1.0])
"""m, margin around the box of the straight path in which waypoints are drawn."""


FlownPath = tuple[Mat, float]
"""A path, (k, 25), and the s for which it has been flown."""


@dataclass(frozen=True)
class PathOption:
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

    def options(
        self, start: Vec, aim: RestGoal, present: FlownPath, most: float
    ) -> list[PathOption]:
        """Return all paths that cost less than `most` s, are slow enough and stay inside the fence.

        A drone falls behind a path that is too fast. No path has a larger peak speed than
        PATH_SEARCH.speed_excess times v_max, or than the drone has at the beginning. Otherwise each new
        path of a drone that accelerates could be faster than its last one. If the drone must leave
        its present path, a path may also be as fast as the path to rest.

        They stay FENCE_INSET inside, unless the drone must leave its present path. A path may be
        nearer to the fence, or outside, if its goal is there, or if the rest of the present path is
        and the drone cannot stop before; but no deeper than DETOUR_CHOICES.largest_dip.

        start: (12,): motion at the beginning
        aim: the goal, where the path ends at rest
        present: the present path
        most: s; infinite if the drone must leave its present path
        """
        braking = plan_braking(start, self.a_max)
        fastest = max(
            PATH_SEARCH.speed_excess * self.v_max, float(np.linalg.norm(start[3:6]))
        )
        if most == math.inf:
            fastest = max(fastest, find_peak_speed(braking))
        inset = FENCE_INSET if most < math.inf else 0.0
        inset_low = np.array(self.fence.low) + inset
        inset_high = np.array(self.fence.high) - inset
        allowed = [start[0:3], aim.goal]
        way, flown = present
        if is_outside_box(way, flown, inset_low, inset_high):
            allowed.append(compute_end_place(braking))
        places = np.array(allowed)
        low = np.minimum(places.min(axis=0), inset_low)
        low[2] = max(
            low[2],
            min(start[2], aim.goal[2], self.fence.low[2] - DETOUR_CHOICES.largest_dip),
        )
        high = np.maximum(places.max(axis=0), inset_high)
        found = [
            option
            for option in (*self._straight(start, aim), *self._by_waypoints(start, aim))
            if option.cost < most
            and not is_outside_box(option.way, 0.0, low, high)
            and find_peak_speed(option.way) <= fastest + SPEED_TOLERANCE
        ]
        return sorted(found, key=lambda option: option.cost)

    def _option(self, aim: RestGoal, *pieces: Mat) -> PathOption:
        """Return the path of these pieces with its cost."""
        way = pieces[0] if len(pieces) == 1 else np.concatenate(pieces)
        return PathOption(
            compute_path_duration(way)
            + aim.missing(compute_end_place(way))
            + DETOUR_CHOICES.extra_flight_cost * (len(way) - 1),
            way,
        )

    def _straight(self, start: Vec, aim: RestGoal) -> Iterator[PathOption]:
        """Yield the straight paths: at once, or after a delay."""
        yield self._option(aim, plan_flight(start, aim.goal, self.v_max, self.a_max))
        rest = plan_braking(start, self.a_max)
        stopped = compute_motion(rest, compute_path_duration(rest))
        later = plan_flight(stopped, aim.goal, self.v_max, self.a_max)
        for delay in DETOUR_CHOICES.delays:
            yield self._option(aim, rest, plan_hold(stopped[0:3], delay), later)

    def _by_waypoints(self, start: Vec, aim: RestGoal) -> Iterator[PathOption]:
        """Yield the paths over a waypoint, or to it only."""
        for point in self._waypoints(start[0:3], aim.goal):
            first = plan_flight(start, point, self.v_max, self.a_max)
            yield self._option(aim, first)
            there = compute_motion(first, compute_path_duration(first))
            yield self._option(
                aim, first, plan_flight(there, aim.goal, self.v_max, self.a_max)
            )

    def _waypoints(self, p: Vec, goal: Vec) -> Iterator[Vec]:
        """Yield waypoints: on the straight path, beside, above and below it, and random ones."""
        straight = goal - p
        flat = math.hypot(straight[0], straight[1])
        side = (
            np.array([-straight[1], straight[0], 0.0]) / flat
            if flat > ARRIVAL_DISTANCE
            else np.array([0.0, 1.0, 0.0])
        )
        for share in DETOUR_CHOICES.waypoint_shares:
            on = p + share * straight
            yield self._inside(on)
            if share < DETOUR_CHOICES.waypoint_shares[-1]:
                for far in DETOUR_CHOICES.side_distances:
                    yield self._inside(on + far * side)
                    yield self._inside(on - far * side)
                yield self._inside(on + DETOUR_CHOICES.vertical_distance * UPWARD_AXIS)
                yield self._inside(on - DETOUR_CHOICES.vertical_distance * UPWARD_AXIS)
        low = np.minimum(p, goal) - RANDOM_WAYPOINT_MARGIN
        high = np.maximum(p, goal) + RANDOM_WAYPOINT_MARGIN
        for point in self.draw.uniform(low, high, (DETOUR_CHOICES.random_waypoints, 3)):
            yield self._inside(point)

    def _inside(self, p: Vec) -> Vec:
        """Return the place inside the fence that is nearest to p."""
        return self.fence.nearest(p)
