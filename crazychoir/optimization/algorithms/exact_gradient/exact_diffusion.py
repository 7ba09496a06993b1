"""Exact diffusion for a common variable."""

from collections.abc import Mapping

from numpy.typing import ArrayLike

from crazychoir.optimization.problems.gradient import CheckedFunction, Gradient
from crazychoir.optimization.rounds.mixing import Row, Rows, mix
from crazychoir.optimization.rounds.static_mixing import StaticMixing
from crazychoir.optimization.rounds.step_size import Constant, GrowthWatch
from crazychoir.types import Vec

SMALL_ENOUGH_STEP = "below 2 / L, f_i L-smooth"
"""Steps with which exact diffusion converges, for error texts."""


class ExactDiffusion(StaticMixing):
    """Exact diffusion for  min sum_i f_i(x),  f_i convex and L-smooth.

        p_i(k+1) = x_i(k) - a grad f_i(x_i(k)),   p_i(0) = x_i(0)      (adapt)
        c_i(k+1) = p_i(k+1) + x_i(k) - p_i(k)                          (correct)
        x_i(k+1) = sum_j v_ij c_j(k+1),   V = (I + W) / 2              (combine)

    One message of c_i travels in each round. From the second round on, the recursion is that of
    NIDS with the step a at all agents and r_i = 0.

    i: id of the agent
    x: x_i(0), any shape, the same shape at all agents
    weights: row i of W, symmetric and doubly stochastic, of a static graph
    gradient: grad f_i
    step: a, the same at all agents. The iterates converge to an optimum for a < 2 / L on any
        connected graph, as those of NIDS
    rounds: number of rounds until done; None for no end
    Raises ConfigError that names the step if it is so large that x grows without end.
    Source: Yuan, Ying, Zhao & Sayed 2019, IEEE Trans. Signal Process. 67(3), 708-723, "Exact
    diffusion for distributed optimization and learning, part I"; the bound: Li, Shi & Yan 2019.
    """

    same = ("step_size",)

    def __init__(
        self,
        i: int,
        x: ArrayLike,
        weights: Rows,
        gradient: Gradient,
        step: float,
        rounds: int | None = None,
    ) -> None:
        super().__init__(i, x, weights, rounds)
        self.step_size = Constant(step)
        self.gradient = CheckedFunction(i, "gradient", gradient)
        self._watch = GrowthWatch(f"agent {i}", self.step_size, SMALL_ENOUGH_STEP)
        self._adapted = self.x
        self._adapt()

    def _adapt(self) -> None:
        """Compute p_i and c_i from x_i."""
        before = self._adapted
        self._adapted = self.x - self.step_size.a * self.gradient(self.k, self.x)
        self._corrected = self._adapted + self.x - before

    def payload(self) -> Vec:
        """Return c_i."""
        return self._corrected

    def mix_in(self, row: Row, heard: Mapping[int, Vec]) -> None:
        """Combine, then adapt and correct for the next round."""
        self.x = 0.5 * (self._corrected + mix(self.i, row, self._corrected, heard))
        self._watch(self.k, self.x)
        self._adapt()
