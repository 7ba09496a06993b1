"""GT-SAGA: gradient tracking with variance reduction, for losses of many samples."""

from typing import Final

import numpy as np
from numpy.typing import ArrayLike

from crazychoir.optimization.problems.gradient import CheckedFunction, Samples
from crazychoir.optimization.rounds.mixing import Rows
from crazychoir.optimization.rounds.step_size import StepSize
from crazychoir.optimization.rounds.tracking import Tracking
from crazychoir.types import Vec

SMALL_ENOUGH_STEP = "of the order of (1 - s)^2 / L, s the second largest singular value of W, losses L-smooth"
"""Steps with which GT-SAGA converges, for error texts."""
SUMMATION_ROUNDS: Final = 64
"""Rounds after which the mean of the table is summed up anew.

In between it is updated by the changes of the table. Their rounding errors would add up.
"""


class GTSAGA(Tracking):
    """Gradient tracking for  min sum_i f_i(x),  f_i(x) = 1/m_i sum_s l_is(x),  a few samples a round.

        x_i(k+1) = sum_j w_ij x_j(k) - a y_i(k)
        g_i(k+1) = mean over s in B of (grad l_is(x_i(k+1)) - t_is) + 1/m_i sum_s t_is
        t_is <- grad l_is(x_i(k+1)) for s in B
        y_i(k+1) = sum_j w_ij y_j(k) + g_i(k+1) - g_i(k)
        y_i(0) = g_i(0) = grad f_i(x_i(0)),   t_is = grad l_is(x_i(0)) at first

    B is the mini-batch of the round. The agent stores the newest gradient t_is of each sample, so
    the error of g_i goes to zero with the distance from the optimum, and a constant step reaches the
    optimum itself: without this table it only reaches a neighbourhood, see `SubgradientMethod`. One
    message of [x_i, y_i] travels in each round. Sampling needs m_i gradients at the start and then
    as many as the mini-batch has.

    i: id of the agent
    x: start, any shape, the same shape at all agents
    weights: row i, doubly stochastic, or one row for each graph of a sequence
    samples: the losses l_is of this agent. The source draws one sample a round; a larger batch has
        the same fixed point and less variance
    step: a, constant. With losses that are L-smooth and f strongly convex, convergence is linear in
        the mean square if the step is of the order of (1 - s)^2 / L, with s the second largest
        singular value of W, or smaller
    rounds: number of rounds until done; None for no end
    Raises ConfigError that names the step if x grows without end.
    Source: Xin, Khan & Kar 2020, "Variance-reduced decentralized stochastic optimization with
    accelerated convergence", IEEE Trans. Signal Process. 68, 6255-6271.
    """

    def __init__(
        self,
        i: int,
        x: ArrayLike,
        weights: Rows,
        samples: Samples,
        step: float | StepSize,
        rounds: int | None = None,
    ) -> None:
        super().__init__(i, x, weights, step, SMALL_ENOUGH_STEP, rounds)
        self.samples = samples
        self._gradient = CheckedFunction(i, "gradient", samples.one)
        count = len(samples.samples)
        self._table = np.array([self._at(0, self.x, s) for s in range(count)])
        self._mean = self._table.mean(axis=0)
        self.track(self._mean)

    def estimate(self, k: int, x: Vec) -> Vec:
        """Return g_i at x, and store the new gradients of the mini-batch."""
        drawn = self.samples.draw()
        new = np.array([self._at(k, x, s) for s in drawn])
        change = new - self._table[drawn]
        g: Vec = change.mean(axis=0) + self._mean
        self._table[drawn] = new
        if (k + 1) % SUMMATION_ROUNDS == 0:
            self._mean = self._table.mean(axis=0)
        else:
            self._mean = self._mean + change.sum(axis=0) / len(self._table)
        return g

    def direction(self) -> Vec:
        """Return y_i."""
        return self.y

    def _at(self, k: int, x: Vec, s: int) -> Vec:
        """Return the gradient at x of the loss of sample s."""
        return self._gradient(k, x, s, shape=x.shape)
