"""Propose which body belongs to which drone, from their positions."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import linear_sum_assignment

from crazychoir.mocap.frames import PoseFrame
from crazychoir.types import Vec

HOME_RADIUS = 0.3
"""Metres from its home within which a drone is assumed to stand there."""


@dataclass(frozen=True)
class BodyMeasurement:
    """The measurements of a body."""

    name: str
    """Name of the body."""
    p: Vec
    """(3,) m: mean position."""
    spread: float
    """m: largest distance from the mean position."""
    rate: float
    """Hz."""


@dataclass(frozen=True)
class BodyMatch:
    """A body and the drone that it probably belongs to."""

    drone: int
    """Id of the drone."""
    name: str
    """Name of the body."""
    distance: float
    """m: distance of the body from the drone's home."""

    @property
    def sure(self) -> bool:
        """Whether the body is near enough to the home."""
        return self.distance <= HOME_RADIUS


def measure_bodies(
    frames: Sequence[PoseFrame], seconds: float
) -> list[BodyMeasurement]:
    """Return the bodies in the frames of so many seconds, by name."""
    places: dict[str, list[Vec]] = {}
    for frame in frames:
        for name, flat in frame.bodies.items():
            places.setdefault(name, []).append(flat[0:3])
    return [
        _measure_body(name, np.array(at), seconds)
        for name, at in sorted(places.items())
    ]


def _measure_body(name: str, at: Vec, seconds: float) -> BodyMeasurement:
    p = at.mean(axis=0)
    return BodyMeasurement(
        name, p, float(np.linalg.norm(at - p, axis=1).max()), len(at) / seconds
    )


def match_bodies(
    seen: Sequence[BodyMeasurement], homes: Mapping[int, Sequence[float]]
) -> list[BodyMatch]:
    """Return one body for each drone, with the least sum of distances.

    If there are too few bodies, some drones have none.

        min sum_i |p_m(i) - h_i|,  m one to one

    A height counts like the other coordinates, so that swapped drones on two levels are found.

    seen: the bodies
    homes: (3,) m: h_i, the home of drone i
    """
    if not seen or not homes:
        return []
    ids = sorted(homes)
    cost = np.array(
        [
            [float(np.linalg.norm(body.p - np.asarray(homes[i]))) for body in seen]
            for i in ids
        ]
    )
    rows, columns = linear_sum_assignment(cost)
    return [
        BodyMatch(ids[r], seen[c].name, float(cost[r, c]))
        for r, c in zip(rows, columns, strict=True)
    ]
