"""Explain why a local problem has no solution.

The explanation names the constraint that excludes all points, or the entry that has no bound.
"""

import warnings
from collections.abc import Sequence
from dataclasses import dataclass

import cvxpy as cp
import numpy as np

from crazychoir.optimization.problems.active_set import ACTIVE_SET_STATUS
from crazychoir.optimization.problems.expressions import (
    EQUALITY_TYPES,
    LINEAR_CONSTRAINT_TYPES,
    NONNEGATIVITY_TYPES,
    decompose_rows,
    is_polyhedral,
)
from crazychoir.optimization.problems.linear import LinearProgram, Mask
from crazychoir.optimization.problems.quadratic import (
    DOUBTFUL_STATUS,
    QUADRATIC_STATUS_TEXTS,
    AffineHull,
    scale_rows,
)
from crazychoir.types import Mat, Vec


@dataclass(frozen=True, slots=True)
class DiagnosisLimits:
    """Limits of the search for the reason why a problem has no solution."""

    largest_entry: float = 1e6
    """An entry that goes beyond this size has no bound."""
    least_violation: float = 1e-7
    """A violation below this is within the tolerance of a solver."""
    most_named_rows: int = 3
    """Largest number of rows that a text names."""


DIAGNOSIS_LIMITS = DiagnosisLimits()


UNSEEN_VIOLATION = "infeasible: by less than the solver sees, at best"
"""Text for a violation that is too small for the solver."""


def explain_no_point(
    status: str, constraints: Sequence[cp.Constraint], x: cp.Variable
) -> str:
    """Explain a status that says that no point was found; return any other status unchanged."""
    if status not in (
        QUADRATIC_STATUS_TEXTS[ACTIVE_SET_STATUS.infeasible],
        DOUBTFUL_STATUS,
    ):
        return status
    why = explain_infeasible(constraints, x)
    return (
        why
        if status == QUADRATIC_STATUS_TEXTS[ACTIVE_SET_STATUS.infeasible]
        else f"{why}: {DOUBTFUL_STATUS}"
    )


def explain_infeasible(constraints: Sequence[cp.Constraint], x: cp.Variable) -> str:
    """Return which rows exclude each other, and their violations where the sum is the least.

    constraints: of x, and perhaps of further variables
    """
    return (
        _ScaledRows.of(constraints, x).conflict()
        if is_polyhedral(constraints, x)
        else _name_violated_rows(constraints)
    )


@dataclass(frozen=True)
class _ScaledRows:
    """The rows of linear constraints of one variable, scaled to length one."""

    A: Mat
    """(m, n) rows of length one."""
    b: Vec
    """(m,) bounds, scaled as the rows."""
    length: Vec
    """(m,) lengths of the rows before scaling."""
    is_equal: Mask
    """(m,) True where a'x = b, False where a'x <= b."""
    places: list[str]
    """m texts such as "constraints[0] (x <= 1.0), row 2"."""

    @classmethod
    def of(cls, constraints: Sequence[cp.Constraint], x: cp.Variable) -> "_ScaledRows":
        """Read the rows from the constraints."""
        parts = [decompose_rows([c], x) for c in constraints]
        A = np.vstack([part for upper, _, equal, _ in parts for part in (upper, equal)])
        b = np.concatenate(
            [part for _, upper, _, equal in parts for part in (upper, equal)]
        )
        is_equal = np.repeat(
            [isinstance(c, EQUALITY_TYPES) for c in constraints],
            [c.size for c in constraints],
        )
        places = [
            f"constraints[{r}] ({c}), row {k}"
            for r, c in enumerate(constraints)
            for k in range(c.size)
        ]
        return cls(*scale_rows(A, b, np.ones(len(b), bool)), is_equal, places)

    def conflict(self) -> str:
        """Return the text that names the rows in conflict.

        The equalities are checked first, because that check is exact for rows of all sizes.
        """
        equal = np.flatnonzero(self.is_equal)
        hull = AffineHull(self.A[equal])
        x0 = hull.point(self.b[equal])
        gaps = hull.gaps(x0, self.b[equal])
        if gaps.any():
            violation = np.zeros(len(self.b))
            violation[equal[hull.others]] = np.abs(gaps)
            is_part = np.zeros(len(self.b), bool)
            is_part[equal[hull.basis]] = (
                np.abs(hull.shares[gaps != 0.0]) > DIAGNOSIS_LIMITS.least_violation
            ).any(axis=0)
            return self._text(violation, is_part)
        near = self._elastic(np.zeros(len(x0)), 1.0)
        if near is not None and not near[1].any():
            # The solver saw no violation. Solve again from the point found, with the violation of
            # that point as the unit, so that the solver can see it.
            beyond = self.A @ near[0] - self.b
            unit = max(beyond.max(), -beyond[self.is_equal].min(initial=0.0))
            near = self._elastic(near[0], unit) if unit > 0.0 else None
        return UNSEEN_VIOLATION if near is None else self._text(*near[1:])

    def _elastic(self, centre: Vec, unit: float) -> tuple[Vec, Vec, Mask] | None:
        """Return the x (n,) with the least sum of violations, the violations, and the active rows.

        The program is solved in the variable (x - centre) / unit. Returns None if even that has no
        solution.
        Returns x (n,), the violation (m,) of each row, and (m,) True for the rows that keep x
        there.
        """
        m = len(self.b)
        n = self.A.shape[1]
        b = np.minimum(
            (self.b - self.A @ centre) / unit, DIAGNOSIS_LIMITS.largest_entry**2
        )
        above = np.hstack([self.A, -np.eye(m), np.zeros((m, m))])
        below = np.hstack([-self.A, np.zeros((m, m)), -np.eye(m)])[self.is_equal]
        bounds = np.r_[np.full(n, -np.inf), np.zeros(2 * m)], np.full(n + 2 * m, np.inf)
        elastic = np.vstack([above, below]), np.concatenate([b, -b[self.is_equal]])
        program = LinearProgram(
            np.r_[np.zeros(n), np.ones(2 * m)], elastic, bounds=bounds
        )
        found = program.solve(np.zeros(n + 2 * m))
        if isinstance(found, str):
            return None
        violation = found[n : n + m] + found[n + m :]
        keeps = np.abs(program.multipliers) > DIAGNOSIS_LIMITS.least_violation
        is_part = keeps[:m].copy()
        is_part[self.is_equal] |= keeps[m:]
        return (
            centre + unit * found[:n],
            np.where(
                violation > DIAGNOSIS_LIMITS.least_violation, violation * unit, 0.0
            ),
            is_part,
        )

    def _text(self, violation: Vec, is_part: Mask) -> str:
        """Name the rows that are violated the most, and the active rows that stand against them."""
        worst = np.argsort(-violation, kind="stable")[
            : DIAGNOSIS_LIMITS.most_named_rows
        ]
        if not violation.any():
            return UNSEEN_VIOLATION
        violated = [int(r) for r in sorted(worst) if violation[r] > 0.0]
        found = [
            f"{self.places[r]}: violated by {violation[r] * self.length[r]:.4g}"
            for r in violated
        ]
        against = [
            self.places[r]
            for r in np.flatnonzero(is_part & (violation == 0.0))[
                : DIAGNOSIS_LIMITS.most_named_rows
            ]
        ]
        text = f"infeasible: {'; '.join(found)}, at best"
        return f"{text}; against {' and '.join(against)}" if against else text


def _name_violated_rows(constraints: Sequence[cp.Constraint]) -> str:
    """Name the violated rows of linear constraints, where the sum of violations is the least."""
    slack = [
        cp.Variable(c.expr.shape, nonneg=True)
        if isinstance(c, LINEAR_CONSTRAINT_TYPES)
        else None
        for c in constraints
    ]
    total = sum(cp.sum(s) for s in slack if s is not None)
    elastic = [
        c if s is None else _relax_constraint(c, s)
        for c, s in zip(constraints, slack, strict=True)
    ]
    if not isinstance(total, cp.Expression) or not _solve_problem(
        cp.Problem(cp.Minimize(total), elastic)
    ):
        return "infeasible: its constraints that are not linear exclude each other"
    found = [
        f"constraints[{r}] ({c}), row {k}: violated by {s.value.flat[k]:.4g}"
        for r, (c, s) in enumerate(zip(constraints, slack, strict=True))
        if s is not None
        for k in np.flatnonzero(np.ravel(s.value) > DIAGNOSIS_LIMITS.least_violation)
    ]
    return (
        f"infeasible: {'; '.join(found[: DIAGNOSIS_LIMITS.most_named_rows])}, at best"
        if found
        else UNSEEN_VIOLATION
    )


def explain_unbounded(
    x: cp.Variable, objective: cp.Expression, constraints: Sequence[cp.Constraint]
) -> str:
    """Name the entry of x that goes farthest when all entries are held within DIAGNOSIS_LIMITS.largest_entry."""
    if not _solve_problem(
        cp.Problem(
            cp.Minimize(objective),
            [
                *constraints,
                x <= DIAGNOSIS_LIMITS.largest_entry,
                x >= -DIAGNOSIS_LIMITS.largest_entry,
            ],
        )
    ):
        return "unbounded"
    value = np.atleast_1d(x.value)
    k = int(np.argmax(np.abs(value)))
    end = "inf" if value[k] > 0 else "-inf"
    return f"unbounded: x[{k}] goes to {end}; bound it by a constraint"


def _relax_constraint(constraint: cp.Constraint, slack: cp.Variable) -> cp.Constraint:
    if isinstance(constraint, EQUALITY_TYPES):
        return cp.abs(constraint.expr) <= slack
    return (
        constraint.expr + slack >= 0
        if isinstance(constraint, NONNEGATIVITY_TYPES)
        else constraint.expr <= slack
    )


def _solve_problem(problem: cp.Problem) -> bool:
    with warnings.catch_warnings():
        # cvxpy warns that the solution may be inaccurate, which is enough for a text.
        warnings.simplefilter("ignore")
        try:
            problem.solve(solver=cp.CLARABEL)
        except cp.SolverError:
            return False
    return problem.status in (cp.OPTIMAL, cp.OPTIMAL_INACCURATE)
