"""Separation in space, for drones whose routes change in flight.

Each flies at a level of its own, and rises and comes down over its own home only: the ways of the others go round it.
"""

import heapq
import math
from collections.abc import Sequence

import numpy as np

from crazychoir.errors import ConfigError
from crazychoir.math3d import Mat, Vec

CORNERS = 8
MARGIN = 1.05
"""How far outside the circle the corners of a detour lie, beyond those of the polygon around it."""


def levels(ids: Sequence[int], lowest: float, spacing: float, highest: float) -> dict[int, float]:
    """m above the ground of each drone, in the order of their ids; raises ConfigError if they do not fit."""
    found = {i: lowest + spacing * n for n, i in enumerate(sorted(ids))}
    top = max(found.values())
    if top > highest:
        do = "Take a smaller level_spacing, a lower takeoff_height, a higher fence or fewer drones."
        raise ConfigError("levels of the drones", f"{top:.2f} m for the highest", f"at most {highest:.2f} m", do)
    return found


def way_round(a: Vec, b: Vec, keep_out: Mat, radius: float, low: Vec, high: Vec) -> list[Vec]:
    """The shortest way from a to b over corners round circles: its points after a, the last one b.

    a, b: (2,) m;  keep_out: (n, 2) m, centres of circles of `radius` m;  low, high: (2,) m, corners of the room.
    A circle that holds a or b does not count; where there is no way round, it is straight.
    """
    ends = np.array([a, b])
    far = [c for c in np.reshape(keep_out, (-1, 2)) if np.linalg.norm(ends - c, axis=1).min() >= radius]
    circles = np.reshape(far, (-1, 2))
    if not len(circles) or _clear(ends[:1], ends[1:], circles, radius)[0, 0]:
        return [ends[1]]
    points = np.vstack([ends, _corners(circles, radius, low, high)])
    return [points[n] for n in _shortest(points, circles, radius)] or [ends[1]]


def _corners(circles: Mat, radius: float, low: Vec, high: Vec) -> Mat:
    """(n, 2) m: corners of the polygons around the circles that lie in the room; no way leads to one in a circle."""
    angles = 2.0 * math.pi * np.arange(CORNERS) / CORNERS
    size = MARGIN * radius / math.cos(math.pi / CORNERS)
    corners = (circles[:, None] + size * np.column_stack([np.cos(angles), np.sin(angles)])).reshape(-1, 2)
    found: Mat = corners[((corners >= low) & (corners <= high)).all(axis=1)]
    return found


def _clear(a: Mat, b: Mat, circles: Mat, radius: float) -> Mat:
    """(n, m): whether the straight way from a[n] to b[m] stays out of all circles."""
    start, way = a[:, None, None], (b[None, :] - a[:, None])[:, :, None]
    to = circles[None, None] - start
    along = (to * way).sum(axis=3) / np.maximum((way**2).sum(axis=3), 1e-12)
    nearest = to - np.clip(along, 0.0, 1.0)[..., None] * way
    clear: Mat = ((nearest**2).sum(axis=3) >= (radius * (1.0 - 1e-9)) ** 2).all(axis=2)
    return clear


def _shortest(points: Mat, circles: Mat, radius: float) -> list[int]:
    """Dijkstra from point 0 to point 1: the points after 0; empty if there is no way."""
    clear = _clear(points, points, circles, radius)
    d = np.linalg.norm(points[:, None] - points[None], axis=2)
    best, before, queue = {0: 0.0}, dict[int, int](), [(0.0, 0)]
    while queue:
        so_far, n = heapq.heappop(queue)
        if n == 1:
            break
        for k in np.flatnonzero(clear[n]).tolist():
            length = so_far + float(d[n, k])
            if length < best.get(k, math.inf):
                best[k], before[k] = length, n
                heapq.heappush(queue, (length, k))
    found, n = [1], 1
    while n in before and before[n] != 0:
        n = before[n]
        found.append(n)
    return found[::-1] if n in before else []
