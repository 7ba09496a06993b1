"""The tracks of a flight: as structured arrays, and as a table of pandas."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from crazychoir.api.table_extra import import_pandas
from crazychoir.recording.analysis.figures import TRACK_COLUMNS, RecordedTrack

if TYPE_CHECKING:
    from pandas import DataFrame

TRACK_DTYPE = np.dtype(
    [
        ("time", np.float64),  # s since the recording began
        ("position", np.float64, 3),  # m, world
        ("attitude", np.float64, 4),  # quaternion [x, y, z, w], body to world
        ("velocity", np.float64, 3),  # m/s, world
        ("rates", np.float64, 3),  # rad/s, body
        ("reference", np.float64, 3),  # m, world: reference position; NaN: none
        ("estimate", np.float64, 3),  # m, world: estimated position; NaN: none
    ]
)
"""A moment of the track of one drone."""
Track = npt.NDArray[np.void]
"""(n,) of TRACK_DTYPE."""


def build_track(recorded: RecordedTrack) -> Track:
    """Return the track of a drone as a structured array."""
    track = np.zeros(len(recorded.t), TRACK_DTYPE)
    track["time"] = recorded.t
    track["position"] = recorded.p
    track["attitude"] = recorded.q
    track["velocity"] = recorded.v
    track["rates"] = recorded.w
    track["reference"] = recorded.reference
    track["estimate"] = recorded.estimate
    return track


def build_frame(tracks: Sequence[RecordedTrack]) -> "DataFrame":
    """Return all tracks as one table: a column `drone`, then TRACK_COLUMNS.

    Raises ConfigError if pandas is not installed.
    """
    pandas = import_pandas()
    parts = [
        pandas.DataFrame(track.table(), columns=list(TRACK_COLUMNS)).assign(
            drone=track.drone
        )
        for track in tracks
    ]
    whole = pandas.concat(parts, ignore_index=True)
    frame: DataFrame = whole[["drone", *TRACK_COLUMNS]]
    return frame
