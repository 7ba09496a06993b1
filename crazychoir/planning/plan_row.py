"""The plan of a drone as a record that compiled code samples."""

from enum import IntEnum
from typing import Final

import numpy as np
import numpy.typing as npt

from crazychoir.numerics.kernels import Record, kernel
from crazychoir.planning.piecewise import POLYNOMIAL_DEGREE, Piecewise, sample_pieces
from crazychoir.types import Vec

WINDOW_PIECES = 4
"""Number of pieces of a plan that its record holds at once.

The flights that a pilot plans itself have no more; longer paths are loaded piece by piece.
"""


class PlanKind(IntEnum):
    """How a plan is sampled."""

    NONE = 0
    """There is no plan."""
    PIECES = 1
    """By the pieces in the record."""
    BY_HAND = 2
    """By the trajectory of a user: the pilot writes `sampled` in each tick."""


# In Python 3.11 the access to a member of an enum costs more than the comparison.
NO_PLAN: Final = int(PlanKind.NONE)
"""`PlanKind.NONE` as a plain int."""

PLAN_ROW = np.dtype(
    [
        ("kind", np.int64),  # a PlanKind
        ("start", np.float64),  # s, when the plan began
        ("duration", np.float64),  # s
        ("waited", np.float64),  # s that the plan has waited for its drone
        ("resumed", np.float64),  # s that it had waited when it last began anew
        ("piece_count", np.int64),  # pieces in the record
        ("knots", np.float64, (WINDOW_PIECES + 1,)),  # s since the start
        ("pieces", np.float64, (4 * WINDOW_PIECES, POLYNOMIAL_DEGREE + 1)),
        ("end", np.float64, (14,)),  # state at the end, as FullState.flat
        ("is_waiting", np.int64),  # 1: the plan waits in this tick, at `sampled`
        ("sampled", np.float64, (14,)),  # set-point of now, of a plan by hand
        ("is_over", np.int64),  # 1 if a plan by hand is over now
    ]
)
"""The plan of one drone."""

PlanRows = npt.NDArray[np.void]
"""(n,) records of PLAN_ROW."""


def clear_plan(row: Record) -> None:
    """Remove the plan."""
    row["kind"] = PlanKind.NONE


def load_pieces(row: Record, plan: Piecewise, t: float) -> None:
    """Write the pieces of a plan from the time t on into its record.

    t: s since the start
    """
    knots = plan.knots
    first = int(np.searchsorted(knots[1:-1], max(t, 0.0), side="right"))
    count = min(WINDOW_PIECES, len(knots) - 1 - first)
    rows = plan.rows
    row["kind"] = PlanKind.PIECES
    row["duration"] = plan.duration
    row["piece_count"] = count
    row["knots"][: count + 1] = knots[first : first + count + 1]
    row["pieces"][: 4 * count] = rows[4 * first : 4 * (first + count)]
    row["end"] = plan.end


@kernel()
def is_plan_over(row: Record, now: float) -> bool:
    """Return whether the plan is over at `now` in s; False without a plan."""
    if row.kind == PlanKind.BY_HAND:
        return bool(row.is_over > 0)
    return bool(row.kind == PlanKind.PIECES and now - row.start >= row.duration)


@kernel()
def has_pieces(row: Record, now: float) -> bool:
    """Return whether the record holds the piece of `now` in s."""
    t = max(now - row.start, 0.0)
    return bool(t >= row.duration or row.knots[0] <= t < row.knots[row.piece_count])


@kernel()
def sample_plan(row: Record, now: float, out: Vec) -> None:
    """Write the set-point of the plan at `now` in s, as Piecewise.sample.

    row: with a plan that holds the piece of now
    out: (14,), as FullState.flat
    """
    if row.kind == PlanKind.BY_HAND or row.is_waiting > 0:
        for c in range(14):
            out[c] = row.sampled[c]
        return
    t = now - row.start
    if t >= row.duration:
        for c in range(14):
            out[c] = row.end[c]
        if t > row.duration:
            for c in range(3, 12):
                out[c] = 0.0
            out[13] = 0.0
        return
    count = row.piece_count
    sample_pieces(row.pieces[: 4 * count], row.knots[: count + 1], max(t, 0.0), out)
