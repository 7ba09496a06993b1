"""Twice differentiable functions, given as two callables, and one descent step on them."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from crazychoir.errors import ConfigError, SolverError
from crazychoir.types import Mat, Vec


@dataclass(frozen=True, slots=True)
class NewtonStep:
    """A step of Newton's method with a line search by Armijo's rule."""

    difference: float = 1e-6
    """Step of the differences of gradients, relative to 1 + |x_k|."""
    least_curvature: float = 1e-8
    """Smallest curvature that is used, relative to the largest."""
    most_halvings: int = 40
    """Halvings of the step length before the line search ends."""
    armijo_share: float = 1e-4
    """Part of the predicted decrease that Armijo's rule demands."""
    rounding: float = 1e-14
    """Relative change of a value that counts as rounding: the line search accepts such a step.
    """


NEWTON_STEP = NewtonStep()


@dataclass(frozen=True)
class SmoothFunction:
    """A function of x (n,), given by its value and its derivative.

    For a problem modelled with cvxpy, write SmoothFunction(problem.value, problem.gradient).
    """

    value: Callable[[Vec], Any]
    """Returns the value at x: a number or (S,)."""
    derivative: Callable[[Vec], Any]
    """Returns the derivative at x: (n,) or (S, n)."""

    def at(self, x: Vec, where: str) -> tuple[Vec, Mat]:
        """Return the value (S,) and the derivative (S, n) at x.

        Raises ConfigError for wrong shapes and SolverError for numbers that are not finite. The
        errors name the entry and the row.
        """
        value = np.atleast_1d(np.asarray(self.value(x), float))
        derivative = np.atleast_2d(np.asarray(self.derivative(x), float))
        if value.ndim != 1 or derivative.shape != (len(value), len(x)):
            found = f"shapes {value.shape} and {derivative.shape}"
            raise ConfigError(
                f"{where}: value and derivative", found, f"(S,) and (S, {len(x)})"
            )
        for name, array in (("value", value), ("derivative", derivative)):
            if not np.isfinite(array).all():
                row = int(np.argwhere(~np.isfinite(array))[0][0])
                raise SolverError(
                    f"{where}: {name}, row {row}, at x = {x.tolist()}", "not finite"
                )
        return value, derivative


@dataclass(frozen=True)
class SmoothProblem:
    """An agent's part of  min sum_i f_i(x)  s.t.  h_i(x) = 0, g_i(x) <= 0 for all i."""

    objective: SmoothFunction
    """f_i."""
    equalities: SmoothFunction | None = None
    """h_i, or None."""
    inequalities: SmoothFunction | None = None
    """g_i, or None."""


def descend_once(
    value: Callable[[Vec], float], gradient: Callable[[Vec], Vec], x: Vec
) -> Vec:
    """Return x after one step of Newton's method that descends whatever the curvature is.

        x - t |H|^-1 g

    |H|: the Hessian, by differences of gradients, with the absolute values of its eigenvalues
    t: step length: 1, halved until the value falls by Armijo's rule
    Returns x itself if no such t is found, as at a minimum.
    Source: Nocedal & Wright 2006, Numerical Optimization, sections 3.1 and 3.4.
    """
    g = gradient(x)
    now = value(x)
    direction = -_solve_positive(_estimate_hessian(gradient, x, g), g)
    slope = float(g @ direction)
    t = 1.0
    for _ in range(NEWTON_STEP.most_halvings):
        if value(
            x + t * direction
        ) <= now + NEWTON_STEP.armijo_share * t * slope + NEWTON_STEP.rounding * (
            1.0 + abs(now)
        ):
            return x + t * direction
        t /= 2.0
    return x


def _estimate_hessian(gradient: Callable[[Vec], Vec], x: Vec, g: Vec) -> Mat:
    steps = NEWTON_STEP.difference * (1.0 + np.abs(x))
    H = np.array(
        [
            (gradient(x + h * e) - g) / h
            for h, e in zip(steps, np.eye(len(x)), strict=True)
        ]
    )
    symmetric: Mat = (H + H.T) / 2.0
    return symmetric


def _solve_positive(H: Mat, g: Vec) -> Vec:
    values, vectors = np.linalg.eigh(H)
    size = np.abs(values)
    size = np.maximum(
        size, max(NEWTON_STEP.least_curvature * float(size.max()), np.finfo(float).tiny)
    )
    solved: Vec = vectors @ ((vectors.T @ g) / size)
    return solved
