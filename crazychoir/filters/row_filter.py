"""The estimate of all drones of a table, and a filter of one drone on its record."""

from typing import Any

import numpy as np

from crazychoir.filters.derivative_law import estimate_derivative_row
from crazychoir.filters.kalman_law import estimate_kalman_row
from crazychoir.filters.motion import RATE_LAG, CommandedMotion
from crazychoir.filters.rows import (
    FILTER_ROW,
    FilterKind,
    FilterRow,
    FilterRows,
    FilterTable,
    histories,
)
from crazychoir.filters.state_filter import StateFilter
from crazychoir.numerics.kernels import kernel, real, rows_of
from crazychoir.types import Mat, Pose, State, Vec


@kernel()
def estimate_row(row: FilterRow, history: Mat, scratch: Vec, now: float) -> None:
    """Bring the state of a record to `now`, with its new pose or by prediction.

    row: record of the filter
    history: (R, 5): its commands
    scratch: (13,)
    now: s
    """
    if row.kind == FilterKind.KALMAN:
        estimate_kalman_row(row, history, scratch, now)
    elif row.kind == FilterKind.DERIVATIVE:
        estimate_derivative_row(row, now)


@kernel(rows_of(FILTER_ROW), histories, real)
def estimate_rows(rows: FilterRows, history: Vec, now: float) -> None:
    """Bring the states of all records to `now`; records of the kind BY_HAND stay as they are.

    rows: (n,) of FILTER_ROW
    history: (n, R, 5)
    now: s
    """
    scratch = np.empty(13)
    for r in range(rows.shape[0]):
        estimate_row(rows[r], history[r], scratch, now)


def estimate_by_hand(row: FilterRow, state_filter: StateFilter, now: float) -> None:
    """Bring the state of a record of the kind BY_HAND to `now` by a filter in Python.

    row: record of FILTER_ROW
    state_filter: filter of the drone
    now: s
    """
    state_filter.commanded = row["command"].copy()
    state = (
        state_filter.update(Pose(row["pose"].copy(), float(row["pose_age"])), now)
        if row["has_pose"]
        else state_filter.predict(now)
    )
    row["refused"] = state_filter.refused
    row["measured"] = state_filter.measured
    row["is_known"] = state is not None
    if state is not None:
        row["state"] = state.flat
        row["age"] = state.age
        row["speed"] = state_filter.speed


class RowFilter:
    """A StateFilter of one drone. Everything that it knows is in the drone's record.

    table: the record, alone or shared with a table of many drones; it is cleared
    kind: law of the filter
    horizon: s, longest prediction
    period: s, of the cameras; 0 if they have no steady rate
    cutoff: rad/s, of the low-pass; inf without one
    """

    def __init__(
        self,
        table: FilterTable,
        kind: FilterKind,
        horizon: float,
        period: float,
        cutoff: float,
    ) -> None:
        table.clear()
        self._table = table
        self._row: Any = table.rows[0]
        self._row["kind"] = kind
        self._row["horizon"] = horizon
        self._row["period"] = period
        self._row["cutoff"] = cutoff

    def _set_motion(self, motion: CommandedMotion | None) -> None:
        """Write the dynamics under commands into the record. None: the filter knows no commands."""
        row = self._row
        row["rate_lag"] = RATE_LAG
        if motion is not None:
            row["knows_commands"] = 1
            row["floor_height"] = motion.floor
            row["platform"] = motion.platform

    @property
    def commanded(self) -> Vec:
        """(4,): thrust N, body rates rad/s; the sender of the commands sets it."""
        command: Vec = self._row["command"]
        return command

    @commanded.setter
    def commanded(self, command: Vec) -> None:
        self._row["command"] = command

    @property
    def horizon(self) -> float:
        """Longest prediction in s."""
        return float(self._row["horizon"])

    @property
    def cutoff(self) -> float:
        """rad/s, of the low-pass; inf without one."""
        return float(self._row["cutoff"])

    @property
    def measured(self) -> float:
        """Time in s of the last measurement."""
        return float(self._row["measured"])

    @property
    def speed(self) -> float:
        """Speed in m/s of the newest state."""
        return float(self._row["speed"])

    @property
    def refused(self) -> int:
        """Number of poses that were not used."""
        return int(self._row["refused"])

    def update(self, pose: Pose, now: float) -> State | None:
        """Return the state at `now` with a new pose; None only before the first valid pose."""
        row = self._row
        row["pose"] = pose.flat
        row["pose_age"] = pose.age
        row["has_pose"] = 1
        return self._estimate(now)

    def predict(self, now: float) -> State | None:
        """Return the state at `now` without a new pose; None before the first."""
        self._row["has_pose"] = 0
        return self._estimate(now)

    def _estimate(self, now: float) -> State | None:
        """Run the law, and return a frozen copy of the state."""
        estimate_rows(self._table.rows, self._table.history, now)
        return read_state(self._row)


def read_state(row: FilterRow) -> State | None:
    """Return a frozen copy of the state of a record, or None before the first valid pose."""
    if not row["is_known"]:
        return None
    flat = row["state"].copy()
    flat.setflags(write=False)
    return State(flat, float(row["age"]))
