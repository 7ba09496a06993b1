"""Averaging with the same symmetric weights in each round."""

from collections.abc import Mapping
from typing import Any

from numpy.typing import ArrayLike

from crazychoir.errors import ConfigError
from crazychoir.optimization.rounds.iteration import copy_state
from crazychoir.optimization.rounds.messages import REAL_NUMBER_TYPES, check_parts
from crazychoir.optimization.rounds.mixing import (
    WEIGHT_SUM_TOLERANCE,
    Mixing,
    Rows,
    require_heard,
)


class StaticMixing(Mixing):
    """An algorithm that averages with symmetric weights of a static, undirected graph.

    In the first round, two neighbours compare w_ij with w_ji. Wrong weights end the algorithm at
    all agents, with an error that names both agents.

    i: id of the agent
    x: start, any shape, the same shape at all agents
    weights: row i of W, symmetric and doubly stochastic
    rounds: number of rounds until done; None for no end
    Raises ConfigError if there is more than one row, or if x is not finite.
    """

    def __init__(self, i: int, x: ArrayLike, weights: Rows, rounds: int | None) -> None:
        super().__init__(i, weights, rounds)
        if len(self.weights) > 1:
            raise ConfigError(
                f"agent {i}: weights",
                f"rows of {len(self.weights)} graphs",
                "one row, of a static graph",
                "GradientTracking allows a graph that changes.",
            )
        self.x = copy_state(f"agent {i}: x", x)

    def update(self, heard: Mapping[int, Any]) -> None:
        """Compare the weights in the first round, then mix."""
        if self.k == 0:
            require_heard(self.i, self.row, heard)
            check_parts(self.i, self.k, heard, REAL_NUMBER_TYPES, object)
            for j, (weight, _) in heard.items():
                self._check_weight(j, weight)
        super().update(heard)

    def _check_weight(self, j: int, theirs: float) -> None:
        if abs(self.row[j] - theirs) > WEIGHT_SUM_TOLERANCE:
            raise ConfigError(
                f"agent {self.i}: weights[{j}]",
                f"{self.row[j]:.9g}",
                f"{theirs:.9g}, as agent {j}'s: symmetric weights",
                "Take those of crazychoir.team.graph.metropolis.",
            )
