"""The records of the filters: one record a drone, in one table for many drones."""

from dataclasses import dataclass
from enum import IntEnum
from typing import Any, Self

import numba
import numpy as np
import numpy.typing as npt

from crazychoir.types import Vec


class FilterKind(IntEnum):
    """The law that estimates the state of a drone."""

    BY_HAND = 0
    """A filter in Python; the compiled laws leave its record alone."""
    KALMAN = 1
    """The law of KalmanFilter."""
    DERIVATIVE = 2
    """The law of VelocityFilter."""


DIFFERENCE_ORDER = 4
"""Order of the differences of the positions by which their noise is measured."""

FILTER_ROW = np.dtype(
    [
        ("kind", np.int64),  # FilterKind
        # Inputs of a tick.
        ("pose", np.float64, (7,)),  # the newest pose, as Pose.flat
        ("pose_age", np.float64),  # s since the cameras saw the body
        ("has_pose", np.int64),  # 1 if the pose is new in this tick, else 0
        ("command", np.float64, (4,)),  # N and rad/s, obeyed from this tick on
        # Settings of all filters.
        ("horizon", np.float64),  # s, longest prediction
        ("period", np.float64),  # s, of the cameras; 0 if they have no steady rate
        ("cutoff", np.float64),  # rad/s, of the low-pass; inf without one
        # Settings: the dynamics under commands.
        ("knows_commands", np.int64),  # 1 if the filter knows the commands, else 0
        ("floor_height", np.float64),  # m
        ("rate_lag", np.float64),  # s, of the body rates behind the recorded rates
        ("platform", np.float64, (9,)),  # Platform.flat
        # Settings of the Kalman filter.
        ("place_variance", np.float64),  # m2, of a measured position an axis
        ("measures_noise", np.int64),  # 1 if place_variance follows the poses, else 0
        ("attitude_variance", np.float64),  # rad2, of a measured attitude an axis
        ("jerk_density", np.float64),  # m2/s5, of n_j
        ("push_density", np.float64),  # m2/s3, of n_s
        ("swing_density", np.float64),  # rad2/s3, of n_g
        ("knows_loop", np.int64),  # 1 if the rate loop on board is known, else 0
        ("loop", np.float64, (3, 5)),  # the rate loop, as `loop` of KalmanFilter
        # Memory: the state at the last measurement.
        ("measured_state", np.float64, (13,)),
        # Memory of the Kalman filter.
        ("disturbance", np.float64, (3,)),  # m/s2: d at the last measurement
        ("place_covariance", np.float64, (6,)),  # of (p, v, d): pp pv pd vv vd dd
        ("attitude_covariance", np.float64, (3,)),  # of (a, w): aa aw ww
        ("place_differences", np.float64, (DIFFERENCE_ORDER, 3)),  # m, of orders 0 to 3
        ("pose_interval", np.float64),  # s, between the last two poses
        ("even_poses", np.int64),  # newest poses at even intervals
        (
            "noise_time",
            np.float64,
        ),  # s of measurements in place_variance, at most its memory
        ("doubts", np.int64),  # poses beyond the gate since the last accepted pose
        ("call_time", np.float64),  # s, of the last tick
        ("newest_command", np.int64),  # index of the newest command of the history
        ("loop_rate", np.float64, (3,)),  # rad/s: r of the rate loop
        ("loop_acceleration", np.float64, (3,)),  # rad/s2: r' of the rate loop
        ("loop_integral", np.float64, (3,)),  # rad: integral of e of the rate loop
        # Outputs.
        ("state", np.float64, (13,)),  # the state of this tick, as State.flat
        ("age", np.float64),  # s since the state was measured
        ("speed", np.float64),  # m/s, of the state
        ("measured", np.float64),  # s, time of the last measurement; -inf before it
        ("refused", np.int64),  # number of poses that were not used
        ("is_known", np.int64),  # 0 before the first valid pose, then 1
    ],
    align=True,
)
"""The record of the filter of one drone."""

FilterRow = Any
"""A record of FILTER_ROW."""
FilterRows = npt.NDArray[Any]
"""An array (n,) of records of FILTER_ROW."""
histories: Any = numba.float64[:, :, ::1]
"""Type of the histories (n, R, 5) of n drones for kernels."""

HISTORY_COLUMNS = 5  # start s, thrust N, body rates rad/s


@dataclass(frozen=True, slots=True)
class FilterTable:
    """The records of the filters of n drones, with the commands that the drones obeyed."""

    rows: FilterRows
    """(n,) of FILTER_ROW."""
    history: Vec
    """(n, R, HISTORY_COLUMNS): the last R commands of each drone, a ring.

    A row holds the time since when the command was obeyed, its thrust and the body rates.
    """

    @classmethod
    def allocate(cls, drones: int, history_size: int) -> Self:
        """Return a table of empty records. Their kind is BY_HAND.

        drones: n
        history_size: R, see `compute_history_size`
        """
        return cls(
            np.zeros(drones, FILTER_ROW),
            np.zeros((drones, history_size, HISTORY_COLUMNS)),
        )

    def share_row(self, r: int) -> Self:
        """Return the table of the record r alone. It shares the memory of this table."""
        return type(self)(self.rows[r : r + 1], self.history[r : r + 1])

    def clear(self) -> None:
        """Set all records to the time before the first pose and the first command."""
        self.rows[:] = np.zeros(1, FILTER_ROW)
        self.rows["call_time"] = -np.inf
        self.rows["measured"] = -np.inf
        self.history[:] = 0.0
        self.history[:, :, 0] = -np.inf
