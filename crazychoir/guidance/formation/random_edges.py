"""Edges that come and go at random, the same at both ends without a message."""

from typing import Any

import numba
import numpy as np

from crazychoir.bus.impairment.compiled_draws import draw_word, split_threshold
from crazychoir.bus.impairment.random_draws import draw_key
from crazychoir.numerics.kernels import kernel, rows_of

RANDOM_EDGE_ROW = np.dtype(
    [
        ("key", np.uint64),  # key of the draws of the own end
        ("other_key", np.uint64),  # key of the draws of the other end
        ("share", np.uint64),  # an end with a draw below it has chosen the edge
        ("is_always", np.int64),  # 1: both ends choose the edge in each tick
    ],
    align=True,
)
"""One edge of a drone."""
ONLY_ATTEMPT = np.uint64(0)
"""Attempt of the draws: there is one in a tick."""


@kernel()
def edge_counts(edge: Any, tick: int) -> bool:
    """Return whether both ends of an edge have chosen it in a tick.

    edge: a record of RANDOM_EDGE_ROW
    tick: number of the tick of the team's time
    """
    if edge.is_always == 1:
        return True
    number = np.uint64(tick)
    return bool(
        draw_word(edge.key, number, ONLY_ATTEMPT) < edge.share
        and draw_word(edge.other_key, number, ONLY_ATTEMPT) < edge.share
    )


@kernel(rows_of(RANDOM_EDGE_ROW), numba.int64, numba.int64)
def _row_counts(edges: Any, row: int, tick: int) -> bool:
    """Return whether the edge in a row counts in a tick: see `edge_counts`."""
    return bool(edge_counts(edges[row], tick))


class RandomEdges:
    """The edges of a drone to its neighbours: in each tick, both ends choose the edge or not.

    Each draw is a function of (seed, i, j, k), with the tick k of the team's time. Both ends of an
    edge compute the same draw without a message, even if they have missed messages.

    i: id of the drone.
    neighbors: ids that drone i hears.
    share: probability with which an end chooses an edge in a tick; 1: the edges always count.
    seed: seed of the draws.
    """

    def __init__(
        self, i: int, neighbors: tuple[int, ...], share: float, seed: int
    ) -> None:
        self.neighbors = neighbors
        self.share = share
        self.rows = np.zeros(len(neighbors), RANDOM_EDGE_ROW)
        """(k,) of RANDOM_EDGE_ROW: the edges."""
        for row, j in zip(self.rows, neighbors, strict=True):
            row["key"] = draw_key(seed, i, j)
            row["other_key"] = draw_key(seed, j, i)
        self.rows["share"], self.rows["is_always"] = split_threshold(share)

    def counts(self, j: int, k: int) -> bool:
        """Return whether both ends of the edge to j have chosen it in tick k."""
        return bool(_row_counts(self.rows, self.neighbors.index(j), k))
