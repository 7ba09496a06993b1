"""Which solver fits an agent's problem: chosen by its structure, once."""

from collections.abc import Sequence
from typing import Protocol

import cvxpy as cp
import numpy as np

from crazychoir.optimization.conic import ConicProgram
from crazychoir.optimization.expressions import Quadratic
from crazychoir.optimization.linear import LinearProgram
from crazychoir.optimization.quadratic import Polyhedron, QuadraticProgram
from crazychoir.types import Vec

MOST_ENTRIES, MOST_ROWS = 100, 400
"""Of x and of its constraints: above, the matrices of the active-set method are too large to be fast."""


class Program(Protocol):
    """min f(x) + p'x over X, for many p."""

    name: str

    def solve(self, p: Vec) -> Vec | str:
        """A solution x (n,), or why there is none."""
        ...


def fast(form: Quadratic | None, over: Polyhedron | None) -> Program | None:
    """HiGHS for a linear f, closed form or active set for a strictly convex one, over a polyhedron; else None."""
    if form is None or over is None:
        return None
    if not form.P.any():
        return LinearProgram(form.q, (over.A, over.b), (over.E, over.e))
    if len(form.q) > MOST_ENTRIES or len(over.b) > MOST_ROWS:
        return None
    try:
        return QuadraticProgram(form.P, form.q, over)
    except np.linalg.LinAlgError:
        return None  # several minima, which the active-set method cannot tell apart


def compiled(
    form: Quadratic | None,
    over: Polyhedron | None,
    x: cp.Variable,
    objective: cp.Expression,
    constraints: Sequence[cp.Constraint],
    penalty: float,
) -> Program:
    """f(x) + rho/2 |x|^2 over X; f as `objective`, and as `form` if it is quadratic, X as `constraints` and `over`."""
    if form is not None and penalty:
        form = form + Quadratic(penalty * np.eye(len(form.q)), np.zeros_like(form.q), 0.0)
    return fast(form, over) or ConicProgram(x, objective, list(constraints), penalty)
