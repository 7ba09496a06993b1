"""PG-EXTRA, the proximal form of EXTRA, for a common variable and costs that are smooth in part."""

from collections.abc import Mapping

import numpy as np
from numpy.typing import ArrayLike

from crazychoir.optimization.problems.composite import CompositeCost
from crazychoir.optimization.rounds.mixing import Row, Rows, mix
from crazychoir.optimization.rounds.static_mixing import StaticMixing
from crazychoir.optimization.rounds.step_size import Constant, GrowthWatch
from crazychoir.types import Vec

SMALL_ENOUGH_STEP = (
    "below (1 + the smallest eigenvalue of W) / L, the smooth parts L-smooth"
)
"""Steps with which EXTRA and PG-EXTRA converge, for error texts."""


class PGEXTRA(StaticMixing):
    """PG-EXTRA for  min sum_i s_i(x) + r_i(x),  s_i and r_i convex, s_i L-smooth.

        z_i(1) = sum_j w_ij x_j(0) - a grad s_i(x_i(0))
        z_i(k+1) = z_i(k) + sum_j w_ij x_j(k) - sum_j v_ij x_j(k-1)
                   - a [grad s_i(x_i(k)) - grad s_i(x_i(k-1))],   V = (I + W) / 2
        x_i(k) = argmin_x r_i(x) + |x - z_i(k)|^2 / (2a)

    One message of x_i travels in each round.

    i: id of the agent
    x: x_i(0), any shape, the same shape at all agents
    weights: row i of W, symmetric and doubly stochastic, of a static graph
    cost: the gradient of s_i and the proximal operator of r_i
    step: a, the same at all agents. The iterates converge to an optimum for
        a < 2 v / L = (1 + w) / L, with v and w the smallest eigenvalues of V and W
    rounds: number of rounds until done; None for no end
    Raises ConfigError that names the step if it is so large that x grows without end.
    Source: Shi, Ling, Wu & Yin 2015, IEEE Trans. Signal Process. 63(22), 6013-6023, "A proximal
    gradient algorithm for decentralized composite optimization".
    """

    same = ("step_size",)

    def __init__(
        self,
        i: int,
        x: ArrayLike,
        weights: Rows,
        cost: CompositeCost,
        step: float,
        rounds: int | None = None,
    ) -> None:
        super().__init__(i, x, weights, rounds)
        self.step_size = Constant(step)
        self.gradient = cost.checked_gradient(i)
        self.proximal = cost.checked_proximal(i, step)
        self._watch = GrowthWatch(f"agent {i}", self.step_size, SMALL_ENOUGH_STEP)
        self._carried = np.zeros_like(self.x)

    def payload(self) -> Vec:
        """Return x_i."""
        return self.x

    def mix_in(self, row: Row, heard: Mapping[int, Vec]) -> None:
        """Compute z_i, then x_i.

        _carried is the part of z_i(k+1) that round k-1 knows:
        z_i(k) - sum_j v_ij x_j(k-1) + a grad s_i(x_i(k-1)), and 0 in the first round.
        """
        mixed = mix(self.i, row, self.x, heard)
        descent = self.step_size.a * self.gradient(self.k, self.x)
        z = self._carried + mixed - descent
        self._watch(self.k, z)
        self._carried = z - 0.5 * (self.x + mixed) + descent
        self.x = np.array(self.proximal(self.k, z))
