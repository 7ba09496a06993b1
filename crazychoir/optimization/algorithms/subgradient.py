"""The distributed sub-gradient method."""

from collections.abc import Mapping

import numpy as np
from numpy.typing import ArrayLike

from crazychoir.optimization.problems.gradient import (
    CheckedFunction,
    Gradient,
    Project,
    keep_point,
)
from crazychoir.optimization.rounds.average import RunningAverage
from crazychoir.optimization.rounds.iteration import copy_state
from crazychoir.optimization.rounds.mixing import Mixing, Row, Rows, mix
from crazychoir.optimization.rounds.step_size import (
    GrowthWatch,
    StepSize,
    step_size,
)
from crazychoir.types import Vec

SMALL_ENOUGH_STEP = (
    "below 2 / L where f_i is L-smooth; Diminishing(a, p) with 1/2 < p <= 1 elsewhere"
)
"""Steps with which the subgradient method stays near an optimum, for error texts."""


class SubgradientMethod(Mixing):
    """Projected sub-gradient method for  min sum_i f_i(x), x in X,  with f_i and X convex.

        v_i = sum_j w_ij x_j,   x_i <- P_X(v_i - a_k g_i(v_i)),   g_i(v) a sub-gradient of f_i at v

    i: id of the agent
    x: start, any shape, the same shape at all agents
    weights: row i, doubly stochastic, or one row for each graph of a sequence
    gradient: g_i, also a stochastic one, see `Samples`
    step: a_k, the same at all agents. With sum a_k infinite and sum a_k^2 finite it converges to an
        optimum: Diminishing(a, p), 1/2 < p <= 1. A constant step converges to a neighbourhood that
        grows with the step
    project: P_X, the same set at all agents, see projection.py
    rounds: number of rounds until done; None for no end
    average: running average of x_i weighted by a_k; its cost converges even where that of x_i jumps
    Source: Nedic, Ozdaglar & Parrilo 2010, IEEE Trans. Autom. Control 55(4), 922-938.
    """

    same = ("step_size",)

    def __init__(
        self,
        i: int,
        x: ArrayLike,
        weights: Rows,
        gradient: Gradient,
        step: float | StepSize,
        project: Project = keep_point,
        rounds: int | None = None,
    ) -> None:
        super().__init__(i, weights, rounds)
        self.x = copy_state(f"agent {i}: x", x)
        self.gradient = CheckedFunction(i, "gradient", gradient)
        self.project = CheckedFunction(i, "project", project)
        self.step_size = step_size(step)
        self._watch = GrowthWatch(f"agent {i}", self.step_size, SMALL_ENOUGH_STEP)
        self._average = RunningAverage()

    @property
    def average(self) -> Vec:
        """Weighted mean of x_i since the start; x_i itself before the first round."""
        return self.x if self._average.value is None else self._average.value

    def payload(self) -> Vec:
        """Return x_i."""
        return self.x

    def mix_in(self, row: Row, heard: Mapping[int, Vec]) -> None:
        """Average, move along the negative gradient, project."""
        v = mix(self.i, row, self.x, heard)
        a = self.step_size(self.k)
        self._watch(self.k, v)
        self.x = np.array(self.project(self.k, v - a * self.gradient(self.k, v)))
        self._average.add(self.x, a)
