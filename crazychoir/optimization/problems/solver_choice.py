"""Choose the solver of an agent's problem once, by the structure of the problem."""

from collections.abc import Callable, Sequence
from functools import cached_property
from typing import Protocol

import cvxpy as cp
import numpy as np

from crazychoir.optimization.problems.conic import ConicProgram
from crazychoir.optimization.problems.expressions import Quadratic
from crazychoir.optimization.problems.linear import LinearProgram
from crazychoir.optimization.problems.quadratic import (
    DOUBTFUL_STATUS,
    UNDECIDED_STATUSES,
    Polyhedron,
    QuadraticProgram,
)
from crazychoir.types import Vec

MOST_FAST_ENTRIES = 100
"""Entries of x above which the matrices of the active-set method are too large to be fast."""
MOST_FAST_ROWS = 400
"""Rows of constraints above which the matrices of the active-set method are too large."""


class CompiledProgram(Protocol):
    """A compiled problem: min f(x) + p'x over X, for many p."""

    name: str
    """Name of the solver, such as "HiGHS"."""

    def solve(self, p: Vec) -> Vec | str:
        """Return a solution x (n,), or the reason why there is none."""
        ...


class DecidedProgram:
    """A fast program with a thorough program as a fallback.

    The thorough program is compiled when it is first needed: when rounding keeps the fast program
    from a decision.
    """

    def __init__(
        self, fast: CompiledProgram, make: Callable[[], CompiledProgram]
    ) -> None:
        self.name = fast.name
        self._fast = fast
        self._make = make

    @cached_property
    def _thorough(self) -> CompiledProgram:
        return self._make()

    def solve(self, p: Vec) -> Vec | str:
        """Return a solution x (n,), or the reason why there is none."""
        found = self._fast.solve(p)
        if not (isinstance(found, str) and found in UNDECIDED_STATUSES):
            return found
        thorough = self._thorough.solve(p)
        # If both find no point and rows are nearly dependent, neither has proved that none exists.
        return (
            found
            if found == DOUBTFUL_STATUS and isinstance(thorough, str)
            else thorough
        )


def choose_fast_program(
    form: Quadratic | None, over: Polyhedron | None
) -> CompiledProgram | None:
    """Return the fastest program for f over a polyhedron, or None if there is no fast program.

    A linear f is solved by HiGHS. A strictly convex quadratic f is solved in closed form or by the
    active-set method.
    """
    if form is None or over is None:
        return None
    if not form.P.any():
        return LinearProgram(form.q, (over.A, over.b), (over.E, over.e))
    if len(form.q) > MOST_FAST_ENTRIES or len(over.b) > MOST_FAST_ROWS:
        return None
    try:
        return QuadraticProgram(form.P, form.q, over)
    except np.linalg.LinAlgError:
        return None  # several minima, which the active-set method cannot tell apart


def compile_problem(
    form: Quadratic | None,
    over: Polyhedron | None,
    x: cp.Variable,
    objective: cp.Expression,
    constraints: Sequence[cp.Constraint],
    penalty: float,
) -> CompiledProgram:
    """Return the compiled problem  min f(x) + rho/2 |x|^2 over X.

    form: f if it is quadratic, else None
    over: X if it is a polyhedron, else None
    x: the cvxpy variable
    objective: f
    constraints: X
    penalty: rho
    """
    if form is not None and penalty:
        form = form + Quadratic(
            penalty * np.eye(len(form.q)), np.zeros_like(form.q), 0.0
        )

    def conic() -> ConicProgram:
        return ConicProgram(x, objective, list(constraints), penalty)

    found = choose_fast_program(form, over)
    return conic() if found is None else DecidedProgram(found, conic)
