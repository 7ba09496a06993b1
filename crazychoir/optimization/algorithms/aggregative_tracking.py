"""Aggregative optimisation: each cost depends on the agent's own variable and on a team mean."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from crazychoir.errors import ConfigError
from crazychoir.optimization.problems.gradient import (
    CheckedFunction,
    Project,
    keep_point,
)
from crazychoir.optimization.rounds.iteration import copy_state
from crazychoir.optimization.rounds.messages import check_parts
from crazychoir.optimization.rounds.mixing import Mixing, Row, Rows, mix
from crazychoir.optimization.rounds.step_size import (
    GrowthWatch,
    StepSize,
    step_size,
)
from crazychoir.types import Vec

Of = Callable[[Vec], ArrayLike]
OfBoth = Callable[[Vec, Vec], ArrayLike]


@dataclass(frozen=True)
class AggregativeProblem:
    """An agent's part of  min sum_i f_i(x_i, sigma(x)),  x_i in X_i."""

    aggregate: Of
    """phi_i, maps x_i to (d,)."""
    jacobian: Of
    """J_i, (d, n_i) of phi_i."""
    gradient_own: OfBoth
    """grad_1 f_i(x, s), (n_i,)."""
    gradient_sigma: OfBoth
    """grad_2 f_i(x, s), (d,)."""
    project: Project = keep_point
    """P_i, the projection onto X_i."""


SMALL_ENOUGH_STEP = (
    "well below 1 / L, with L-smooth f_i; the smaller, the slower the graph mixes"
)
"""Steps with which aggregative tracking converges, for error texts."""


class AggregativeTracking(Mixing):
    """Projected aggregative tracking for  min sum_i f_i(x_i, sigma(x)),  x_i in X_i.

        sigma(x) = (1/N) sum_i phi_i(x_i)

        x~_i = P_i(x_i - a (grad_1 f_i(x_i, s_i) + J_i(x_i)' y_i))
        x_i+ = x_i + delta (x~_i - x_i)
        s_i+ = sum_j w_ij s_j + phi_i(x_i+) - phi_i(x_i)
        y_i+ = sum_j w_ij y_j + grad_2 f_i(x_i+, s_i+) - grad_2 f_i(x_i, s_i)
        s_i(0) = phi_i(x_i(0)),   y_i(0) = grad_2 f_i(x_i(0), s_i(0))

    s_i tracks sigma, and y_i tracks (1/N) sum_j grad_2 f_j.
    With f strongly convex and Lipschitz gradients, convergence is linear if a and delta are small
    enough. The costs may change while the method runs, for example when a target moves. Both
    trackers follow.

    i: id of the agent
    x: (n_i,) start; agents may have different sizes
    weights: row i, doubly stochastic, or one row for each graph of a sequence
    problem: phi_i, the gradients of f_i, and X_i
    step: a, constant
    delta: 0 < delta <= 1; smaller is steadier where sets are tight
    rounds: number of rounds until done; None for no end
    sigma: s_i (d,), the agent's estimate of sigma(x)
    Source: Carnevale, Camisa & Notarstefano 2022, "Distributed online aggregative optimization for
    dynamic multirobot coordination", IEEE Trans. Autom. Control; Li, Yi & Xie 2022, IEEE Trans.
    Autom. Control 67(6), 3165-3171.
    """

    common = False

    def __init__(
        self,
        i: int,
        x: ArrayLike,
        weights: Rows,
        problem: AggregativeProblem,
        step: float | StepSize,
        delta: float = 1.0,
        rounds: int | None = None,
    ) -> None:
        super().__init__(i, weights, rounds)
        self.x = copy_state(f"agent {i}: x", x)
        self.aggregate = CheckedFunction(i, "aggregate", problem.aggregate)
        self.jacobian = CheckedFunction(i, "jacobian", problem.jacobian)
        self.gradient_own = CheckedFunction(i, "gradient_own", problem.gradient_own)
        self.gradient_sigma = CheckedFunction(
            i, "gradient_sigma", problem.gradient_sigma
        )
        self.project = CheckedFunction(i, "project", problem.project)
        self.step_size = step_size(step)
        self._watch = GrowthWatch(f"agent {i}", self.step_size, SMALL_ENOUGH_STEP)
        self.delta = delta
        if not 0.0 < delta <= 1.0:
            raise ConfigError(f"agent {i}: delta", delta, "above 0, at most 1")
        self.phi = self.sigma = copy_state(
            f"agent {i}: aggregate", problem.aggregate(self.x)
        )
        self.g = self.y = self._pull(0, self.x, self.sigma)

    def _pull(self, k: int, x: Vec, sigma: Vec) -> Vec:
        """Return grad_2 f_i (d,)."""
        return self.gradient_sigma(k, x, sigma, shape=sigma.shape)

    def payload(self) -> list[Vec]:
        """Return [s_i, y_i]. x_i stays with the agent."""
        return [self.sigma, self.y]

    def mix_in(self, row: Row, heard: Mapping[int, Any]) -> None:
        """Move x, track sigma, and track the gradient with respect to sigma."""
        k = self.k
        x = self.x
        check_parts(self.i, k, heard, object, object)
        jacobian = self.jacobian(k, x, shape=(len(self.sigma), len(x)))
        down = self.gradient_own(k, x, self.sigma) + jacobian.T @ self.y
        new = x + self.delta * (self.project(k, x - self.step_size(k) * down) - x)
        self._watch(k, new)
        phi = self.aggregate(k, new, shape=self.phi.shape)
        sigma = (
            mix(self.i, row, self.sigma, {j: s for j, (s, _) in heard.items()})
            + phi
            - self.phi
        )
        g = self._pull(k, new, sigma)
        self.y = (
            mix(self.i, row, self.y, {j: y for j, (_, y) in heard.items()}) + g - self.g
        )
        self.x = np.array(new)
        self.phi = phi
        self.sigma = sigma
        self.g = g
