"""Why a local problem has no solution: which constraint stands in the way, or which entry has no bound."""

import warnings
from collections.abc import Sequence

import cvxpy as cp
import numpy as np

from crazychoir.optimization.expressions import EQUAL, LINEAR, NONNEGATIVE

FAR = 1e6
"""Where an entry that goes beyond it has no bound."""
SEEN = 1e-7
"""A violation below this is a solver's tolerance."""


def infeasible(constraints: Sequence[cp.Constraint]) -> str:
    """The rows whose violation must add up to the least that is possible, and by how much."""
    slack = [cp.Variable(c.expr.shape, nonneg=True) if isinstance(c, LINEAR) else None for c in constraints]
    total = sum(cp.sum(s) for s in slack if s is not None)
    elastic = [c if s is None else _relaxed(c, s) for c, s in zip(constraints, slack, strict=True)]
    if not isinstance(total, cp.Expression) or not _solved(cp.Problem(cp.Minimize(total), elastic)):
        return "infeasible: its constraints that are not linear exclude each other"
    found = [
        f"constraints[{r}] ({c}), row {k}: violated by {s.value.flat[k]:.4g}"
        for r, (c, s) in enumerate(zip(constraints, slack, strict=True))
        if s is not None
        for k in np.flatnonzero(np.ravel(s.value) > SEEN)
    ]
    return f"infeasible: {'; '.join(found[:3]) or 'by less than the solver sees'}, at best"


def unbounded(x: cp.Variable, objective: cp.Expression, constraints: Sequence[cp.Constraint]) -> str:
    """The entry of x that goes farthest when all are held within FAR."""
    if not _solved(cp.Problem(cp.Minimize(objective), [*constraints, x <= FAR, x >= -FAR])):
        return "unbounded"
    value = np.atleast_1d(x.value)
    k = int(np.argmax(np.abs(value)))
    end = "inf" if value[k] > 0 else "-inf"
    return f"unbounded: x[{k}] goes to {end}; bound it by a constraint"


def _relaxed(constraint: cp.Constraint, slack: cp.Variable) -> cp.Constraint:
    if isinstance(constraint, EQUAL):
        return cp.abs(constraint.expr) <= slack
    return constraint.expr + slack >= 0 if isinstance(constraint, NONNEGATIVE) else constraint.expr <= slack


def _solved(problem: cp.Problem) -> bool:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # that it may be inaccurate: so may be what it is asked for
        try:
            problem.solve(solver=cp.CLARABEL)
        except cp.SolverError:
            return False
    return problem.status in (cp.OPTIMAL, cp.OPTIMAL_INACCURATE)
