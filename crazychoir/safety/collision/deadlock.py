"""Deadlock: drones in each other's way all pass on the same side.

A stuck drone tries the other side.
"""

import math
from dataclasses import dataclass

from crazychoir.numerics.kernels import kernel
from crazychoir.numerics.math3d import Triple, dot
from crazychoir.types import Vec

LARGEST_TURNED_ACCELERATION = 4.0
"""Largest acceleration, m/s2, that is turned."""


@dataclass(frozen=True, slots=True)
class StuckLimits:
    """When a drone is stuck and passes others on the other side, and when it is free again."""

    stuck_time: float = 4.0
    """Seconds with little motion after which a drone is stuck."""
    moved_distance: float = 0.3
    """Distance in m beyond which a drone is not stuck."""
    goal_distance: float = 0.3
    """Distance in m from its goal within which a drone is not stuck."""
    free_time: float = 1.0
    """Seconds without giving way after which a drone passes others on the common side again."""


STUCK_LIMITS = StuckLimits()


@kernel()
def turn_sideways(u: Triple, planes: Vec, first: int, last: int, turn: float) -> Triple:
    """Return the wanted acceleration, turned sideways by what each half space takes away from it.

        u + turn sum_k max(b_k - n_k . u, 0) e3 x n_k

    n_k points away from the other drone. So both drones turn about their middle in the same sense,
    anticlockwise seen from above. A standstill, in which all of the wanted acceleration is taken
    away, is thereby avoided.

    u: (3,) m/s2: what is wanted
    planes: rows n_k, b_k
    first: first row of another drone
    last: the row after the last one
    turn: sideways share
    """
    x = 0.0
    y = 0.0
    for k in range(first, last):
        lack = planes[k, 3] - dot((planes[k, 0], planes[k, 1], planes[k, 2]), u)
        if lack > 0.0:
            x -= turn * min(lack, LARGEST_TURNED_ACCELERATION) * planes[k, 1]
            y += turn * min(lack, LARGEST_TURNED_ACCELERATION) * planes[k, 0]
    return (u[0] + x, u[1] + y, u[2])


class PassingSide:
    """The side on which one drone passes others: anticlockwise as all do, unless it is stuck.

    Between two drones that stay where they are, that side may be a dead end. Then the drone tries
    the other side until it is free.

    drone: its id
    """

    def __init__(self, drone: int = 0) -> None:
        self.sign = 1.0
        self.patience = STUCK_LIMITS.stuck_time + 0.2 * (drone % 8)
        """Seconds before the drone changes side.

        The value differs between drones: two that turn at once would stay in each other's way.
        """
        self._at: list[float] | None = None
        self._since = 0.0
        self._gave_way = -math.inf

    def gives_way(self, p: Vec, goal: Vec, now: float) -> None:
        """Note that the drone gives way.

        p: (3,) m: where it is
        goal: (3,) m: where it wants to be
        now: s
        """
        if now > self._gave_way + STUCK_LIMITS.free_time:
            self.sign = 1.0
            self._at = None
        self._gave_way = now
        here = p.tolist()
        if (
            self._at is None
            or math.dist(here, self._at) > STUCK_LIMITS.moved_distance
            or math.dist(here, goal.tolist()) < STUCK_LIMITS.goal_distance
        ):
            self._at = here
            self._since = now
        elif now > self._since + self.patience:
            self.sign = -self.sign
            self._since = now
