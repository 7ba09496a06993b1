"""The law of VelocitySum as rows: velocities that a law may sum up, whatever messages are lost."""

import math
from typing import Any

import numba
import numpy as np

from crazychoir.numerics.kernels import kernel, memory, real, rows_of, vector
from crazychoir.types import Vec

whole: Any = numba.int64
"""A whole number that a kernel reads."""

CORRECTION_STEPS = 10.0  # steps in which a missing amount of velocity is made up
NEGLIGIBLE_AMOUNT = 1e-7  # m: smaller amounts are not made up

VELOCITY_SUM_ROW = np.dtype(
    [
        ("h", np.float64),  # s between two poses of the filter
        ("reach", np.float64),  # s: T of VelocitySum
        ("spread", np.float64),  # s in which an owed amount is made up
        ("is_even", np.int64),  # 1: no amount is owed
        ("has_last", np.int64),  # 1: `last` is a state
        ("last", np.float64, (13,)),  # the state before, with its own velocity
        ("last_age", np.float64),  # s: its age
        ("received", np.float64, (3,)),  # m/s: the velocity that the law received last
        ("owed", np.float64, (3,)),  # m: the owed amount
    ],
    align=True,
)
"""One VelocitySum: its settings and its memory."""


@kernel()
def copy_state(state: Vec, target: Vec) -> None:
    """Copy a state (13,); the loop is several times faster than a slice."""
    for c in range(13):
        target[c] = state[c]


@kernel()
def copy_axes(vector: Vec, target: Vec) -> None:
    """Copy a vector (3,)."""
    for c in range(3):
        target[c] = vector[c]


@kernel()
def forget_sum(sums: Any) -> None:
    """Forget the last state and the owed amount.

    sums: a record of VELOCITY_SUM_ROW
    """
    sums.has_last = 0
    sums.is_even = 1


@kernel()
def keep_state(sums: Any, state: Vec, age: float) -> None:
    """Keep the state that the law received last.

    sums: a record of VELOCITY_SUM_ROW
    state: (13,)
    age: s, of the state
    """
    copy_state(state, sums.last)
    sums.last_age = age
    sums.has_last = 1


@kernel()
def correct_state(
    sums: Any, state: Vec, age: float, held: int, steps: int, told: Vec
) -> bool:
    """Write the state with the velocity that keeps the sum right: see VelocitySum.

    sums: a record of VELOCITY_SUM_ROW
    state: (13,), extrapolated from the measurement by its age, at constant velocity
    age: s
    held: number of poses for which the state before was flown
    steps: number of poses from the measurement before to this one; 0: the same measurement
    told: (13,), written; it may be `state` itself
    Returns whether the velocity was corrected.
    """
    if (held == 1 and steps == 1 and sums.is_even == 1) or sums.has_last == 0:
        keep_state(sums, state, age)
        copy_state(state, told)
        return False
    if sums.is_even == 1:
        for c in range(3):
            sums.received[c] = sums.last[3 + c]
            sums.owed[c] = 0.0
    before = sums.reach + sums.last_age
    now = sums.reach + age
    seconds = held * sums.h
    most = 0.0
    for c in range(3):
        velocity = state[3 + c]
        owed = sums.owed[c] - seconds * sums.received[c]
        if steps > 0:
            owed += (state[c] - now * velocity) - (
                sums.last[c] - before * sums.last[3 + c]
            )
            is_small = seconds < 2.0 * sums.spread
            owed = owed if is_small and math.isfinite(owed) else 0.0
            sums.received[c] = velocity + owed / sums.spread
        else:
            sums.received[c] = velocity
        sums.owed[c] = owed
        most = max(most, abs(owed))
    sums.is_even = int(most < NEGLIGIBLE_AMOUNT)
    if steps > 0:
        keep_state(sums, state, age)
    copy_state(state, told)
    for c in range(3):
        told[3 + c] = sums.received[c]
    return True


@kernel(rows_of(VELOCITY_SUM_ROW), vector, real, whole, whole, memory)
def correct_first_row(
    rows: Any, state: Vec, age: float, held: int, steps: int, told: Vec
) -> bool:
    """Correct a state by the sum in the first row: see `correct_state`."""
    return bool(correct_state(rows[0], state, age, held, steps, told))
