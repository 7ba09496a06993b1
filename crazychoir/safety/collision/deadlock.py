"""Deadlock: drones in each other's way all pass on the same side.

A stuck drone tries the other side.
"""

import math
from typing import NamedTuple

import numpy as np

from crazychoir.numerics.kernels import kernel
from crazychoir.numerics.math3d import Triple, dot
from crazychoir.types import Records, Vec

LARGEST_TURNED_ACCELERATION = 4.0
"""Largest acceleration, m/s2, that is turned."""


class StuckLimits(NamedTuple):
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

PASSING_SIDE_FIELDS = [
    (
        "side",
        np.float64,
    ),  # 1: anticlockwise, as all drones pass others; -1: the other side
    # s, before the drone changes side. The value differs between drones: two that turn at once
    # would stay in each other's way.
    ("patience", np.float64),
    ("has_place", np.int64),  # 1: stuck_place is known
    ("stuck_place", np.float64, 3),  # m, where the drone has been since stuck_time
    ("stuck_time", np.float64),  # s
    ("gave_way_time", np.float64),  # s, when the drone last gave way; -inf: never
]
"""Fields of a record: the side on which one drone passes others.

Between two drones that stay where they are, the common side may be a dead end. Then the drone tries
the other side until it is free.
"""


def reset_side(row: Records, drone: int) -> None:
    """Let a drone pass others on the common side, as if it had never given way.

    row: record, or array of records, with PASSING_SIDE_FIELDS
    drone: its id
    """
    row["side"] = 1.0
    row["patience"] = STUCK_LIMITS.stuck_time + 0.2 * (drone % 8)
    row["has_place"] = 0
    row["gave_way_time"] = -math.inf


@kernel()
def compute_place_distance(p: Vec, q: Vec) -> float:
    """Return |p - q| in m, of p (>= 3,) and q (>= 3,)."""
    x = p[0] - q[0]
    y = p[1] - q[1]
    z = p[2] - q[2]
    return math.sqrt(x * x + y * y + z * z)


@kernel()
def note_giving_way(row: Records, p: Vec, goal: Vec, now: float) -> None:
    """Note that a drone gives way, and let it change side if it is stuck.

    row: record with PASSING_SIDE_FIELDS
    p: (3,) m: where it is
    goal: (3,) m: where it wants to be
    now: s
    """
    if now > row.gave_way_time + STUCK_LIMITS.free_time:
        row.side = 1.0
        row.has_place = 0
    row.gave_way_time = now
    if (
        row.has_place == 0
        or compute_place_distance(p, row.stuck_place) > STUCK_LIMITS.moved_distance
        or compute_place_distance(p, goal) < STUCK_LIMITS.goal_distance
    ):
        row.has_place = 1
        for c in range(3):
            row.stuck_place[c] = p[c]
        row.stuck_time = now
    elif now > row.stuck_time + row.patience:
        row.side = -row.side
        row.stuck_time = now


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
