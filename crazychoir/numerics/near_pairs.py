"""Drones that are near each other, found with a tree instead of a comparison of all pairs."""

from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.spatial import cKDTree

from crazychoir.types import Mat, Vec

Rows = npt.NDArray[np.integer[Any]]
"""Numbers of rows."""


class NearestRows(NamedTuple):
    """The nearest other place of each place."""

    rows: Rows
    """(N,): row of the nearest other place."""
    distances: Vec
    """(N,) m: distance to it."""


def find_nearest(places: Mat) -> NearestRows:
    """Return the nearest other place of each place.

    places: (N, 3) m, finite, with N at least 2.
    """
    distances, rows = cKDTree(places).query(places, k=2)
    # A place that others share may find one of them first.
    own = np.arange(len(places))
    second = np.where(rows[:, 0] == own, 1, 0)
    return NearestRows(rows[own, second], distances[own, second])


def list_near_pairs(places: Mat, reach: float) -> Rows:
    """Return (P, 2): the rows i < j of all pairs of places within `reach` m, in increasing order.

    places: (N, 3) m, finite.
    """
    pairs: Rows = cKDTree(places).query_pairs(reach, output_type="ndarray")
    pairs.sort(axis=1)
    return pairs[np.lexsort((pairs[:, 1], pairs[:, 0]))]
