"""The greatest value of a team."""

from collections.abc import Mapping

import numpy as np
from numpy.typing import ArrayLike

from crazychoir.optimization.rounds.iteration import Iteration, copy_state
from crazychoir.optimization.rounds.messages import check_array
from crazychoir.types import Vec


class MaxConsensus(Iteration):
    """The greatest value of all agents, entry by entry, in D rounds.

        x_i <- max_j x_j   over i itself and the agents it hears

    All agents are done after D rounds, with the same x to the last bit. There are no weights and no
    step size. For the least value, use -x.
    If D is unknown and a bound on it is too large to wait for,
    `Until(MaxConsensus(...), Settled(0.0, D), D)` ends as soon as nothing has changed.

    i: id of the agent
    x: start
    diameter: D, the diameter of the connected graph, or the rounds of a flood of a graph sequence
    Source: Nejad, Attia & Raisch 2009, "Max-consensus in a max-plus algebraic setting", ICAT.
    """

    connected = True

    def __init__(self, i: int, x: ArrayLike, diameter: int) -> None:
        super().__init__(i, diameter)
        self.diameter = diameter
        self.x = copy_state(f"agent {i}: x", x)

    def message(self) -> Vec:
        """Return x_i."""
        return self.x

    def update(self, heard: Mapping[int, Vec]) -> None:
        """Take the greatest of all values heard."""
        x = self.x
        for j, other in heard.items():
            x = np.maximum(x, check_array(self.i, j, other, x))
        self.x = x
