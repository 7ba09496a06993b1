"""Consensus by averaging with the neighbours."""

from collections.abc import Mapping

from numpy.typing import ArrayLike

from crazychoir.optimization.rounds.iteration import vector
from crazychoir.optimization.rounds.mixing import Mixing, Row, Rows, mix
from crazychoir.types import Vec


class Consensus(Mixing):
    """Linear consensus, on a static or time-varying, directed or undirected graph.

        x_i <- sum_j w_ij(k) x_j

    x: any shape, the same at all agents;  weights: row i, which sums to one, or one for each graph of a sequence.
    Doubly stochastic rows lead to the mean of all x; row-stochastic ones, on a static graph, to sum_i pi_i x_i with
    pi' W = pi', pi' 1 = 1. No step size.
    Raises ConfigError: a row that does not sum to one, or does not fit who is heard; an x that is not finite.
    Source: Olfati-Saber, Fax & Murray 2007, Proc. IEEE 95(1), 215-233; Xiao & Boyd 2004, Syst. Control Lett. 53, 65-78.
    """

    doubly_stochastic = False

    def __init__(
        self, i: int, x: ArrayLike, weights: Rows, rounds: int | None = None
    ) -> None:
        super().__init__(i, weights, rounds)
        self.x = vector(f"agent {i}: x", x)

    def payload(self) -> Vec:
        """x_i."""
        return self.x

    def mix_in(self, row: Row, heard: Mapping[int, Vec]) -> None:
        """Average."""
        self.x = mix(self.i, row, self.x, heard)
