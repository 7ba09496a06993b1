"""Linearised ADMM (DLM) for a common variable: gradients in the place of local problems."""

from collections.abc import Iterable, Mapping

import numpy as np
from numpy.typing import ArrayLike

from crazychoir.errors import ConfigError
from crazychoir.optimization.problems.gradient import CheckedFunction, Gradient
from crazychoir.optimization.rounds.arrays import is_number
from crazychoir.optimization.rounds.iteration import Iteration, copy_state
from crazychoir.optimization.rounds.messages import check_array, require_heard
from crazychoir.optimization.rounds.step_size import Constant, GrowthWatch
from crazychoir.types import Vec

LARGE_ENOUGH_PROXIMITY = (
    "1 / (2 penalty degree + proximity) with a proximity above L_i / 2, f_i L_i-smooth"
)
"""Steps with which the linearised ADMM converges, for error texts."""


class LinearisedADMM(Iteration):
    """Decentralized linearised ADMM (DLM) for  min sum_i f_i(x),  f_i convex and L_i-smooth.

        d_i(k) = sum_{j in N_i} (x_i(k) - x_j(k))
        x_i(k+1) = x_i(k) - [grad f_i(x_i(k)) + c d_i(k) + l_i(k)] / (2 c |N_i| + rho_i)
        l_i(k) = l_i(k-1) + c d_i(k),   l_i(0) = 0

    l_i is the sum of the multipliers of x_i = x_j. One message of x_i travels in each round. The
    graph is static and undirected.

    i: id of the agent
    x: x_i(0), any shape, the same shape at all agents
    neighbors: N_i
    gradient: grad f_i
    penalty: c > 0, the same at all agents. A large one first brings the x_i together
    proximity: rho_i, its own. The iterates converge to an optimum for rho_i > L_i / 2 at all agents
        and each c
    rounds: number of rounds until done; None for no end
    Raises ConfigError if the agents that are heard are not exactly N_i.
    Raises ConfigError that names the step if it is so large that x grows without end.
    Source: Ling, Shi, Wu & Ribeiro 2015, IEEE Trans. Signal Process. 63(15), 4051-4064, "DLM:
    decentralized linearized alternating direction method of multipliers". The bound is that of
    EXTRA: with A the adjacency matrix and D the diagonal matrix of the |N_i|, the matrix
    (2 c D + rho) - c (D - A) = rho + c (D + A) takes the place of V / a.
    """

    connected = True
    undirected = True
    same = ("penalty",)

    def __init__(
        self,
        i: int,
        x: ArrayLike,
        neighbors: Iterable[int],
        gradient: Gradient,
        penalty: float,
        proximity: float,
        rounds: int | None = None,
    ) -> None:
        super().__init__(i, rounds)
        for name, value in (("penalty", penalty), ("proximity", proximity)):
            if not is_number(value) or not 0.0 < value < np.inf:
                raise ConfigError(
                    f"agent {i}: {name}", f"{value}", "a finite number above 0"
                )
        self.x = copy_state(f"agent {i}: x", x)
        self.neighbors = tuple(sorted(neighbors))
        self.gradient = CheckedFunction(i, "gradient", gradient)
        self.penalty = penalty
        step = 1.0 / (2.0 * penalty * len(self.neighbors) + proximity)
        self.step_size = Constant(step)
        self.multiplier = np.zeros_like(self.x)
        self._watch = GrowthWatch(f"agent {i}", self.step_size, LARGE_ENOUGH_PROXIMITY)

    def message(self) -> Vec:
        """Return x_i."""
        return self.x

    def update(self, heard: Mapping[int, Vec]) -> None:
        """Update the multiplier, then move x_i."""
        require_heard(self.i, self.neighbors, heard)
        apart = len(heard) * self.x
        for j, x in heard.items():
            apart -= check_array(self.i, j, x, self.x)
        pull = self.penalty * apart
        if self.k > 0:
            self.multiplier += pull
        force = self.gradient(self.k, self.x) + pull + self.multiplier
        self.x = self.x - self.step_size.a * force
        self._watch(self.k, self.x)
