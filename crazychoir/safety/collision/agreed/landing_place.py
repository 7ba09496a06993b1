"""A place to come down for a drone that others keep from landing where it is."""

import numpy as np

from crazychoir.safety.rules.guard import FENCE_INSET, Fence
from crazychoir.types import Mat, Vec

LANDING_SEARCH_RADII = 0.1 * np.arange(21)
"""m, distances from the present place that are tried."""
LANDING_SEARCH_ANGLES = np.linspace(0.0, 2.0 * np.pi, 24, endpoint=False)
"""rad, directions from the present place that are tried."""


def find_free_place(p: Vec, others: Mat, fence: Fence) -> Vec | None:
    """Return the nearest place to p, at the same height, inside the fence and away from all others.

    p: (3,) m, world
    others: (n, 3): x m, y m, and the horizontal distance in m to keep from there
    fence: where the drone flies
    Returns None if there is no such place.
    """
    for radius in LANDING_SEARCH_RADII.tolist():
        for angle in LANDING_SEARCH_ANGLES.tolist():
            place: Vec = p + radius * np.array([np.cos(angle), np.sin(angle), 0.0])
            inside = (
                np.array_equal(fence.nearest(place, FENCE_INSET)[0:2], place[0:2])
                or radius == 0.0
            )
            if inside and np.all(
                np.hypot(*(others[:, 0:2] - place[0:2]).T) >= others[:, 2]
            ):
                return place
    return None
