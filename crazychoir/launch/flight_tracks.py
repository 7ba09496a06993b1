"""The tracks of the drones of a swarm: bounded numbers of places, and the lengths of the paths."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from crazychoir.numerics.kernels import Records, kernel, matrix, real, rows_of
from crazychoir.types import Mat

TRACK_ROW = np.dtype(
    [
        ("place", np.float64, 3),  # m, world: the newest place
        ("velocity", np.float64, 3),  # m/s, world: at that place
        ("time", np.float64),  # s, at which they were true; -inf: never seen
        ("length", np.float64),  # m, of the path through all places
        ("interval", np.float64),  # s, between two places that are kept
        ("kept_time", np.float64),  # s, of the newest place that is kept; -inf: none
        ("is_kept", np.int64),  # 1: the newest place is to be kept
    ]
)
"""The path of one drone."""


@dataclass(frozen=True, slots=True)
class TrackLimits:
    """How much of a path is kept."""

    interval: float = 0.1
    """Seconds between two places of a track, at first."""
    interval_tolerance: float = 1e-6
    """Seconds by which a place may come earlier than after `interval`: times are rounded."""
    most_places: int = 2000
    """Largest number of places in a track.

    Beyond that every second place is removed, and the time between two places doubles.
    """


TRACK_LIMITS = TrackLimits()
_INTERVAL_TOLERANCE = TRACK_LIMITS.interval_tolerance


@kernel(rows_of(TRACK_ROW), matrix, real)
def add_places(rows: Records, states: Mat, time: float) -> None:
    """Add the newest places of drones to their paths, and find the places to keep.

    rows: (n,)
    states: (n, 13) or (n, 6): p in m and v in m/s, world, and further columns
    time: s, at which the states were true
    """
    for k in range(len(rows)):
        row = rows[k]
        if row.time > -math.inf:
            x = states[k, 0] - row.place[0]
            y = states[k, 1] - row.place[1]
            z = states[k, 2] - row.place[2]
            row.length += math.sqrt(x * x + y * y + z * z)
        for axis in range(3):
            row.place[axis] = states[k, axis]
            row.velocity[axis] = states[k, 3 + axis]
        row.time = time
        row.is_kept = 0
        if not time - row.kept_time < row.interval - _INTERVAL_TOLERANCE:
            row.is_kept = 1
            row.kept_time = time


class FlightTracks:
    """The paths of drones. Their memory does not grow with the duration of the flight.

    ids: ids of the drones

    Attributes:
    rows: (n,) of TRACK_ROW, in the order of the ids
    row_of: {drone id: its row}
    kept: for each row, the places that are kept, as rows of t in s and p in m, world
    """

    def __init__(self, ids: Sequence[int]) -> None:
        self.ids = tuple(ids)
        self.row_of = {i: row for row, i in enumerate(self.ids)}
        self.rows = np.zeros(len(self.ids), TRACK_ROW)
        self.rows["time"] = -math.inf
        self.rows["kept_time"] = -math.inf
        self.rows["interval"] = TRACK_LIMITS.interval
        self.kept: list[list[tuple[float, ...]]] = [[] for _ in self.ids]

    def add(self, first: int, states: Mat, time: float) -> None:
        """Add the newest places of drones with consecutive rows.

        first: row of the first drone
        states: (m, 13): p in m and v in m/s, world, and further columns
        time: s, at which the states were true
        """
        rows = self.rows[first : first + len(states)]
        add_places(rows, states, time)
        if not rows["is_kept"].any():
            return
        for at in np.flatnonzero(rows["is_kept"]).tolist():
            kept = self.kept[first + at]
            kept.append((time, *rows["place"][at].tolist()))
            if len(kept) > TRACK_LIMITS.most_places:
                del kept[1::2]
                rows["interval"][at] *= 2.0
