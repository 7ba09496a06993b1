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
GAP, STANDARD = 1e-12, 1e-8
"""Relative, asked for, as x is only as good as the root of it; and accepted, for problems that allow no more."""
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
    Accuracy: GAP where Clarabel gets there, at least STANDARD.
    """

    name = "Clarabel"

    def __init__(
        self,
        x: cp.Variable,
        objective: cp.Expression,
        constraints: list[cp.Constraint],
        penalty: float = 0.0,
    ) -> None:
        self._x = cp.Variable(
            x.shape
        )  # of a variable with attributes, cvxpy's canonical form has another one
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
        self._given = (
            self._hessian(data),
            self._q,
            data["A"],
            data["b"],
            dims_to_solver_cones(data["dims"]),
        )
        self._solvers: dict[float, Any] = {}

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
        solution = self._solution(q, GAP)
        if str(solution.status) not in WORDS and not _accurate(solution):
            solution = self._solution(q, STANDARD)
        status = str(solution.status)
        if status in WORDS or not (status == "Solved" or _accurate(solution)):
            return WORDS.get(status, status)
        return np.array(solution.x)[self._columns]

    def _solution(self, q: Vec, gap: float) -> Any:
        solver = self._solvers.get(gap)
        if solver is None:
            solver = self._solvers[gap] = clarabel.DefaultSolver(
                *self._given, _settings(gap)
            )
        solver.update(q=q)
        return solver.solve()


def _accurate(solution: Any) -> bool:
    """Whatever its status: Clarabel also says when rounding keeps it from going on, and it was there already."""
    gap = abs(solution.obj_val - solution.obj_val_dual) / (1.0 + abs(solution.obj_val))
    return bool(max(solution.r_prim, solution.r_dual, gap) <= STANDARD)


def _settings(gap: float) -> Any:
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    settings.max_iter = MOST_ITERATIONS
    settings.max_threads = 1
    settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = gap
    settings.presolve_enable = False  # it would forbid updates
    return settings
