"""The mean on a directed graph, where an agent knows only its own neighbours."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from crazychoir.errors import ConfigError
from crazychoir.optimization.rounds.iteration import Iteration, copy_state
from crazychoir.optimization.rounds.messages import (
    REAL_NUMBER_TYPES,
    check_array,
    check_parts,
)
from crazychoir.optimization.rounds.mixing import Rows, check_rows
from crazychoir.types import PerNeighbor


class PushSum(Iteration):
    """Ratio consensus: the mean of all x, on a static or time-varying directed graph.

        s_i <- sum_j a_ij s_j,   y_i <- sum_j a_ij y_j,   x_i = s_i / y_i
        s_i(0) = x_i,   y_i(0) = 1

    There is no step size. An agent needs to know only the number of agents that hear it.

    i: id of the agent
    x: start; later the estimate of the mean
    shares: column i, {j: a_ji} of sum one: how much agent i gives to each agent that hears it, and
        how much it keeps; or one column for each graph of a sequence.
        `columns(graph, column_stochastic)` gives equal shares
    rounds: number of rounds until done; None for no end
    s: s_i, the sum
    y: y_i, the weight
    Source: Kempe, Dobra & Gehrke 2003, FOCS, 482-491; Nedic & Olshevsky 2015, IEEE Trans. Autom.
    Control 60(3).
    """

    connected = True

    def __init__(
        self, i: int, x: ArrayLike, shares: Rows, rounds: int | None = None
    ) -> None:
        super().__init__(i, rounds)
        self.x = self.s = copy_state(f"agent {i}: x", x)
        self.y = 1.0
        self.shares = check_rows(i, shares, "shares")
        for share in self.shares:
            if min(share.values()) < 0.0 or share[i] == 0.0:
                raise ConfigError(
                    f"agent {i}: shares",
                    dict(share),
                    f"0 or more, that of agent {i} itself above 0",
                )

    def message(self) -> PerNeighbor:
        """Return [a_ji s_i, a_ji y_i] for each j."""
        share = self.shares[self.k % len(self.shares)]
        return PerNeighbor(
            {j: [a * self.s, a * self.y] for j, a in share.items() if j != self.i}
        )

    def update(self, heard: Mapping[int, Any]) -> None:
        """Add up the shares, and compute the estimate."""
        a = self.shares[self.k % len(self.shares)][self.i]
        s = a * self.s
        y = a * self.y
        for j, (theirs, weight) in check_parts(
            self.i, self.k, heard, object, REAL_NUMBER_TYPES
        ).items():
            s = s + check_array(self.i, j, theirs, s)
            y += weight
        self.s = s
        self.y = y
        self.x = s / np.float64(y)
