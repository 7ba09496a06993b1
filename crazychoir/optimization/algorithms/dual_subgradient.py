"""The distributed dual sub-gradient method for coupling constraints."""

from collections.abc import Mapping

import numpy as np

from crazychoir.optimization.problems.problems import ConstraintCoupled, require_problem
from crazychoir.optimization.rounds.average import RunningAverage
from crazychoir.optimization.rounds.mixing import Mixing, Row, Rows, mix
from crazychoir.optimization.rounds.step_size import StepSize, step_size
from crazychoir.types import Vec


class DualSubgradient(Mixing):
    """Dual sub-gradient method for a problem with coupling constraints.

    It solves min sum_i f_i(x_i)  s.t.  sum_i g_i(x_i) <= sum_i b_i,  x_i in X_i:

        v_i = sum_j w_ij l_j(k)
        x_i(k+1) = argmin_{x in X_i} f_i(x) + v_i'g_i(x)
        l_i(k+1) = max(0, v_i + a_k (g_i(x_i(k+1)) - b_i)),   l_i(0) = 0

    The graph is undirected, static or time-varying, and jointly connected.

    problem: f_i, g_i, b_i and X_i
    weights: row i, doubly stochastic, or one row for each graph of a sequence
    step: a_k, Diminishing(a, p) with 1/2 < p <= 1, the same at all agents
    rounds: number of rounds until done; None for no end
    x: (n,) of the last round
    average: (n,) running average of x weighted by a_k, which converges to the optimum even where x
        jumps between corners
    prices: l_i (S,) >= 0, which converge to the optimal multipliers
    Raises SolverError if the local problem is infeasible or unbounded: X_i must bound x where f_i
    does not.
    Source: Falsone, Margellos, Garatti & Prandini 2017, Automatica 84, 149-158.
    """

    common = False
    same = ("step_size",)

    def __init__(
        self,
        problem: ConstraintCoupled,
        weights: Rows,
        step: float | StepSize,
        rounds: int | None = None,
    ) -> None:
        require_problem(problem, ConstraintCoupled, "DualSubgradient")
        super().__init__(problem.agent, weights, rounds)
        self.problem, self.step_size = problem, step_size(step)
        self.heavy = not problem.is_fast()
        self.x = np.zeros(problem.n)
        self.prices = np.zeros(problem.S)
        self._average = RunningAverage()

    @property
    def average(self) -> Vec:
        """(n,) weighted mean of x_i since the first round; x_i itself before it."""
        return self.x if self._average.value is None else self._average.value

    def payload(self) -> Vec:
        """Return l_i."""
        return self.prices

    def mix_in(self, row: Row, heard: Mapping[int, Vec]) -> None:
        """Average the prices, minimise at them, and raise the prices of scarce resources."""
        v = mix(self.i, row, self.prices, heard)
        a = self.step_size(self.k)
        self.x = self.problem.argmin(v)
        self._average.add(self.x, a)
        self.prices = np.maximum(0.0, v + a * self.problem.excess(self.x))
