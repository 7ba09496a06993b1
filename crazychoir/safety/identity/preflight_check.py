"""The check before arming that motion capture sees the right drone, by places and headings.

A drone at rest and level looks like any other, so safety/identity/takeoff_check.py checks again in
the air. Poses are those of the drones: the mounting of each marker body is already removed.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from crazychoir.numerics.math3d import dot, rotation_columns, wrap_angle, yaw_of
from crazychoir.types import Pose, Vec

LARGEST_PLACE_ERROR = 0.05
"""Largest distance in m between a drone's own place and the place where it is seen.

A drone with a larger one stays on the ground.
"""
LARGEST_ANGLE_ERROR = math.radians(5.0)
"""Largest angle in rad between a drone's own attitude and the attitude that is seen."""


@dataclass(frozen=True)
class GroundedDrone:
    """A drone on the ground, before it is armed."""

    home: Vec | None
    """(3,) m, world; None if the drone need not stand at a home."""
    own: Pose | None
    """The pose that the drone reports of itself; None if it reports none."""
    seen: Pose | None
    """The pose that the cameras report of it; None if they report none."""


def find_arming_problems(i: int, drones: Mapping[int, GroundedDrone]) -> list[str]:
    """Return why drone i must not be armed; an empty list if all agrees.

        |p_own - p_seen| <= LARGEST_PLACE_ERROR,   |yaw_own - yaw_seen| <= LARGEST_ANGLE_ERROR,
        angle(z_own, z_seen) <= LARGEST_ANGLE_ERROR,
        argmin_j |p_seen - home_j| = i

    A drone that gets its place from the cameras agrees with any body that they take for it. Then
    only homes, and its motion in the air, distinguish the drones.

    i: id of the drone
    drones: all drones by id
    """
    me = drones[i]
    found = [] if me.own else ["it does not say where it is"]
    if me.seen is None:
        return [*found, "the cameras do not see it"]
    if me.own is not None:
        found += _describe_disagreement(me.own, me.seen)
    return [*found, *_describe_wrong_home(i, drones, me.seen)]


def _describe_disagreement(own: Pose, seen: Pose) -> list[str]:
    """Return how the drone's own pose differs from the seen one."""
    found = []
    far = float(np.linalg.norm(own.p - seen.p))
    if not far <= LARGEST_PLACE_ERROR:
        found.append(
            f"it takes itself to be {far:.2f} m from where it is seen, limit {LARGEST_PLACE_ERROR} m"
        )
    yaw = abs(wrap_angle(yaw_of(own.q) - yaw_of(seen.q)))
    if not yaw <= LARGEST_ANGLE_ERROR:
        found.append(
            f"it looks {math.degrees(yaw):.0f} deg away from how it is seen, limit "
            f"{math.degrees(LARGEST_ANGLE_ERROR):.0f} deg: "
            "its body was defined, or put on, the wrong way round"
        )
    tilt = math.acos(
        max(
            -1.0,
            min(
                1.0,
                dot(
                    rotation_columns(tuple(own.q))[2],
                    rotation_columns(tuple(seen.q))[2],
                ),
            ),
        )
    )
    if not tilt <= LARGEST_ANGLE_ERROR:
        found.append(
            f"it is seen tilted by {math.degrees(tilt):.0f} deg from what it says, limit "
            f"{math.degrees(LARGEST_ANGLE_ERROR):.0f} "
            "deg: its body is mounted askew (`crazychoir mocap calibrate`)"
        )
    return found


def _describe_wrong_home(
    i: int, drones: Mapping[int, GroundedDrone], seen: Pose
) -> list[str]:
    """Return a reason if the drone's body stands at another drone's home."""
    homes = {j: one.home for j, one in drones.items() if one.home is not None}
    if i not in homes:
        return []
    far = {j: float(np.linalg.norm(seen.p - home)) for j, home in homes.items()}
    j = min(far, key=lambda j: far[j])
    if j == i:
        return []
    text = f"its body is {far[j]:.2f} m from the home of drone {j}, {far[i]:.2f} m from its own"
    other = drones[j].seen
    swapped = other is not None and _find_nearest_home(other.p, homes) == i
    return [f"{text}: exchanged with that of drone {j}" if swapped else text]


def _find_nearest_home(p: Vec, homes: Mapping[int, Vec]) -> int:
    """Return the id of the home nearest to p, (3,) m."""
    return min(homes, key=lambda j: float(np.linalg.norm(p - homes[j])))
