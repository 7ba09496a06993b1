"""The greatest value of a team."""

from collections.abc import Mapping

import numpy as np
from numpy.typing import ArrayLike

from crazychoir.optimization.rounds.iteration import Iteration, vector
from crazychoir.optimization.rounds.messages import like
from crazychoir.types import Vec


class MaxConsensus(Iteration):
    """Greatest value of all agents, entry by entry, in as many rounds as the diameter D.

        x_i <- max_j x_j   over i itself and those it hears

    diameter: of the connected graph, D, or of a sequence of graphs the rounds of a flood.  No weights, no step size;
    the least value is that of -x. All agents are done after D rounds, with the same x to the last bit.
    Where D is not known but a bound on it is too large to wait for, `Until(MaxConsensus(...), Settled(0.0, D), D)` ends
    at once when nothing has changed.
    Source: Nejad, Attia & Raisch 2009, "Max-consensus in a max-plus algebraic setting", ICAT.
    """

    connected = True

    def __init__(self, i: int, x: ArrayLike, diameter: int) -> None:
        super().__init__(i, diameter)
        self.diameter = diameter
        self.x = vector(f"agent {i}: x", x)

    def message(self) -> Vec:
        """x_i."""
        return self.x

    def update(self, heard: Mapping[int, Vec]) -> None:
        """The greatest of those heard."""
        x = self.x
        for j, other in heard.items():
            x = np.maximum(x, like(self.i, j, other, x))
        self.x = x
