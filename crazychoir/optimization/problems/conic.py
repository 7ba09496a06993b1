"""Convex programs over any cone: brought to standard form by cvxpy once, then solved by Clarabel.

Only the linear cost changes between two solves.
"""

from dataclasses import dataclass
from typing import Any

import clarabel
import cvxpy as cp
import numpy as np
import scipy.sparse as sp
from cvxpy.reductions.solvers.conic_solvers.clarabel_conif import dims_to_solver_cones

from crazychoir.types import Vec


@dataclass(frozen=True, slots=True)
class ConicLimits:
    """Limits of a solve by the interior-point method."""

    most_iterations: int = 200
    """Interior-point iterations of one solve."""
    first_gap: float = 1e-12
    """Relative duality gap that is asked for first: x is only as accurate as its square root.
    """
    accepted_gap: float = 1e-8
    """Relative duality gap that is accepted for problems which do not reach `first_gap`."""


CONIC_LIMITS = ConicLimits()


CLARABEL_STATUS_TEXTS = {
    "PrimalInfeasible": "infeasible",
    "AlmostPrimalInfeasible": "infeasible",
    "DualInfeasible": "unbounded",
    "AlmostDualInfeasible": "unbounded",
    "MaxIterations": "too many iterations",
}
"""Status texts of Clarabel that callers test for."""


class ConicProgram:
    """A convex program of cvxpy expressions, solved for many linear costs p.

        min f(x) + p'x + rho/2 |x|^2  s.t.  x in X

    Canonical form: z = (x, further variables),  min 1/2 z'Pz + q'z  s.t.  b - A z in a product of
    cones. Only q changes with p, so that cvxpy is used once. The penalty rho is fixed when the
    program is built. Parameters are fixed until `refresh`.
    Accuracy: CONIC_LIMITS.first_gap where Clarabel reaches it, at least CONIC_LIMITS.accepted_gap.

    x: cvxpy variable
    objective: f
    constraints: X
    penalty: rho
    """

    name = "Clarabel"
    """Name of the solver."""

    def __init__(
        self,
        x: cp.Variable,
        objective: cp.Expression,
        constraints: list[cp.Constraint],
        penalty: float = 0.0,
    ) -> None:
        # A copy of x: cvxpy replaces a variable with attributes by another one in canonical form.
        self._x = cp.Variable(x.shape)
        self._penalty = penalty
        self._problem = cp.Problem(cp.Minimize(objective), [*constraints, self._x == x])
        self._columns = np.zeros(0, int)
        self.refresh()

    def refresh(self) -> None:
        """Read the values of the parameters again."""
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
        """Return the upper triangle of P, with rho on the diagonal of x."""
        size = len(data["c"])
        diagonal = np.zeros(size)
        diagonal[self._columns] = self._penalty
        given = sp.csc_array((size, size)) if data.get("P") is None else data["P"]
        return sp.csc_matrix(sp.triu(given + sp.diags_array(diagonal)))

    def solve(self, p: Vec) -> Vec | str:
        """Return the solution x (n,), or the reason why there is none.

        The reason is a text of CLARABEL_STATUS_TEXTS, or Clarabel's own status.
        """
        if not np.isfinite(p).all():
            return "not finite"
        q = self._q.copy()
        q[self._columns] += p
        solution = self._solution(q, CONIC_LIMITS.first_gap)
        if str(solution.status) not in CLARABEL_STATUS_TEXTS and not _is_accurate(
            solution
        ):
            solution = self._solution(q, CONIC_LIMITS.accepted_gap)
        status = str(solution.status)
        if status in CLARABEL_STATUS_TEXTS or not (
            status == "Solved" or _is_accurate(solution)
        ):
            return CLARABEL_STATUS_TEXTS.get(status, status)
        return np.array(solution.x)[self._columns]

    def _solution(self, q: Vec, gap: float) -> Any:
        solver = self._solvers.get(gap)
        if solver is None:
            solver = self._solvers[gap] = clarabel.DefaultSolver(
                *self._given, _build_settings(gap)
            )
        solver.update(q=q)
        return solver.solve()


def _is_accurate(solution: Any) -> bool:
    """Return True if the solution is accurate to CONIC_LIMITS.accepted_gap, whatever its status says.

    Clarabel also reports failure when rounding stops it at a point that is accurate already.
    """
    gap = abs(solution.obj_val - solution.obj_val_dual) / (1.0 + abs(solution.obj_val))
    return bool(max(solution.r_prim, solution.r_dual, gap) <= CONIC_LIMITS.accepted_gap)


def _build_settings(gap: float) -> Any:
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    settings.max_iter = CONIC_LIMITS.most_iterations
    settings.max_threads = 1
    settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = gap
    settings.presolve_enable = False  # it would forbid updates
    return settings
