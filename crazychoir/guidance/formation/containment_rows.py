"""The law of containment for all drones of a process: see Containment."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numba
import numpy as np

from crazychoir.guidance.decision.hearing_rows import HEARING_ROW
from crazychoir.guidance.decision.law_rows import LAW_ROW, ReferenceKind
from crazychoir.guidance.decision.team import Ids, Team, TeamLaw
from crazychoir.guidance.formation.random_edges import (
    RANDOM_EDGE_ROW,
    RandomEdges,
    edge_counts,
)
from crazychoir.numerics.kernels import kernel, rows_of
from crazychoir.runtime.clock import NS_PER_SECOND

CONTAINMENT_ROW = np.dtype(
    [
        ("weight", np.float64),  # 1/(d_i s^2)
        ("kp", np.float64),  # 1/s2: gain of the positions
        ("kv", np.float64),  # 1/s: gain of the velocities
        ("period_ns", np.int64),  # ns between two ticks of the edges
    ],
    align=True,
)
"""The law of one follower."""
CONTAINMENT_EDGE_ROW = np.dtype(
    [
        ("random", RANDOM_EDGE_ROW),  # when the edge counts
        ("counts", np.int64),  # 1: the law uses this neighbour
    ],
    align=True,
)
"""One neighbour of a follower."""


@dataclass(frozen=True, slots=True)
class ContainmentLaw:
    """Gains and edges of one follower."""

    edges: RandomEdges
    """Edges to the neighbours that the drone hears."""
    kp: float
    """1/s2: gain of the positions."""
    kv: float
    """1/s: gain of the velocities."""
    rate: float
    """Hz: rate at which the edges are drawn."""


@kernel()
def accelerate_into_hull(
    row: Any, edges: Any, own: Any, chosen: Any, tick: int
) -> None:
    """Write the acceleration of a follower, over the edges that count in this tick.

        u_i = - 1/(d_i s^2) sum_j c_ij(k) [ kp (p_i - p_j) + kv (v_i - v_j) ]

    row: a record of LAW_ROW
    edges: (e,) of HEARING_ROW
    own: a record of CONTAINMENT_ROW
    chosen: (e,) of CONTAINMENT_EDGE_ROW
    tick: number k of the tick of the team's time
    """
    u = row.reference[6:9]
    u[:] = 0.0
    for e in range(row.first_edge, row.end_edge):
        other = edges[e]
        if chosen[e].counts == 0 or other.is_heard == 0:
            continue
        if not edge_counts(chosen[e].random, tick):
            continue
        for c in range(3):
            gap = row.state[c] - other.told[c]
            slip = row.state[3 + c] - other.told[3 + c]
            u[c] -= own.weight * (own.kp * gap + own.kv * slip)
    row.reference[12] = 0.0
    row.kind = ReferenceKind.ACCELERATION


@kernel(
    rows_of(LAW_ROW),
    rows_of(HEARING_ROW),
    rows_of(CONTAINMENT_ROW),
    rows_of(CONTAINMENT_EDGE_ROW),
    numba.int64,
)
def step_containment_rows(
    rows: Any, edges: Any, own: Any, chosen: Any, team_ns: int
) -> None:
    """Write the accelerations of all followers: see `accelerate_into_hull`.

    team_ns: ns: the team's time
    """
    for r in range(rows.shape[0]):
        tick = team_ns // own[r].period_ns
        accelerate_into_hull(rows[r], edges, own[r], chosen, tick)


def build_containment_team(
    laws: Sequence[ContainmentLaw], neighbors: Sequence[Ids]
) -> TeamLaw:
    """Return the step of all followers at once.

    laws: gains and edges of each follower
    neighbors: ids of the neighbours of each follower, in the order of the edges
    """
    own = np.zeros(len(laws), CONTAINMENT_ROW)
    for row, law in zip(own, laws, strict=True):
        row["weight"] = 1.0 / (len(law.edges.neighbors) * law.edges.share**2)
        row["kp"] = law.kp
        row["kv"] = law.kv
        row["period_ns"] = round(NS_PER_SECOND / law.rate)
    ends = [
        (law.edges, j) for law, ids in zip(laws, neighbors, strict=True) for j in ids
    ]
    chosen = np.zeros(len(ends), CONTAINMENT_EDGE_ROW)
    for edge, (known, j) in zip(chosen, ends, strict=True):
        if j in known.neighbors:
            edge["random"] = known.rows[known.neighbors.index(j)]
            edge["counts"] = 1

    def step(team: Team) -> None:
        team_ns = team.epoch_ns + team.now_ns
        step_containment_rows(team.rows, team.edges, own, chosen, team_ns)

    return step
