"""Costs with a smooth part, known by its gradient, and another part, known by its proximal operator."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from crazychoir.errors import ConfigError
from crazychoir.optimization.problems.gradient import (
    CheckedFunction,
    Gradient,
    Project,
)
from crazychoir.optimization.rounds.arrays import is_number
from crazychoir.types import Vec

Proximal = Callable[[Vec, float], ArrayLike]
"""A function of z and a > 0 that returns argmin_x r(x) + |x - z|^2 / (2a), r convex."""


def no_penalty(z: Vec, a: float) -> Vec:
    """Return z: the proximal operator of r = 0."""
    return z


def l1_proximal(weight: float) -> Proximal:
    """Return the proximal operator of r(x) = weight |x|_1: the soft threshold.

        x_n = z_n - min(max(z_n, -a weight), a weight)

    weight: finite, 0 or more
    Raises ConfigError for another weight.
    Source: Parikh & Boyd 2014, Foundations and Trends in Optimization 1(3), section 6.5.2.
    """
    if not is_number(weight) or not 0.0 <= weight < np.inf:
        raise ConfigError("l1_proximal: weight", f"{weight}", "a finite number >= 0")

    def threshold(z: Vec, a: float) -> ArrayLike:
        return z - np.minimum(np.maximum(z, -a * weight), a * weight)

    return threshold


def projection_proximal(project: Project) -> Proximal:
    """Return the proximal operator of a convex set's indicator: the projection onto the set.

    project: projection onto the set, such as `Box(-1, 1).project`
    """

    def nearest(z: Vec, a: float) -> ArrayLike:
        return project(z)

    return nearest


@dataclass(frozen=True)
class CompositeCost:
    """An agent's part of  min sum_i s_i(x) + r_i(x),  s_i and r_i convex, s_i smooth."""

    gradient: Gradient
    """Gradient of s_i."""
    proximal: Proximal = no_penalty
    """Proximal operator of r_i: argmin_x r_i(x) + |x - z|^2 / (2a) as a function of z and a."""

    def checked_gradient(self, i: int) -> CheckedFunction:
        """Return the gradient with a check of its results, for agent i."""
        return CheckedFunction(i, "gradient", self.gradient)

    def checked_proximal(self, i: int, a: float) -> CheckedFunction:
        """Return the proximal operator for the step a, with a check of its results, for agent i."""

        def proximal(z: Vec) -> ArrayLike:
            return self.proximal(z, a)

        return CheckedFunction(i, "proximal", proximal)
