"""The way home of a drone that its operator calls back: up, across above the others, then down."""

import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from crazychoir.types import Point, Vec


@dataclass(frozen=True, slots=True)
class HomecomingLimits:
    """When a leg of a return is done or given up, and its distances from other drones."""

    arrival_distance: float = 0.2
    """Distance in m from the end of a leg at which the leg is done."""
    attempts: int = 5
    """Number of attempts at a leg before the drone lands where it is."""
    vertical_clearance: float = 0.6
    """Height in m above another drone.

    It is twice the vertical semi-axis (0.3 m) of the ellipsoid that the downwash of a drone fills.
    """
    side_clearance: float = 0.5
    """Distance in m from the straight way home within which another drone is in the way."""


HOMECOMING_LIMITS = HomecomingLimits()


class Homecoming:
    """The legs of a return at one height.

    p: (3,) m, world: where the drone is
    home: (3,) m, world: above this place the return ends
    z: m, smallest height of the return
    """

    def __init__(self, p: Vec, home: Point, z: float) -> None:
        level = max(z, float(p[2]))
        self.legs: list[Vec] = [
            np.array([p[0], p[1], level]),
            np.array([home[0], home[1], level]),
        ]
        self.tries = 0

    def leg(self, p: Vec) -> Vec | None:
        """Return where to fly next from p; None if the drone is above home or makes no progress."""
        while (
            self.legs
            and math.dist(p, self.legs[0]) < HOMECOMING_LIMITS.arrival_distance
        ):
            del self.legs[0]
            self.tries = 0
        self.tries += 1
        return (
            self.legs[0]
            if self.legs and self.tries <= HOMECOMING_LIMITS.attempts
            else None
        )

    @property
    def stuck(self) -> bool:
        """Whether the drone has given up on the way."""
        return bool(self.legs)


def compute_return_height(
    p: Point, home: Point, others: Iterable[Point], rank: int, top: float
) -> float:
    """Return the height in m of a return above all others in the way; at most `top`.

        z = max(z of others within HOMECOMING_LIMITS.side_clearance of the way from p to home, own z)
            + HOMECOMING_LIMITS.vertical_clearance, + rank HOMECOMING_LIMITS.vertical_clearance

    If no other is in the way and the rank is 0, it is the own z.

    p: (3,) m, world: where the drone is
    home: (3,) m, world
    others: (3,) m, world, each: the known places of other drones
    rank: place of the drone among the drones that return at the same time; each flies at a height
        of its own, as far as the room is high enough
    top: m, largest height
    """
    a = np.asarray(p[:2], dtype=float)
    b = np.asarray(home[:2], dtype=float)
    highest = [
        float(q[2])
        for q in others
        if _compute_segment_distance(np.asarray(q[:2], dtype=float), a, b)
        < HOMECOMING_LIMITS.side_clearance
    ]
    if not highest and rank == 0:
        return min(float(p[2]), top)
    return min(
        max([float(p[2]), *highest])
        + (bool(highest) + rank) * HOMECOMING_LIMITS.vertical_clearance,
        top,
    )


def _compute_segment_distance(q: Vec, a: Vec, b: Vec) -> float:
    """Return the distance in m from q, (2,) m, to the segment from a to b."""
    way = b - a
    share = float(np.clip((q - a) @ way / max(float(way @ way), 1e-12), 0.0, 1.0))
    return math.dist(q, a + share * way)
