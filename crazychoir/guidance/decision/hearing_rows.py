"""What drones hear of their neighbours, as rows: one record for each directed edge.

A row holds the newest state of the neighbour, the memory that corrects late, lost and repeated
states, and the state that the law receives in this step. See StateMailbox and PairedStateMailbox.
"""

import math
from typing import Any

import numpy as np

from crazychoir.guidance.decision.velocity_sums import (
    VELOCITY_SUM_ROW,
    copy_axes,
    copy_state,
    correct_state,
    forget_sum,
    keep_state,
    whole,
)
from crazychoir.numerics.kernels import kernel, real, rows_of, vector
from crazychoir.runtime.clock import NS_PER_SECOND
from crazychoir.runtime.mailbox import AGE_TOLERANCE
from crazychoir.safety.airspace.hearing import are_valid
from crazychoir.types import Vec

HEARING_ROW = np.dtype(
    [
        # The way of the states.
        (
            "source",
            np.int64,
        ),  # place of the neighbour in the batch; or ELSEWHERE_SOURCE, FRAMES_SOURCE
        (
            "frame_place",
            np.int64,
        ),  # with FRAMES_SOURCE: row in the swarm of the airspace
        ("frame_number", np.int64),  # with FRAMES_SOURCE: number of the last state
        ("interval_ns", np.int64),  # ns between two states; 0: each state
        ("due_ns", np.int64),  # ns, when the next state is due
        # What has arrived.
        ("state", np.float64, (13,)),  # the newest state of the neighbour
        ("acceleration", np.float64, (3,)),  # m/s2: its acceleration
        ("age", np.float64),  # s: its age when it was sent
        ("born_ns", np.int64),  # ns: when it was measured, on the clock
        ("version", np.int64),  # number of states that were kept; 0: none
        ("seen_version", np.int64),  # the version that was read last
        ("received", np.int64),  # states that have arrived
        ("dropped", np.int64),  # states that were replaced unread, or came too late
        ("stale", np.int64),  # reads that found only a state that was too old
        # The memory of the law that corrects states.
        ("told_version", np.int64),  # version of the state that the law received last
        ("told_ns", np.int64),  # ns: when that state was measured
        ("sum", VELOCITY_SUM_ROW),  # of the velocities; `last` also serves pairs
        # Settings.
        ("is_paired", np.int64),  # 1: states are paired with accelerations
        ("h_ns", np.int64),  # ns between two states
        ("max_ns", np.int64),  # ns: a state that is older is not heard
        # What the law receives in this step.
        ("is_heard", np.int64),  # 1: the neighbour is heard
        ("unheard", np.int64),  # steps in which it was not heard
        ("told", np.float64, (13,)),  # its state
        ("told_acceleration", np.float64, (3,)),  # m/s2: its acceleration
        ("told_age", np.float64),  # s: age of its message
    ],
    align=True,
)
"""One neighbour of one drone."""


@kernel()
def put_row(
    row: Any, state: Vec, acceleration: Vec, state_age: float, age: float, now_ns: int
) -> None:
    """Keep a state that has arrived, unless its numbers are invalid or the row holds a newer one.

    row: a record of HEARING_ROW
    state: (13,)
    acceleration: (3,) m/s2
    state_age: s: age of the state when it was sent
    age: s: age of the message now
    now_ns: ns: the present time
    """
    row.received += 1
    if not (math.isfinite(age) and are_valid(state, acceleration)):
        row.dropped += 1
        return
    born_ns = now_ns - int(np.rint(age * NS_PER_SECOND))
    if row.version > 0 and born_ns < row.born_ns - AGE_TOLERANCE:
        row.dropped += 1
        return
    if row.version > row.seen_version:
        row.dropped += 1
    row.version += 1
    copy_state(state, row.state)
    copy_axes(acceleration, row.acceleration)
    row.age = state_age
    row.born_ns = born_ns


@kernel()
def take_row(row: Any, now_ns: int, held: int) -> None:
    """Write the state that the law receives in this step, with the age of its message.

    The neighbour is not heard if its newest state is too old.

    row: a record of HEARING_ROW
    now_ns: ns: the present time
    held: number of poses for which the reference of the last step was flown
    """
    row.is_heard = 0
    if row.version == 0 or now_ns - row.born_ns > row.max_ns:
        row.stale += row.version > 0
        forget_sum(row.sum)
        return
    row.is_heard = 1
    row.seen_version = row.version
    copy_axes(row.acceleration, row.told_acceleration)
    row.told_age = (now_ns - row.born_ns) / NS_PER_SECOND
    if row.is_paired == 1:
        _take_pair(row)
    else:
        _take_state(row, held)


@kernel()
def _take_state(row: Any, held: int) -> None:
    """Write the newest state, with a velocity that the law may sum up.

    In a step without a new state it is extrapolated, p + v age.
    """
    steps = (row.born_ns - row.told_ns + row.h_ns // 2) // row.h_ns
    row.told_ns = row.born_ns
    age = row.age
    copy_state(row.state, row.told)
    is_usual = steps == 1 and held == 1 and row.sum.is_even == 1
    if row.version == row.told_version and not is_usual:
        seconds = row.told_age - age
        for c in range(3):
            row.told[c] += seconds * row.told[3 + c]
        age = row.told_age
    row.told_version = row.version
    correct_state(row.sum, row.told, age, held, steps, row.told)


@kernel()
def _take_pair(row: Any) -> None:
    """Write position and velocity of the tick in which the acceleration was commanded.

    Without a new state the last one stays.
    """
    last = row.sum.last
    if row.told_version == row.version and row.sum.has_last == 1:
        return
    steps = int(np.rint((row.born_ns - row.told_ns) / row.h_ns))
    copy_state(row.state, row.told)
    if row.sum.has_last == 1 and steps >= 1:
        share = 1.0 / steps
        for c in range(6):
            row.told[c] += share * (last[c] - row.told[c])
    row.told_version = row.version
    row.told_ns = row.born_ns
    keep_state(row.sum, row.state, row.age)


@kernel(rows_of(HEARING_ROW), vector, vector, real, real, whole)
def put_first_row(
    rows: Any,
    state: Vec,
    acceleration: Vec,
    state_age: float,
    age: float,
    now_ns: int,
) -> bool:
    """Keep a state that has arrived for the first row: see `put_row`.

    Returns whether it has as many numbers as a state: it is not kept otherwise.
    """
    if state.shape[0] != 13 or acceleration.shape[0] != 3:
        return False
    put_row(rows[0], state, acceleration, state_age, age, now_ns)
    return True


@kernel(rows_of(HEARING_ROW), whole, whole)
def take_rows(rows: Any, now_ns: int, held: int) -> None:
    """Write the states that a law receives in this step: see `take_row`.

    rows: (k,) of HEARING_ROW: the neighbours of one drone
    """
    for e in range(rows.shape[0]):
        take_row(rows[e], now_ns, held)
