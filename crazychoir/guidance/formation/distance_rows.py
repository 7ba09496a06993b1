"""The law of a formation by distances for all drones of a process: see DistanceFormation."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from crazychoir.guidance.decision.hearing_rows import HEARING_ROW
from crazychoir.guidance.decision.law_rows import LAW_ROW, ReferenceKind
from crazychoir.guidance.decision.team import Ids, Team, TeamLaw
from crazychoir.numerics.kernels import kernel, rows_of

DISTANCE_ROW = np.dtype(
    [
        ("k", np.float64),  # 1/(m2 s2): gain of the distances
        ("kv", np.float64),  # 1/s: gain of the velocities
        ("kz", np.float64),  # 1/s2: gain that holds the height
        ("kvz", np.float64),  # 1/s: gain that brakes the height
        ("level", np.float64),  # m, world: height of a flat formation
        ("axes", np.int64),  # 2: a flat formation; 3: a formation in space
        ("needed", np.int64),  # number of neighbours that must be heard
    ],
    align=True,
)
"""The law of one follower."""
DISTANCE_EDGE_ROW = np.dtype(
    [
        ("distance", np.float64),  # m: the wanted distance
        ("counts", np.int64),  # 1: the law uses this neighbour
    ],
    align=True,
)
"""One neighbour of a follower."""


@dataclass(frozen=True, slots=True)
class DistanceLaw:
    """Gains and distances of one follower."""

    d: Mapping[int, float]
    """{j: m}: the wanted distances."""
    k: float
    """1/(m2 s2): gain of the distances."""
    kv: float
    """1/s: gain of the velocities."""
    height_gains: tuple[float, float]
    """kz, 1/s2, and kvz, 1/s."""
    level: float | None
    """m, world: height of a flat formation. None: a formation in space."""


@kernel()
def accelerate_towards_distances(row: Any, edges: Any, own: Any, wanted: Any) -> None:
    """Write the acceleration of a follower; it hovers if a neighbour is not heard.

        u_i = sum_j [ k (|p_j - p_i|^2 - d_ij^2) (p_j - p_i) - kv (v_i - v_j) ]

    A flat formation holds its height by u_z = - kz (z - level) - kvz v_z.

    row: a record of LAW_ROW
    edges: (e,) of HEARING_ROW
    own: a record of DISTANCE_ROW
    wanted: (e,) of DISTANCE_EDGE_ROW
    """
    u = row.reference[6:9]
    u[:] = 0.0
    heard = 0
    for e in range(row.first_edge, row.end_edge):
        other = edges[e]
        if wanted[e].counts == 0 or other.is_heard == 0:
            continue
        heard += 1
        square = 0.0
        for c in range(own.axes):
            square += (other.told[c] - row.state[c]) ** 2
        stretch = own.k * (square - wanted[e].distance ** 2)
        for c in range(own.axes):
            gap = other.told[c] - row.state[c]
            slip = other.told[3 + c] - row.state[3 + c]
            u[c] += stretch * gap + own.kv * slip
    if own.axes == 2:
        u[2] = own.kz * (own.level - row.state[2]) - own.kvz * row.state[5]
    if heard == own.needed:
        row.reference[12] = 0.0
        row.kind = ReferenceKind.ACCELERATION


@kernel(
    rows_of(LAW_ROW),
    rows_of(HEARING_ROW),
    rows_of(DISTANCE_ROW),
    rows_of(DISTANCE_EDGE_ROW),
)
def step_distance_rows(rows: Any, edges: Any, own: Any, wanted: Any) -> None:
    """Write the accelerations of all followers: see `accelerate_towards_distances`."""
    for r in range(rows.shape[0]):
        accelerate_towards_distances(rows[r], edges, own[r], wanted)


def build_distance_team(
    laws: Sequence[DistanceLaw], neighbors: Sequence[Ids]
) -> TeamLaw:
    """Return the step of all followers at once.

    laws: gains and distances of each follower
    neighbors: ids of the neighbours of each follower, in the order of the edges
    """
    own = np.zeros(len(laws), DISTANCE_ROW)
    for row, law in zip(own, laws, strict=True):
        row["k"] = law.k
        row["kv"] = law.kv
        row["kz"], row["kvz"] = law.height_gains
        row["level"] = 0.0 if law.level is None else law.level
        row["axes"] = 3 if law.level is None else 2
        row["needed"] = len(law.d)
    ends = [(r, j) for r, ids in enumerate(neighbors) for j in ids]
    wanted = np.zeros(len(ends), DISTANCE_EDGE_ROW)
    for edge, (r, j) in zip(wanted, ends, strict=True):
        if j in laws[r].d:
            edge["distance"] = laws[r].d[j]
            edge["counts"] = 1

    def step(team: Team) -> None:
        step_distance_rows(team.rows, team.edges, own, wanted)

    return step
