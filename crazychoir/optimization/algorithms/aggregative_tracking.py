"""Aggregative optimisation: each agent's cost depends on its own variable and on a mean over the team."""

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from crazychoir.errors import ConfigError
from crazychoir.optimization.problems.gradient import Checked, Project, anywhere
from crazychoir.optimization.rounds.iteration import vector
from crazychoir.optimization.rounds.messages import parts
from crazychoir.optimization.rounds.mixing import Mixing, Row, Rows, mix
from crazychoir.optimization.rounds.step_size import StepSize, step_size
from crazychoir.types import Vec

Of = Callable[[Vec], ArrayLike]
OfBoth = Callable[[Vec, Vec], ArrayLike]


class AggregativeTracking(Mixing):
    """Projected aggregative tracking: min sum_i f_i(x_i, sigma(x)), sigma(x) = (1/N) sum_i phi_i(x_i), x_i in X_i.

        x~_i = P_i(x_i - a (grad_1 f_i(x_i, s_i) + J_i(x_i)' y_i)),   x_i+ = x_i + delta (x~_i - x_i)
        s_i+ = sum_j w_ij s_j + phi_i(x_i+) - phi_i(x_i)
        y_i+ = sum_j w_ij y_j + grad_2 f_i(x_i+, s_i+) - grad_2 f_i(x_i, s_i)

    s_i tracks sigma, y_i tracks (1/N) sum_j grad_2 f_j;  s_i(0) = phi_i(x_i(0)), y_i(0) = grad_2 f_i(x_i(0), s_i(0)).
    x: (n_i,), of its own size at each agent;  aggregate: phi_i, x_i to (d,);  jacobian: J_i, (d, n_i) of phi_i;
    gradient_own: grad_1 f_i(x, s), (n_i,);  gradient_sigma: grad_2 f_i(x, s), (d,);  project: P_i, onto agent i's set;
    weights: row i, doubly stochastic, or one for each graph of a sequence.
    step: a, constant; f strongly convex, gradients Lipschitz: linear convergence if a and delta are small enough.
    delta: 0 < delta <= 1; smaller is steadier where sets are tight.  sigma: s_i, what the agent takes for sigma(x).
    Costs may change while it runs, as when what they follow moves: both trackers go with them.
    Source: Carnevale, Camisa & Notarstefano 2022, "Distributed online aggregative optimization for dynamic multirobot
    coordination", IEEE Trans. Autom. Control; Li, Yi & Xie 2022, IEEE Trans. Autom. Control 67(6), 3165-3171.
    """

    common = False

    def __init__(
        self,
        i: int,
        x: ArrayLike,
        weights: Rows,
        aggregate: Of,
        jacobian: Of,
        gradient_own: OfBoth,
        gradient_sigma: OfBoth,
        step: float | StepSize,
        project: Project = anywhere,
        delta: float = 1.0,
        rounds: int | None = None,
    ) -> None:
        super().__init__(i, weights, rounds)
        self.x = vector(f"agent {i}: x", x)
        self.aggregate = Checked(i, "aggregate", aggregate)
        self.jacobian = Checked(i, "jacobian", jacobian)
        self.gradient_own = Checked(i, "gradient_own", gradient_own)
        self.gradient_sigma = Checked(i, "gradient_sigma", gradient_sigma)
        self.project, self.step_size, self.delta = (
            Checked(i, "project", project),
            step_size(step),
            delta,
        )
        if not 0.0 < delta <= 1.0:
            raise ConfigError(f"agent {i}: delta", delta, "above 0, at most 1")
        self.phi = self.sigma = vector(f"agent {i}: aggregate", aggregate(self.x))
        self.g = self.y = self._pull(0, self.x, self.sigma)

    def _pull(self, k: int, x: Vec, sigma: Vec) -> Vec:
        """(d,) grad_2 f_i."""
        return self.gradient_sigma(k, x, sigma, shape=sigma.shape)

    def payload(self) -> list[Vec]:
        """[s_i, y_i]: x_i stays with the agent."""
        return [self.sigma, self.y]

    def mix_in(self, row: Row, heard: Mapping[int, Any]) -> None:
        """Move, track sigma, track the gradient with respect to it."""
        k = self.k
        x = self.x
        parts(self.i, k, heard, object, object)
        jacobian = self.jacobian(k, x, shape=(len(self.sigma), len(x)))
        down = self.gradient_own(k, x, self.sigma) + jacobian.T @ self.y
        new = x + self.delta * (self.project(k, x - self.step_size(k) * down) - x)
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
