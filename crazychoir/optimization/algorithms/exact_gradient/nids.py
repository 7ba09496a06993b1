"""NIDS: network-independent step sizes for a common variable."""

from collections.abc import Mapping

import numpy as np
from numpy.typing import ArrayLike

from crazychoir.errors import ConfigError
from crazychoir.optimization.problems.composite import CompositeCost
from crazychoir.optimization.rounds.arrays import is_number
from crazychoir.optimization.rounds.mixing import Row, Rows, mix
from crazychoir.optimization.rounds.static_mixing import StaticMixing
from crazychoir.optimization.rounds.step_size import Constant, GrowthWatch
from crazychoir.types import Vec

SMALL_ENOUGH_STEP = "below 2 / L_i, its own smooth part L_i-smooth"
"""Steps with which NIDS converges, for error texts."""


class NIDS(StaticMixing):
    """NIDS for  min sum_i s_i(x) + r_i(x),  s_i and r_i convex, s_i L_i-smooth.

        z_i(1) = x_i(0) - a_i grad s_i(x_i(0))
        y_i(k) = 2 x_i(k) - x_i(k-1) - a_i [grad s_i(x_i(k)) - grad s_i(x_i(k-1))]
        z_i(k+1) = z_i(k) - x_i(k) + y_i(k) - c a_i [y_i(k) - sum_j w_ij y_j(k)]
        x_i(k) = argmin_x r_i(x) + |x - z_i(k)|^2 / (2 a_i)

    One message of y_i travels in each round.

    i: id of the agent
    x: x_i(0), any shape, the same shape at all agents. The first step needs no message, so that x
        is x_i(1) before the first round
    weights: row i of W, symmetric and doubly stochastic, of a static graph
    cost: the gradient of s_i and the proximal operator of r_i
    step: a_i, its own. The iterates converge to an optimum for a_i < 2 / L_i at all agents, on any
        connected graph
    coupling: c, the same at all agents, at most 1 / (2 max a_i); None for 1 / (2 a_i), where all
        agents have the same step
    rounds: number of rounds until done; None for no end
    Raises ConfigError that names the step if it is so large that x grows without end.
    Source: Li, Shi & Yan 2019, IEEE Trans. Signal Process. 67(17), 4494-4506, "A decentralized
    proximal-gradient method with network independent step-sizes and separated convergence rates".
    """

    same = ("coupling",)

    def __init__(
        self,
        i: int,
        x: ArrayLike,
        weights: Rows,
        cost: CompositeCost,
        step: float,
        coupling: float | None = None,
        rounds: int | None = None,
    ) -> None:
        super().__init__(i, x, weights, rounds)
        self.step_size = Constant(step)
        self.coupling = 0.5 / step if coupling is None else coupling
        if not is_number(self.coupling) or not 0.0 < self.coupling * step <= 0.5:
            raise ConfigError(
                f"agent {i}: coupling",
                f"{coupling}",
                f"above 0, at most 1 / (2 step) = {0.5 / step:g}",
            )
        self.gradient = cost.checked_gradient(i)
        self.proximal = cost.checked_proximal(i, step)
        self._watch = GrowthWatch(f"agent {i}", self.step_size, SMALL_ENOUGH_STEP)
        self._descent = step * self.gradient(0, self.x)
        self._z = self.x - self._descent
        self._advance()

    def _advance(self) -> None:
        """Compute x_i and y_i from z_i."""
        before = self.x
        descent = self._descent
        self.x = np.array(self.proximal(self.k, self._z))
        self._descent = self.step_size.a * self.gradient(self.k, self.x)
        self._y = 2.0 * self.x - before - self._descent + descent

    def payload(self) -> Vec:
        """Return y_i."""
        return self._y

    def mix_in(self, row: Row, heard: Mapping[int, Vec]) -> None:
        """Compute z_i, then x_i and y_i."""
        apart = self._y - mix(self.i, row, self._y, heard)
        self._z += self._y - self.x - self.coupling * self.step_size.a * apart
        self._watch(self.k, self._z)
        self._advance()
