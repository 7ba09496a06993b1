"""Where a drone comes down that cannot do so where it is, as others are there."""

import numpy as np

from crazychoir.safety.rules.guard import INSET, Fence
from crazychoir.types import Mat, Vec

RADII, ANGLES = 0.1 * np.arange(21), np.linspace(0.0, 2.0 * np.pi, 24, endpoint=False)
"""m and rad, around the place where it is."""


def nearest_free(p: Vec, others: Mat, fence: Fence) -> Vec | None:
    """The place nearest to p (3,) m, as high, inside the fence and far enough from all others; None: there is none.

    others: (n, 3), x and y m, and how far it must be from there in the plane, m.
    """
    for radius in RADII.tolist():
        for angle in ANGLES.tolist():
            place: Vec = p + radius * np.array([np.cos(angle), np.sin(angle), 0.0])
            inside = (
                np.array_equal(fence.nearest(place, INSET)[0:2], place[0:2])
                or radius == 0.0
            )
            if inside and np.all(
                np.hypot(*(others[:, 0:2] - place[0:2]).T) >= others[:, 2]
            ):
                return place
    return None
