"""An agent's convex problem for a given share of the resources."""

import warnings

import cvxpy as cp
import numpy as np

from crazychoir.errors import SolverError
from crazychoir.optimization.algorithms.primal_decomposition import AllocatedSolution
from crazychoir.optimization.problems.conic import CONIC_LIMITS
from crazychoir.optimization.problems.problems import ConstraintCoupled, require_problem
from crazychoir.types import Vec


class Allocation:
    """The local problem of primal decomposition, compiled once with y as a parameter.

        p_i(y) = min f_i(x) + M rho   s.t.  g_i(x) <= y + rho 1 : mu,   x in X_i,   rho >= 0

    problem: f_i, g_i and X_i
    penalty: M, larger than the sum of the prices on which the team will agree
    Raises SolverError if f_i has no minimum on X_i, or if X_i is empty.
    """

    def __init__(self, problem: ConstraintCoupled, penalty: float) -> None:
        require_problem(problem, ConstraintCoupled, "Allocation")
        self._problem = problem
        rho = cp.Variable(nonneg=True)
        self._y = cp.Parameter(problem.S)
        self._row = cp.vec(problem.coupling, order="F") <= self._y + rho
        constraints = [self._row, *problem.local.constraints]
        self._program = cp.Problem(
            cp.Minimize(problem.local.objective + penalty * rho), constraints
        )
        self._rho = rho

    def allocate(self, y: Vec) -> AllocatedSolution:
        """Return p_i(y) and its prices.

        y: (S,)
        """
        problem = self._problem
        self._y.value = y
        try:
            with warnings.catch_warnings():
                # An inaccurate answer shows in the status, which is checked below.
                warnings.simplefilter("ignore")
                self._program.solve(
                    solver=cp.CLARABEL, max_iter=CONIC_LIMITS.most_iterations
                )
        except cp.SolverError as error:
            raise SolverError(f"{problem.where}: local problem", str(error)) from error
        if self._program.status not in (cp.OPTIMAL, cp.OPTIMAL_INACCURATE):
            status = self._program.status.removesuffix("_inaccurate")
            raise SolverError(
                f"{problem.where}: local problem",
                problem.local.why(status, np.zeros(problem.n)),
            )
        x = np.array(np.ravel(problem.x.value), dtype=float)
        mu = np.maximum(np.ravel(self._row.dual_value), 0.0)
        return AllocatedSolution(
            float(self._program.value), x, mu, float(self._rho.value)
        )
