"""The law of aggregative optimisation for all drones of a process: see AggregativeGuidance."""

from collections.abc import Sequence
from typing import Any, Protocol

import numpy as np

from crazychoir.guidance.decision.hearing_rows import HEARING_ROW
from crazychoir.guidance.decision.law_rows import LAW_ROW, LawDecision, ReferenceKind
from crazychoir.guidance.decision.team import Ids, Rows, Team, TeamLaw
from crazychoir.guidance.timed import TIMED_FLIGHT_LIMITS
from crazychoir.numerics.kernels import kernel, rows_of, whole
from crazychoir.planning.smoothing import SMOOTHER_ROW, smooth_row
from crazychoir.runtime.clock import NS_PER_SECOND
from crazychoir.types import Vec

AGGREGATIVE_ROW = np.dtype(
    [
        ("goal", np.float64, 3),  # m: x_i, the newest result of the algorithm
        ("smoother", SMOOTHER_ROW),  # of the way there
        ("stepped_ns", np.int64),  # ns: time of the last step
        ("intruder_edge", np.int64),  # number of the neighbour to watch; -1: none
        ("intruder", np.float64, 3),  # m: newest known place of this neighbour
    ],
    align=True,
)
"""The law of one drone."""


class AggregativeLaw(Protocol):
    """A law with a row of AGGREGATIVE_ROW."""

    own: Rows
    """(1,) of AGGREGATIVE_ROW."""
    watched: int | None
    """Id of the neighbour to watch; None: none."""

    def note(self, now: float, p: Vec) -> None:
        """Note where the drone is, (3,) m, and where what it watches is."""
        ...


@kernel()
def _watch_intruder(own: Any, edges: Any, first_edge: int) -> None:
    """Keep the place of the neighbour that the drone watches, if it is heard.

    own: a record of AGGREGATIVE_ROW
    edges: (e,) of HEARING_ROW
    first_edge: row of the first neighbour of the drone
    """
    if own.intruder_edge < 0:
        return
    edge = edges[first_edge + own.intruder_edge]
    if edge.is_heard != 0:
        for c in range(3):
            own.intruder[c] = edge.told[c]


@kernel(rows_of(LAW_ROW), rows_of(HEARING_ROW), rows_of(AGGREGATIVE_ROW), whole)
def step_aggregative_rows(rows: Any, edges: Any, own: Any, now_ns: int) -> None:
    """Write the references of all drones that step, on their ways to x_i.

    now_ns: ns: the present time
    """
    for r in range(rows.shape[0]):
        row = rows[r]
        if row.decision != LawDecision.STEP:
            continue
        _watch_intruder(own[r], edges, row.first_edge)
        seconds = (now_ns - own[r].stepped_ns) / NS_PER_SECOND
        own[r].stepped_ns = now_ns
        smoother = own[r].smoother
        smooth_row(smoother, own[r].goal, seconds)
        for k in range(12):
            row.reference[k] = smoother.state[k]
        row.reference[12] = 0.0
        row.reference[13] = 0.0
        row.kind = ReferenceKind.FULL_STATE


def build_aggregative_team(
    laws: Sequence[AggregativeLaw], neighbors: Sequence[Ids]
) -> TeamLaw:
    """Return the step of all drones at once.

    laws: their rows move into the table of the team
    neighbors: ids of the neighbours of each drone, in the order of the edges
    """
    own = np.zeros(len(laws), AGGREGATIVE_ROW)
    for r, (law, ids) in enumerate(zip(laws, neighbors, strict=True)):
        own[r] = law.own[0]
        own["intruder_edge"][r] = ids.index(law.watched) if law.watched in ids else -1
        law.own = own[r : r + 1]
    interval_ns = round(TIMED_FLIGHT_LIMITS.way_interval * NS_PER_SECOND)
    due_ns = 0

    def step(team: Team) -> None:
        nonlocal due_ns
        step_aggregative_rows(team.rows, team.edges, own, team.now_ns)
        if team.now_ns < due_ns:
            return
        due_ns = team.now_ns + interval_ns
        for r in team.steps.tolist():
            place = team.rows["state"][r, 0:3]
            laws[r].note(team.now_ns / NS_PER_SECOND, place)

    return step
