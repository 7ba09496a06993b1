"""The distributed sub-gradient method on one block of coordinates at a time."""

from numpy.typing import ArrayLike

from crazychoir.optimization.algorithms.block_consensus import BlockConsensus
from crazychoir.optimization.problems.gradient import CheckedFunction, ProjectedCost
from crazychoir.optimization.rounds.blocks import RandomBlocks
from crazychoir.optimization.rounds.mixing import Row, Rows
from crazychoir.optimization.rounds.step_size import (
    GrowthWatch,
    StepSize,
    step_size,
)
from crazychoir.types import Vec

SMALL_ENOUGH_STEP = (
    "below 2 / L where f_i is L-smooth; Diminishing(a, p) with 1/2 < p <= 1 elsewhere"
)
"""Steps with which the block subgradient method stays near an optimum, for error texts."""


class BlockSubgradientMethod(BlockConsensus):
    """Block-wise projected sub-gradient method for  min sum_i f_i(x), x in X,  where x is large.

        v_i = sum_j w_ij x_j|i,   x_i[l] <- P_X(v_i - a_k g_i(v_i))[l]
        l = the block that i draws, if it is awake

    The blocks, the messages and x_j|i are those of BlockConsensus. The weights are doubly
    stochastic.

    problem: g_i and P_X, where X is a product of sets of the blocks, such as a box
    step: a_k, the same at all agents. Diminishing(a, p) with 1/2 < p <= 1 converges to an optimum
        (in expectation), a constant step to a neighbourhood of it
    i, x, weights, blocks, rounds: see BlockConsensus
    Source: Farina & Notarstefano 2020, "Randomized block proximal methods for distributed
    stochastic big-data optimization", IEEE Trans. Autom. Control.
    """

    doubly_stochastic = True
    same = ("step_size",)

    def __init__(
        self,
        i: int,
        x: ArrayLike,
        weights: Rows,
        blocks: RandomBlocks,
        problem: ProjectedCost,
        step: float | StepSize,
        rounds: int | None = None,
    ) -> None:
        super().__init__(i, x, weights, blocks, rounds)
        self.gradient = CheckedFunction(i, "gradient", problem.gradient)
        self.project = CheckedFunction(i, "project", problem.project)
        self.step_size = step_size(step)
        self._watch = GrowthWatch(f"agent {i}", self.step_size, SMALL_ENOUGH_STEP)

    def changed(self, row: Row, part: slice) -> Vec:
        """Return P_X(v_i - a_k g_i(v_i))[l], the new block.

        row: the weights w_ij of this round
        part: slice of x that is block l
        """
        v = self.mixed(row, slice(None))
        self._watch(self.k, v)
        moved = v - self.step_size(self.k) * self.gradient(self.k, v)
        return self.project(self.k, moved)[part]
