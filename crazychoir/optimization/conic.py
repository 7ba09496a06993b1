"""Convex programs of any cone: canonicalised by cvxpy once, then solved by Clarabel with other costs."""

from typing import Any, Final

import clarabel
import cvxpy as cp
import numpy as np
import scipy.sparse as sp
from cvxpy.reductions.solvers.conic_solvers.clarabel_conif import dims_to_solver_cones

from crazychoir.types import Vec

MOST_ITERATIONS: Final = 200
"""Of the interior-point method, a solve."""
SOLVED = ("Solved", "AlmostSolved")
WORDS = {
    "PrimalInfeasible": "infeasible",
    "AlmostPrimalInfeasible": "infeasible",
    "DualInfeasible": "unbounded",
    "AlmostDualInfeasible": "unbounded",
    "MaxIterations": "too many iterations",
}


class ConicProgram:
    """min f(x) + p'x + rho/2 |x|^2  s.t.  x in X, with f and X as cvxpy has them, for many p.

    Canonical form: z = (x, further variables), min 1/2 z'Pz + q'z s.t. b - A z in a product of cones. Only q changes
    with p, so that cvxpy is not asked again; rho is known when it is built, and so are parameters, until `refresh`.
    Accuracy: a gap of 1e-13 where Clarabel gets there, else of 1e-8.
    """

    name = "Clarabel"

    def __init__(
        self, x: cp.Variable, objective: cp.Expression, constraints: list[cp.Constraint], penalty: float = 0.0
    ) -> None:
        self._x = cp.Variable(x.shape)  # of a variable with attributes, cvxpy's canonical form has another one
        self._penalty = penalty
        self._problem = cp.Problem(cp.Minimize(objective), [*constraints, self._x == x])
        self._columns = np.zeros(0, int)
        self.refresh()

    def refresh(self) -> None:
        """Take the parameters' values."""
        data = self._problem.get_problem_data(cp.CLARABEL)[0]
        first = data["param_prob"].var_id_to_col[self._x.id]
        self._columns = np.arange(first, first + self._x.size)
        self._q = np.asarray(data["c"], float)
        self._solver = clarabel.DefaultSolver(
            self._hessian(data), self._q, data["A"], data["b"], dims_to_solver_cones(data["dims"]), _settings()
        )

    def _hessian(self, data: dict[str, Any]) -> Any:
        """The upper triangle of P, with rho on the diagonal of x."""
        size = len(data["c"])
        diagonal = np.zeros(size)
        diagonal[self._columns] = self._penalty
        given = sp.csc_array((size, size)) if data.get("P") is None else data["P"]
        return sp.csc_matrix(sp.triu(given + sp.diags_array(diagonal)))

    def solve(self, p: Vec) -> Vec | str:
        """The solution x (n,), or why there is none: in the words of WORDS, or Clarabel's own."""
        if not np.isfinite(p).all():
            return "not finite"
        q = self._q.copy()
        q[self._columns] += p
        self._solver.update(q=q)
        solution = self._solver.solve()
        status = str(solution.status)
        return np.array(solution.x)[self._columns] if status in SOLVED else WORDS.get(status, status)


def _settings() -> Any:
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    settings.max_iter = MOST_ITERATIONS
    settings.max_threads = 1
    # x is as good as the square root of the gap: ask for what Clarabel can do, accept its standard accuracy.
    settings.tol_gap_abs = settings.tol_gap_rel = 1e-13
    settings.tol_feas = 1e-11
    settings.reduced_tol_gap_abs = settings.reduced_tol_gap_rel = settings.reduced_tol_feas = 1e-8
    settings.presolve_enable = False  # it would forbid updates
    return settings
