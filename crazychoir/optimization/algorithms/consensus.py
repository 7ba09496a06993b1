"""Consensus by averaging with the neighbours."""

from collections.abc import Mapping

from numpy.typing import ArrayLike

from crazychoir.optimization.rounds.iteration import copy_state
from crazychoir.optimization.rounds.mixing import Mixing, Row, Rows, mix
from crazychoir.types import Vec


class Consensus(Mixing):
    """Linear consensus, on a static or time-varying, directed or undirected graph.

        x_i <- sum_j w_ij(k) x_j

    Doubly stochastic rows lead to the mean of all x. Row-stochastic rows, on a static graph, lead
    to sum_i pi_i x_i with pi' W = pi', pi' 1 = 1. There is no step size.

    i: id of the agent
    x: start, any shape, the same shape at all agents
    weights: row i, which sums to one, or one row for each graph of a sequence
    rounds: number of rounds until done; None for no end
    Raises ConfigError if a row does not sum to one or does not match the agents that are heard, or
    if x is not finite.
    Source: Olfati-Saber, Fax & Murray 2007, Proc. IEEE 95(1), 215-233; Xiao & Boyd 2004, Syst.
    Control Lett. 53, 65-78.
    """

    doubly_stochastic = False

    def __init__(
        self, i: int, x: ArrayLike, weights: Rows, rounds: int | None = None
    ) -> None:
        super().__init__(i, weights, rounds)
        self.x = copy_state(f"agent {i}: x", x)

    def payload(self) -> Vec:
        """Return x_i."""
        return self.x

    def mix_in(self, row: Row, heard: Mapping[int, Vec]) -> None:
        """Average with the neighbours."""
        self.x = mix(self.i, row, self.x, heard)
