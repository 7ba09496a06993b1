"""Which solver fits an agent's problem: chosen by its structure, once."""

from collections.abc import Callable, Sequence
from functools import cached_property
from typing import Protocol

import cvxpy as cp
import numpy as np

from crazychoir.optimization.problems.conic import ConicProgram
from crazychoir.optimization.problems.expressions import Quadratic
from crazychoir.optimization.problems.linear import LinearProgram
from crazychoir.optimization.problems.quadratic import (
    DOUBTFUL,
    UNDECIDED,
    Polyhedron,
    QuadraticProgram,
)
from crazychoir.types import Vec

MOST_ENTRIES, MOST_ROWS = 100, 400
"""Of x and of its constraints: above, the matrices of the active-set method are too large to be fast."""


class Program(Protocol):
    """min f(x) + p'x over X, for many p."""

    name: str

    def solve(self, p: Vec) -> Vec | str:
        """A solution x (n,), or why there is none."""
        ...


class Decided:
    """A fast program, and a thorough one, made when it is first needed, for what rounding hides from the fast one."""

    def __init__(self, fast: Program, make: Callable[[], Program]) -> None:
        self.name = fast.name
        self._fast = fast
        self._make = make

    @cached_property
    def _thorough(self) -> Program:
        return self._make()

    def solve(self, p: Vec) -> Vec | str:
        """A solution x (n,), or why there is none."""
        found = self._fast.solve(p)
        if not (isinstance(found, str) and found in UNDECIDED):
            return found
        thorough = self._thorough.solve(p)
        # Both fail to find a point: but where rows are nearly dependent, neither has a proof that there is none.
        return found if found == DOUBTFUL and isinstance(thorough, str) else thorough


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
        form = form + Quadratic(
            penalty * np.eye(len(form.q)), np.zeros_like(form.q), 0.0
        )

    def conic() -> ConicProgram:
        return ConicProgram(x, objective, list(constraints), penalty)

    found = fast(form, over)
    return conic() if found is None else Decided(found, conic)
