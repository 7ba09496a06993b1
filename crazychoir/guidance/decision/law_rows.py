"""The laws of drones as rows: when each is due, what it receives, and the reference that it gives."""

import math
from enum import IntEnum
from typing import Any, Final

import numpy as np

from crazychoir.guidance.decision.hearing_rows import HEARING_ROW, take_row
from crazychoir.guidance.decision.velocity_sums import (
    VELOCITY_SUM_ROW,
    copy_axes,
    copy_state,
    correct_state,
    keep_state,
    whole,
)
from crazychoir.numerics.kernels import (
    NO_COUNTING,
    kernel,
    memory,
    rows_of,
    table,
    wholes,
)
from crazychoir.types import Ints, Mat, Vec


class LawPermission(IntEnum):
    """What the mode of the pilot allows a law."""

    STEPS = 0
    """The law may step."""
    WAITS = 1
    """The drone still takes off: the law waits."""
    ENDS = 2
    """The pilot does something else: the law ends."""


class LawDecision(IntEnum):
    """What a law does in this tick."""

    REST = 0
    """Nothing: it is not due."""
    STEP = 1
    """It steps."""
    END = 2
    """It ends, because the pilot does something else."""


# In Python 3.11 the access to a member of an enum costs more than the comparison.
STEP_DECISION: Final = int(LawDecision.STEP)
"""`LawDecision.STEP` as a plain int."""


class ReferenceKind(IntEnum):
    """Kinds of references in a row."""

    HOVER = 0
    """None: the drone stops and hovers."""
    ACCELERATION = 1
    """An Acceleration."""
    VELOCITY = 2
    """A Velocity."""
    FULL_STATE = 3
    """A FullState."""


TALLY_ROW = np.dtype(
    [
        ("steps", np.int64),  # steps of the law
        ("hovered", np.int64),  # steps in which it returned None
        ("refused", np.int64),  # steps with a reference that cannot be flown
    ],
    align=True,
)
"""What became of the references of one law."""

LAW_ROW = np.dtype(
    [
        ("place", np.int64),  # of the drone in its batch
        # What the pilot says in this tick.
        ("state", np.float64, (13,)),  # the drone's own state
        ("acceleration", np.float64, (3,)),  # m/s2: its acceleration
        ("age", np.float64),  # s: age of the state
        ("measured", np.float64),  # s: when the newest pose was measured
        ("permission", np.int64),  # LawPermission
        ("has_state", np.int64),  # 1: there is a new state in this tick
        # When the law steps.
        ("is_running", np.int64),  # 1: the law runs
        ("due_ns", np.int64),  # ns: when the next step is due
        ("period_ns", np.int64),  # ns between two steps
        ("early_ns", np.int64),  # ns by which a step may come before it is due
        # What the law receives.
        ("drone", np.int64),  # id of the drone
        ("first_edge", np.int64),  # its neighbours are the rows from here ...
        ("end_edge", np.int64),  # ... to here of the table of edges
        ("is_paired", np.int64),  # 1: the own velocity is not corrected
        ("last_measured", np.float64),  # s: `measured` in the last step
        ("sum", VELOCITY_SUM_ROW),  # of the own velocity
        # What it decides.
        ("decision", np.int64),  # LawDecision
        ("kind", np.int64),  # ReferenceKind
        ("reference", np.float64, (14,)),  # as in FullState; others leave parts out
        ("tally", TALLY_ROW),  # what became of its references
    ],
    align=True,
)
"""The law of one drone.

An Acceleration uses reference[6:9] and the yaw reference[12], a Velocity reference[3:6] and the
yaw.
"""


@kernel()
def _mark_row(row: Any, now_ns: int) -> int:
    """Decide whether a law steps in this tick; return its LawDecision."""
    if row.is_running == 0 or row.has_state == 0:
        return LawDecision.REST
    late_ns = now_ns - row.due_ns
    if late_ns < -row.early_ns or row.permission == LawPermission.WAITS:
        return LawDecision.REST
    row.due_ns += max(1, late_ns // row.period_ns + 1) * row.period_ns
    if row.permission == LawPermission.ENDS:
        return LawDecision.END
    return LawDecision.STEP


@kernel()
def _hear_row(row: Any, edges: Any, now_ns: int) -> None:
    """Write the states that a law receives in this step.

    The number of poses since the last step is whole: clocks jitter, cameras do not.
    """
    passed = np.rint((row.measured - row.last_measured) / row.sum.h)
    poses = int(passed) if math.isfinite(passed) else 0
    row.last_measured = row.measured
    for e in range(row.first_edge, row.end_edge):
        take_row(edges[e], now_ns, poses)
        edges[e].unheard += 1 - edges[e].is_heard
    if poses == 1 and row.sum.is_even == 1:
        keep_state(row.sum, row.state, row.age)
    elif row.is_paired == 0:
        correct_state(row.sum, row.state, row.age, poses, poses, row.state)


@kernel(rows_of(LAW_ROW), rows_of(HEARING_ROW), whole, **NO_COUNTING)
def decide_rows(rows: Any, edges: Any, now_ns: int) -> tuple[int, int]:
    """Decide which laws step in this tick, and write the states that these receive.

    Each of them gets the reference None until its step gives another one.

    rows: (n,) of LAW_ROW, with `state`, `permission` and `measured` of this tick
    edges: (e,) of HEARING_ROW: the neighbours of all rows
    now_ns: ns: the present time
    Returns the numbers of laws that step and of laws that end.
    """
    steps = 0
    ends = 0
    for r in range(rows.shape[0]):
        row = rows[r]
        decision = _mark_row(row, now_ns)
        row.decision = decision
        row.has_state = 0
        row.kind = ReferenceKind.HOVER
        if decision == LawDecision.STEP:
            _hear_row(row, edges, now_ns)
            steps += 1
        elif decision == LawDecision.END:
            ends += 1
    return steps, ends


@kernel(
    rows_of(LAW_ROW),
    rows_of(HEARING_ROW),
    wholes,
    wholes,
    table,
    table,
    memory,
    wholes,
    **NO_COUNTING,
)
def collect_received(
    rows: Any,
    edges: Any,
    neighbours: Ints,
    ids: Ints,
    states: Mat,
    accelerations: Mat,
    ages: Vec,
    counts: Ints,
) -> int:
    """Collect what the laws that step receive: each its own state, then those of its neighbours.

    rows: (n,) of LAW_ROW
    edges: (e,) of HEARING_ROW
    neighbours: (e,): id of the neighbour of each edge
    ids: (n + e,): receives the drone of each state
    states: (n + e, 13): receives the states
    accelerations: (n + e, 3) m/s2
    ages: (n + e,) s
    counts: (n,): receives the number of neighbours that each of these laws hears
    Returns the number of states.
    """
    k = 0
    steps = 0
    for r in range(rows.shape[0]):
        row = rows[r]
        if row.decision != LawDecision.STEP:
            continue
        ids[k] = row.drone
        copy_state(row.state, states[k])
        copy_axes(row.acceleration, accelerations[k])
        ages[k] = row.age
        k += 1
        first = k
        for e in range(row.first_edge, row.end_edge):
            edge = edges[e]
            if edge.is_heard == 0:
                continue
            ids[k] = neighbours[e]
            copy_state(edge.told, states[k])
            copy_axes(edge.told_acceleration, accelerations[k])
            ages[k] = edge.told_age
            k += 1
        counts[steps] = k - first
        steps += 1
    return k


@kernel(rows_of(LAW_ROW), **NO_COUNTING)
def count_rows(rows: Any) -> None:
    """Count the steps of this tick, and those of them that returned None."""
    for r in range(rows.shape[0]):
        row = rows[r]
        if row.decision == LawDecision.STEP:
            row.tally.steps += 1
            row.tally.hovered += row.kind == ReferenceKind.HOVER


def start_row(rows: Any, edges: Any, now_ns: int) -> None:
    """Let the law of the first row run from now on, with an empty memory.

    rows: (1,) of LAW_ROW
    edges: (k,) of HEARING_ROW: its neighbours
    now_ns: ns: the present time
    """
    for sums in (rows["sum"], edges["sum"]):
        sums["has_last"] = 0
        sums["is_even"] = 1
    rows["due_ns"] = now_ns
    rows["is_running"] = 1
