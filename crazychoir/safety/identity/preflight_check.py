"""Whether motion capture sees the drone that it says, before it is armed: by places and headings.

A drone at rest and level looks like any other, so safety/identity/takeoff_check.py checks again in the air. Poses are
those of the drones: the mounting of each marker body is already removed.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from crazychoir.numerics.math3d import columns, dot, wrap, yaw_of
from crazychoir.types import Pose, Vec

PLACE, ANGLE = 0.05, math.radians(5.0)
"""m, rad: more than this between what a drone says of itself and what is seen of it keeps it on the ground."""


@dataclass(frozen=True)
class Standing:
    """A drone on the ground, before it is armed.

    home: (3,) m, None if it need not stand there;  own: what it says of itself, seen: what the cameras say of it, None
    where nothing is said.
    """

    home: Vec | None
    own: Pose | None
    seen: Pose | None


def before_arming(i: int, drones: Mapping[int, Standing]) -> list[str]:
    """Why drone i must not be armed; nothing if all agrees.

        |p_own - p_seen| <= PLACE,   |yaw_own - yaw_seen| <= ANGLE,   angle(z_own, z_seen) <= ANGLE,
        argmin_j |p_seen - home_j| = i

    A drone that is told where it is by the cameras agrees with whatever body it is told: then only homes, and what it
    does in the air, tell one from another.
    """
    me = drones[i]
    found = [] if me.own else ["it does not say where it is"]
    if me.seen is None:
        return [*found, "the cameras do not see it"]
    if me.own is not None:
        found += _disagreement(me.own, me.seen)
    return [*found, *_elsewhere(i, drones, me.seen)]


def _disagreement(own: Pose, seen: Pose) -> list[str]:
    """What it says of itself, beside what is seen of it."""
    found = []
    far = float(np.linalg.norm(own.p - seen.p))
    if not far <= PLACE:
        found.append(
            f"it takes itself to be {far:.2f} m from where it is seen, limit {PLACE} m"
        )
    yaw = abs(wrap(yaw_of(own.q) - yaw_of(seen.q)))
    if not yaw <= ANGLE:
        found.append(
            f"it looks {math.degrees(yaw):.0f} deg away from how it is seen, limit {math.degrees(ANGLE):.0f} deg: "
            "its body was defined, or put on, the wrong way round"
        )
    tilt = math.acos(
        max(-1.0, min(1.0, dot(columns(tuple(own.q))[2], columns(tuple(seen.q))[2])))
    )
    if not tilt <= ANGLE:
        found.append(
            f"it is seen tilted by {math.degrees(tilt):.0f} deg from what it says, limit {math.degrees(ANGLE):.0f} "
            "deg: its body is mounted askew (`crazychoir mocap calibrate`)"
        )
    return found


def _elsewhere(i: int, drones: Mapping[int, Standing], seen: Pose) -> list[str]:
    """Whether its body stands at somebody else's home."""
    homes = {j: one.home for j, one in drones.items() if one.home is not None}
    if i not in homes:
        return []
    far = {j: float(np.linalg.norm(seen.p - home)) for j, home in homes.items()}
    j = min(far, key=lambda j: far[j])
    if j == i:
        return []
    text = f"its body is {far[j]:.2f} m from the home of drone {j}, {far[i]:.2f} m from its own"
    other = drones[j].seen
    swapped = other is not None and _nearest(other.p, homes) == i
    return [f"{text}: exchanged with that of drone {j}" if swapped else text]


def _nearest(p: Vec, homes: Mapping[int, Vec]) -> int:
    return min(homes, key=lambda j: float(np.linalg.norm(p - homes[j])))
