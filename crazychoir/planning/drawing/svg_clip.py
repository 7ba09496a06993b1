"""Clips of SVG documents: outlines outside which nothing is seen."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from crazychoir.types import Mat


@dataclass(frozen=True)
class ClipOutline:
    """A convex outline outside which nothing is seen."""

    corners: Mat
    """(k, 2), k >= 3, one after the other, in units of the picture."""
    owner: str
    """Its name in errors."""

    def sides_passed(self, places: Mat) -> Mat:
        """Return for each side (rows) whether each place (columns) is inside it or on it."""
        sides = np.roll(self.corners, -1, axis=0) - self.corners
        x = places[None, :, 0] - self.corners[:, None, 0]
        y = places[None, :, 1] - self.corners[:, None, 1]
        turns = (sides[:, None, 0] * y - sides[:, None, 1] * x) * find_orientation(
            self.corners
        )
        slack = 1e-6 * np.abs(sides).max() ** 2
        passed: Mat = turns >= -slack
        return passed


def find_convex_corners(strokes: Sequence[Mat]) -> Mat | None:
    """Return the corners of a convex shape with these strokes as its outline.

    Returns None for another shape.
    """
    if len(strokes) != 1:
        return None
    stroke = strokes[0]
    is_new = (
        np.linalg.norm(stroke - np.roll(stroke, 1, axis=0), axis=1)
        > 1e-9 * np.abs(stroke).max()
    )
    corners = stroke[is_new]
    return corners if len(corners) >= 3 and find_orientation(corners) else None


def find_orientation(corners: Mat) -> float:
    """Return 1 or -1 for corners (k, 2) that turn one way or the other, once around; else 0."""
    sides = np.roll(corners, -1, axis=0) - corners
    after = np.roll(sides, -1, axis=0)
    turns = sides[:, 0] * after[:, 1] - sides[:, 1] * after[:, 0]
    angles = np.arctan2(turns, (sides * after).sum(axis=1))
    if abs(abs(angles.sum()) - 2.0 * np.pi) > 0.1:
        return 0.0
    small = 1e-9 * np.abs(sides).max() ** 2
    if (turns >= -small).all():
        return 1.0
    return -1.0 if (turns <= small).all() else 0.0
