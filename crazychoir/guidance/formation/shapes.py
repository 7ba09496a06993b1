"""Shapes for formations (a square, a grid, letters) and the edges between their drones."""

import math
from collections.abc import Mapping
from itertools import combinations

import numpy as np

from crazychoir.errors import ConfigError
from crazychoir.types import Mat, Point

Shape = Mapping[int, Point]
"""{id: (3,) m}."""
PAPER_SQUARE: Shape = {
    0: (0.0, 0.0, 1.0),
    1: (1.0, 0.0, 1.0),
    2: (1.0, 1.0, 1.0),
    3: (0.0, 1.0, 1.0),
}
"""The square of the paper."""
PAPER_SQUARE_EDGES = [[0, 1], [0, 3], [1, 2], [1, 3], [2, 3]]
"""The edges of the paper: the sides and one diagonal."""
LETTER_PLACES: Mapping[str, tuple[tuple[float, float], ...]] = {
    "S": (
        (0.5, 0.667),
        (-0.5, -0.667),
        (0.0, 0.833),
        (-0.45, 0.667),
        (-0.5, 0.3),
        (-0.25, 0.08),
        (0.25, -0.08),
        (0.5, -0.3),
        (0.45, -0.667),
        (0.0, -0.833),
        (0.0, 0.0),
    ),
    "C": (
        (0.5, 0.667),
        (0.5, -0.667),
        (0.25, 0.79),
        (-0.05, 0.833),
        (-0.35, 0.7),
        (-0.5, 0.38),
        (-0.5, 0.0),
        (-0.5, -0.38),
        (-0.35, -0.7),
        (-0.05, -0.833),
        (0.25, -0.79),
    ),
}
"""Eleven places on each letter, in units of the shape.

The first two places are those of the leaders: the ends of the letter.
"""


def grid(columns: int, rows: int, spacing: float, height: float = 1.0) -> Shape:
    """Return a grid, row by row, from the origin."""
    return {
        columns * r + c: (round(spacing * c, 6), round(spacing * r, 6), height)
        for r in range(rows)
        for c in range(columns)
    }


def grid_edges(columns: int, rows: int) -> list[list[int]]:
    """Return the edges of a grid: each drone with its nearest eight.

    These are the sides and both diagonals of every cell.
    """
    ids = [(c, r) for r in range(rows) for c in range(columns)]
    return [
        [columns * r + c, columns * y + x]
        for (c, r), (x, y) in combinations(ids, 2)
        if max(abs(c - x), abs(r - y)) == 1
    ]


def corners(columns: int, rows: int) -> tuple[int, int, int, int]:
    """Return the drones at the corners of a grid."""
    return 0, columns - 1, columns * (rows - 1), columns * rows - 1


def polygon(count: int, side: float) -> Mat:
    """Return the corners of a regular polygon around the origin, (count, 2) m.

    count: number of corners; with one, it lies half a side from the origin.
    side: m: length of a side.
    """
    radius = 0.5 * side / float(np.sin(np.pi / max(count, 2)))
    return ring(count, radius)


def ring(count: int, radius: float) -> Mat:
    """Return evenly spaced places on a circle around the origin, (count, 2) m."""
    angles = 2.0 * np.pi * np.arange(count) / count
    return radius * np.column_stack([np.cos(angles), np.sin(angles)])


def letter(name: str, size: float, height: float = 1.0) -> Shape:
    """Return eleven places of a letter, `size` m high."""
    if name not in LETTER_PLACES:
        raise ConfigError("letter", name, f"one of {', '.join(LETTER_PLACES)}")
    points = LETTER_PLACES[name]
    scale = size / (max(y for _, y in points) - min(y for _, y in points))
    return {
        i: (round(scale * x, 6), round(scale * y, 6), height)
        for i, (x, y) in enumerate(points)
    }


def nearest_edges(shape: Shape, count: int) -> list[list[int]]:
    """Return the `count` shortest pairs of a shape as edges."""
    pairs = sorted(
        combinations(sorted(shape), 2),
        key=lambda pair: (math.dist(shape[pair[0]], shape[pair[1]]), pair),
    )
    return [list(pair) for pair in sorted(pairs[:count])]
