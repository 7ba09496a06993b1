"""The laws of a bearing formation for all drones of a process: see BearingFormation."""

from collections.abc import Sequence
from typing import Any, Protocol

import numpy as np

from crazychoir.guidance.decision.hearing_rows import HEARING_ROW
from crazychoir.guidance.decision.law_rows import LAW_ROW, ReferenceKind
from crazychoir.guidance.decision.team import Ids, Team, TeamLaw
from crazychoir.guidance.formation.bearing import BearingLaw
from crazychoir.numerics.kernels import kernel, rows_of
from crazychoir.types import Mat

BEARING_ROW = np.dtype(
    [
        ("kp", np.float64),  # 1/s2: gain of the positions
        ("kv", np.float64),  # 1/s: gain of the velocities
        ("uses_acceleration", np.int64),  # 1: the accelerations of neighbours count
        ("needed", np.int64),  # number of neighbours that must be heard
    ],
    align=True,
)
"""The law of one follower."""
BEARING_EDGE_ROW = np.dtype(
    [
        ("weight", np.float64, (3, 3)),  # W_ij, see build_edge_weights
        ("counts", np.int64),  # 1: the law uses this neighbour
    ],
    align=True,
)
"""One neighbour of a follower."""


@kernel()
def accelerate_towards_bearings(row: Any, edges: Any, own: Any, weights: Any) -> None:
    """Write the acceleration of a follower; it hovers if a neighbour is not heard.

        u_i = sum_j W_ij [ kp (p_j - p_i) + kv (v_j - v_i) + a_j ]

    Without accelerations a_j = 0.

    row: a record of LAW_ROW
    edges: (e,) of HEARING_ROW
    own: a record of BEARING_ROW
    weights: (e,) of BEARING_EDGE_ROW
    """
    u = row.reference[6:9]
    u[:] = 0.0
    heard = 0
    for e in range(row.first_edge, row.end_edge):
        other = edges[e]
        if weights[e].counts == 0 or other.is_heard == 0:
            continue
        heard += 1
        for d in range(3):
            pull = own.kp * (other.told[d] - row.state[d])
            pull += own.kv * (other.told[3 + d] - row.state[3 + d])
            if own.uses_acceleration == 1:
                pull += other.told_acceleration[d]
            for c in range(3):
                u[c] += weights[e].weight[c, d] * pull
    if heard == own.needed:
        row.reference[12] = 0.0
        row.kind = ReferenceKind.ACCELERATION


@kernel(
    rows_of(LAW_ROW),
    rows_of(HEARING_ROW),
    rows_of(BEARING_ROW),
    rows_of(BEARING_EDGE_ROW),
)
def step_bearing_rows(rows: Any, edges: Any, own: Any, weights: Any) -> None:
    """Write the accelerations of all followers: see `accelerate_towards_bearings`."""
    for r in range(rows.shape[0]):
        accelerate_towards_bearings(rows[r], edges, own[r], weights)


class BearingFollower(Protocol):
    """What the law of a follower is made of."""

    law: BearingLaw
    """Which law, with its gains."""
    weights: dict[int, Mat]
    """{j: W_ij (3, 3)}, see build_edge_weights."""


def build_bearing_team(
    followers: Sequence[BearingFollower], neighbors: Sequence[Ids]
) -> TeamLaw:
    """Return the step of all followers at once.

    followers: one a row of the team
    neighbors: ids of the neighbours of each follower, in the order of the edges
    """
    own = np.zeros(len(followers), BEARING_ROW)
    for row, follower in zip(own, followers, strict=True):
        row["kp"] = follower.law.kp
        row["kv"] = follower.law.kv
        row["uses_acceleration"] = follower.law.kind == "normalised"
        row["needed"] = len(follower.weights)
    ends = [(r, j) for r, ids in enumerate(neighbors) for j in ids]
    of_edges = np.zeros(len(ends), BEARING_EDGE_ROW)
    for edge, (r, j) in zip(of_edges, ends, strict=True):
        weights = followers[r].weights
        if j in weights:
            edge["weight"] = weights[j]
            edge["counts"] = 1

    def step(team: Team) -> None:
        step_bearing_rows(team.rows, team.edges, own, of_edges)

    return step
