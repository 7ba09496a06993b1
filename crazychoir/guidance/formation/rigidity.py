"""Checks before the flight: does the graph hold each drone?

They are for distance formations and containment.
"""

from collections.abc import Collection, Iterable, Mapping, Sequence

import numpy as np
from scipy.optimize import nnls

from crazychoir.errors import Refused
from crazychoir.guidance.formation.shapes import Shape
from crazychoir.types import Mat, Vec

Edges = Iterable[tuple[int, int]]
"""Pairs of ids."""
ZERO_SINGULAR_VALUE = 1e-6
"""m: a smaller singular value of the rigidity matrix counts as zero, for edges of some metres."""
WEIGHT_SUM_PENALTY = 1e3
"""Weight of the condition that the weights of a hull sum up to one, relative to the distance."""


def rigidity_matrix(
    shape: Shape, edges: Edges, leaders: Collection[int]
) -> tuple[Mat, list[int]]:
    """Return half the derivative of all squared distances by the followers' places.

    R has a row for each edge (i, j):

        (p_i - p_j)^T at i,   (p_j - p_i)^T at j

    shape: {id: (D,) m}.
    edges: pairs of ids; edges between leaders are left out.
    leaders: ids of the leaders.
    Returns R (edges, D F) and the followers in ascending order.
    """
    followers = [i for i in sorted(shape) if i not in leaders]
    at = {i: np.asarray(shape[i], dtype=float) for i in shape}
    d = len(next(iter(at.values())))
    column = {i: slice(d * n, d * n + d) for n, i in enumerate(followers)}
    rows = []
    for i, j in edges:
        row = np.zeros(d * len(followers))
        for a, b in ((i, j), (j, i)):
            if a in column:
                row[column[a]] = at[a] - at[b]
        if i in column or j in column:
            rows.append(row)
    return np.array(rows).reshape(len(rows), d * len(followers)), followers


def require_rigid(shape: Shape, edges: Edges, leaders: Collection[int]) -> Mat:
    """Return the rigidity matrix of the followers.

    Raises Refused, with the loose drones, if its rank is less than D F. Then some drones can begin
    to move without changing a distance, and the law does not hold them.
    """
    r, followers = rigidity_matrix(shape, edges, leaders)
    if not followers:
        raise Refused(
            "distance formation",
            "every drone is a leader. Name only the drones that shall not follow the formation.",
        )
    _, sizes, modes = np.linalg.svd(r, full_matrices=True)
    rank = int(np.sum(sizes > ZERO_SINGULAR_VALUE))
    if rank < r.shape[1]:
        free = np.abs(modes[rank:]).max(axis=0).reshape(len(followers), -1).max(axis=1)
        loose = [i for i, part in zip(followers, free, strict=True) if part > 1e-3]
        raise Refused(
            "distance formation",
            f"the graph is not infinitesimally rigid with leaders {sorted(leaders)}: drones {loose} can move without "
            f"changing a distance (rank {rank} of {r.shape[1]}). Add edges, or take other or more leaders.",
        )
    return r


def require_led(
    neighbors: Mapping[int, Collection[int]], leaders: Collection[int]
) -> None:
    """Raise Refused, with the drones, if any drone hears no leader, not even through others."""
    led = list(leaders)
    for j in led:  # the list grows during the loop
        led += [i for i in sorted(neighbors) if i not in led and j in neighbors[i]]
    lost = [i for i in sorted(neighbors) if i not in led]
    if lost or not leaders:
        raise Refused(
            "containment",
            f"drones {lost} hear no leader, not even through others. Add edges or leaders.",
        )


def grounded_laplacian(
    neighbors: Mapping[int, Collection[int]], leaders: Collection[int]
) -> tuple[Mat, Mat]:
    """Return the rows of D^-1 L that belong to the followers.

    D is the number of neighbours that each drone hears. L is the Laplacian.

    neighbors: {id: ids that it hears}.
    leaders: ids of the leaders.
    Returns (F, F), the followers' columns, and (F, leaders), the leaders' columns, both ascending.
    """
    followers = [i for i in sorted(neighbors) if i not in leaders]
    ids = sorted(leaders)
    l_ff = np.array(
        [
            [float(i == j) - (j in neighbors[i]) / len(neighbors[i]) for j in followers]
            for i in followers
        ]
    )
    l_fl = np.array(
        [
            [-float(j in neighbors[i]) / len(neighbors[i]) for j in ids]
            for i in followers
        ]
    )
    return l_ff, l_fl


def distance_to_hull(corners: Sequence[Vec] | Mat, p: Vec) -> float:
    """Return the distance in m from p (D,) to the convex hull of the corners (n, D).

    min |sum_k w_k c_k - p|,   w_k >= 0,   sum_k w_k = 1
    """
    c = np.asarray(corners, dtype=float)
    weights, _ = nnls(
        np.vstack([(c - p).T, np.full(len(c), WEIGHT_SUM_PENALTY)]),
        np.array([*np.zeros(c.shape[1]), WEIGHT_SUM_PENALTY]),
    )
    return float(np.linalg.norm((c - p).T @ (weights / weights.sum())))
