"""Gradient tracking on directed graphs."""

from collections.abc import Mapping
from typing import Any

from numpy.typing import ArrayLike

from crazychoir.optimization.problems.gradient import CheckedFunction, Gradient
from crazychoir.optimization.rounds.iteration import Iteration, copy_state
from crazychoir.optimization.rounds.messages import check_array, check_parts
from crazychoir.optimization.rounds.mixing import Rows, check_rows, mix
from crazychoir.optimization.rounds.step_size import (
    GrowthWatch,
    StepSize,
    step_size,
)
from crazychoir.types import PerNeighbor, Vec

SMALL_ENOUGH_STEP = (
    "well below 1 / L, with L-smooth f_i; the smaller, the slower the graph mixes"
)
"""Steps with which push-pull gradient tracking converges, for error texts."""


class DirectedGradientTracking(Iteration):
    """Push-pull gradient tracking for a common variable on a directed graph.

    It solves min sum_i f_i(x), f_i smooth:

        x_i(k+1) = sum_j a_ij (x_j(k) - a_k d_j(k))
        d_i(k+1) = sum_j b_ij d_j(k) + grad f_i(x_i(k+1)) - grad f_i(x_i(k))
        d_i(0) = grad f_i(x_i(0))

    The message from i to j is [x_i - a_k d_i, b_ji d_i].
    With f_i strongly convex and smooth, convergence is linear if the step is small enough.

    i: id of the agent
    x: start, any shape, the same shape at all agents
    weights: row i of A, which is row-stochastic, such as `rows(graph, row_stochastic)`
    shares: column i of B, which is column-stochastic, {j: b_ji}: how much of its d agent i gives to
        each agent that hears it, and how much it keeps, such as `columns(graph, column_stochastic)`
    gradient: grad f_i
    step: a_k, best constant and the same at all agents
    rounds: number of rounds until done; None for no end

    weights and shares are for one graph, or a sequence with one for each graph of a sequence.
    Source: Pu, Shi, Xu & Nedic 2021, IEEE Trans. Autom. Control 66(1), 1-16 (push-pull);
    Xin & Khan 2018, IEEE Control Syst. Lett. 2(3), 315-320 (AB).
    """

    connected = True

    def __init__(
        self,
        i: int,
        x: ArrayLike,
        weights: Rows,
        shares: Rows,
        gradient: Gradient,
        step: float | StepSize,
        rounds: int | None = None,
    ) -> None:
        super().__init__(i, rounds)
        self.x = copy_state(f"agent {i}: x", x)
        self.weights, self.shares = (
            check_rows(i, weights),
            check_rows(i, shares, "shares"),
        )
        self.gradient, self.step_size = (
            CheckedFunction(i, "gradient", gradient),
            step_size(step),
        )
        self._watch = GrowthWatch(f"agent {i}", self.step_size, SMALL_ENOUGH_STEP)
        self.g = self.d = self.gradient(0, self.x)

    def message(self) -> PerNeighbor:
        """Return [x_i - a_k d_i, b_ji d_i] for each j."""
        share = self.shares[self.k % len(self.shares)]
        moved = self._moved()
        return PerNeighbor(
            {j: [moved, b * self.d] for j, b in share.items() if j != self.i}
        )

    def _moved(self) -> Vec:
        return self.x - self.step_size(self.k) * self.d

    def update(self, heard: Mapping[int, Any]) -> None:
        """Pull x and push d."""
        row = self.weights[self.k % len(self.weights)]
        check_parts(self.i, self.k, heard, object, object)
        x = mix(
            self.i, row, self._moved(), {j: theirs[0] for j, theirs in heard.items()}
        )
        self._watch(self.k, x)
        g = self.gradient(self.k, x)
        d = self.shares[self.k % len(self.shares)][self.i] * self.d + g - self.g
        for j, (_, theirs) in heard.items():
            d = d + check_array(self.i, j, theirs, d)
        self.x = x
        self.d = d
        self.g = g
