"""Dual decomposition of a problem with a common variable."""

from collections.abc import Mapping

import numpy as np

from crazychoir.optimization.problems.problems import CostCoupled, require_problem
from crazychoir.optimization.rounds.iteration import Iteration
from crazychoir.optimization.rounds.messages import check_array
from crazychoir.optimization.rounds.step_size import (
    GrowthWatch,
    StepSize,
    step_size,
)
from crazychoir.types import Vec

SMALL_ENOUGH_STEP = "below s / (2 max degree), with strongly convex f_i of modulus s"
"""Steps with which dual decomposition converges, for error texts."""


class DualDecomposition(Iteration):
    """Sub-gradient ascent on the dual of a problem with a common variable.

    It solves min sum_i f_i(x_i)  s.t.  x_i in X_i,  x_i = x_j  for each edge {i, j}:

        x_i(k) = argmin_{x in X_i} f_i(x) + x'v_i(k)
        v_i(k+1) = v_i(k) + 2 a_k sum_{j in N_i(k)} (x_i(k) - x_j(k)),   v_i(0) = 0

    v_i = sum_j (l_ij - l_ji), with l_ij(k+1) = l_ij(k) + a_k (x_i(k) - x_j(k)) the multipliers of
    x_i = x_j. Only this sum matters, so only x_i travels, and sum_i v_i = 0 in each round.
    The graph is undirected, static or time-varying.

    problem: f_i and X_i
    step: a_k, the same at all agents. A constant step converges if f_i is strongly convex
        (modulus s) and a < s / (2 max degree). Diminishing(a, p), 1/2 < p <= 1, converges whenever
        f_i is strictly convex
    rounds: number of rounds until done; None for no end
    x: (n,) of the last round, 0 before the first
    v: (n,)
    Raises SolverError if the local problem is infeasible or unbounded: X_i must bound x where f_i
    does not.
    Source: Terelius, Topcu & Murray 2011, IFAC World Congress, "Decentralized multi-agent
    optimization via dual decomposition".
    """

    connected = True
    undirected = True
    same = ("step_size",)

    def __init__(
        self, problem: CostCoupled, step: float | StepSize, rounds: int | None = None
    ) -> None:
        require_problem(problem, CostCoupled, "DualDecomposition")
        super().__init__(problem.agent, rounds)
        self.problem, self.step_size = problem, step_size(step)
        where = f"agent {problem.agent}"
        self._watch = GrowthWatch(where, self.step_size, SMALL_ENOUGH_STEP)
        self.heavy = not problem.is_fast()
        self.x = np.zeros(problem.n)
        self.v = np.zeros(problem.n)

    def message(self) -> Vec:
        """Return x_i."""
        if self.k == 0:
            self.x = self.problem.argmin(self.v)
        return self.x

    def update(self, heard: Mapping[int, Vec]) -> None:
        """Ascend along the dual, then minimise for the next round."""
        apart = len(heard) * self.x
        for j, x in heard.items():
            apart -= check_array(self.i, j, x, self.x)
        self.v += 2.0 * self.step_size(self.k) * apart
        self._watch(self.k, self.v)
        self.x = self.problem.argmin(self.v)
