"""Gradient tracking on undirected graphs."""

from collections.abc import Mapping
from typing import Any

from numpy.typing import ArrayLike

from crazychoir.optimization.problems.gradient import CheckedFunction, Gradient
from crazychoir.optimization.rounds.iteration import copy_state
from crazychoir.optimization.rounds.messages import check_parts
from crazychoir.optimization.rounds.mixing import Mixing, Row, Rows, mix
from crazychoir.optimization.rounds.step_size import (
    GrowthWatch,
    StepSize,
    step_size,
)
from crazychoir.types import Vec

SMALL_ENOUGH_STEP = "of the order of (1 - s)^2 / L, s the second largest singular value of W, f_i L-smooth"
"""Steps with which gradient tracking converges, for error texts."""


class GradientTracking(Mixing):
    """Gradient tracking for a common variable: min sum_i f_i(x), f_i smooth.

        x_i(k+1) = sum_j w_ij x_j(k) - a_k d_i(k)
        d_i(k+1) = sum_j w_ij d_j(k) + grad f_i(x_i(k+1)) - grad f_i(x_i(k))
        d_i(0) = grad f_i(x_i(0))

    d_i tracks the mean of all gradients: sum_i d_i(k) = sum_i grad f_i(x_i(k)). One message of
    [x_i, d_i] travels in each round.

    i: id of the agent
    x: start, any shape, the same shape at all agents
    weights: row i, doubly stochastic, or one row for each graph of a sequence
    gradient: grad f_i
    step: a_k, best constant. With f_i strongly convex and L-smooth, convergence is linear if the
        step is small enough: of the order of (1 - s)^2 / L, with s the second largest singular
        value of W
    rounds: number of rounds until done; None for no end
    Raises ConfigError that names the step if it is so large that x grows without end.
    Source: Qu & Li 2018, IEEE Trans. Control Netw. Syst. 5(3), 1245-1260; Nedic, Olshevsky & Shi
    2017, SIAM J. Optim.
    """

    def __init__(
        self,
        i: int,
        x: ArrayLike,
        weights: Rows,
        gradient: Gradient,
        step: float | StepSize,
        rounds: int | None = None,
    ) -> None:
        super().__init__(i, weights, rounds)
        self.x = copy_state(f"agent {i}: x", x)
        self.gradient, self.step_size = (
            CheckedFunction(i, "gradient", gradient),
            step_size(step),
        )
        self._watch = GrowthWatch(f"agent {i}", self.step_size, SMALL_ENOUGH_STEP)
        self.g = self.d = self.gradient(0, self.x)

    def payload(self) -> list[Vec]:
        """Return [x_i, d_i]."""
        return [self.x, self.d]

    def mix_in(self, row: Row, heard: Mapping[int, Any]) -> None:
        """Average, move along the tracked gradient, and update the tracked gradient."""
        check_parts(self.i, self.k, heard, object, object)
        x = (
            mix(self.i, row, self.x, {j: theirs[0] for j, theirs in heard.items()})
            - self.step_size(self.k) * self.d
        )
        self._watch(self.k, x)
        g = self.gradient(self.k, x)
        self.d = (
            mix(self.i, row, self.d, {j: theirs[1] for j, theirs in heard.items()})
            + g
            - self.g
        )
        self.x = x
        self.g = g
