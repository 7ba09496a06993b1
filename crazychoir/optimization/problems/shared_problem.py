"""Random smooth problems that a team shares, with their optimum: least squares and logistic regression."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import Final

import numpy as np

from crazychoir.errors import ConfigError
from crazychoir.optimization.problems.problems import CostCoupled
from crazychoir.types import Mat, Vec

KEPT_PROBLEMS: Final = 64
"""Number of problems that are kept."""


@dataclass(frozen=True, slots=True)
class ProblemShape:
    """Shape of the random problems."""

    entries: int = 10
    """n, entries of x."""
    samples: int = 20
    """m, samples of an agent."""
    ridge: float = 0.05
    """r, weight of |x|^2 / 2: it makes each f_i strongly convex."""
    noise: float = 0.3
    """Standard deviation of the noise of a sample."""
    scales: tuple[float, float] = (0.7, 1.3)
    """Smallest and largest scale of an agent's rows: their L_i differ."""
    spread: float = 0.3
    """Standard deviation of the truth of an agent around the common one, in each entry."""
    newton_steps: int = 50
    """Steps of Newton's method to the optimum; it needs about ten."""


PROBLEM_SHAPE: Final = ProblemShape()


@dataclass(frozen=True)
class Loss:
    """The loss l(t, b) of a sample with the prediction t = a'x and the value b."""

    slope: Callable[[Vec, Vec], Vec]
    """Derivative of l with respect to t."""
    curvature: Callable[[Vec, Vec], Vec]
    """Second derivative of l with respect to t."""
    largest_curvature: float
    """Upper bound on the second derivative."""
    is_label: bool
    """True if b is -1 or 1, else a number."""


def _logistic_slope(t: Vec, b: Vec) -> Vec:
    slope: Vec = -b / (1.0 + np.exp(b * t))
    return slope


def _logistic_curvature(t: Vec, b: Vec) -> Vec:
    share = 1.0 / (1.0 + np.exp(-b * t))
    curvature: Vec = share * (1.0 - share)
    return curvature


SAMPLE_LOSSES: Final = {
    "least-squares": Loss(lambda t, b: t - b, lambda t, b: np.ones_like(t), 1.0, False),
    "logistic": Loss(_logistic_slope, _logistic_curvature, 0.25, True),
}
"""The losses by name: l = (t - b)^2 / 2, and l = log(1 + exp(-b t))."""
PROBLEM_NAMES: Final = tuple(SAMPLE_LOSSES)
"""Names of the problems."""


class SharedProblem:
    """min sum_i f_i(x),  f_i(x) = 1/m sum_s l(a_is'x, b_is) + r/2 |x|^2, with its optimum.

    Each agent draws its samples around a truth of its own, near a common one, so that no agent alone
    finds the optimum.

    name: name of the loss, see PROBLEM_NAMES
    agents: N, number of agents
    seed: seed of the samples
    Raises ConfigError for an unknown name.

    Attributes:
    rows: (N, m, n) the a_is
    values: (N, m) the b_is
    smoothness: (N,) L_i, Lipschitz constants of the gradients
    modulus: largest m with all f_i m-strongly convex
    optimum: (n,)
    All arrays are read-only: the problem is shared, see `make_problem`.
    """

    def __init__(self, name: str, agents: int, seed: int) -> None:
        if name not in SAMPLE_LOSSES:
            raise ConfigError("problem", name, ", ".join(PROBLEM_NAMES))
        self.name = name
        self._loss = SAMPLE_LOSSES[name]
        shape = PROBLEM_SHAPE
        chance = np.random.default_rng([seed, agents])
        scales = chance.uniform(*shape.scales, (agents, 1, 1))
        drawn = chance.normal(size=(agents, shape.samples, shape.entries))
        self.rows = scales * drawn
        common = chance.normal(size=shape.entries)
        truths = common + shape.spread * chance.normal(size=(agents, shape.entries))
        exact = np.einsum("imn,in->im", self.rows, truths)
        self.values = exact + shape.noise * chance.normal(size=exact.shape)
        if self._loss.is_label:
            self.values = np.where(self.values > 0.0, 1.0, -1.0)
        squares = np.linalg.svd(self.rows, compute_uv=False) ** 2 / shape.samples
        bound = self._loss.largest_curvature
        self.smoothness: Vec = bound * squares[:, 0] + shape.ridge
        least = squares[:, -1].min() if bound == 1.0 else 0.0
        self.modulus = float(least) + shape.ridge
        self.optimum = self._find_optimum()
        for kept in (self.rows, self.values, self.smoothness, self.optimum):
            kept.setflags(write=False)
        self._locals: dict[int, CostCoupled] = {}

    def gradient(self, i: int, x: Vec) -> Vec:
        """Return grad f_i(x), (n,)."""
        rows = self.rows[i]
        slopes = self._loss.slope(rows @ x, self.values[i])
        found: Vec = rows.T @ slopes / len(rows) + PROBLEM_SHAPE.ridge * x
        return found

    def sample_gradient(self, i: int, x: Vec, s: int) -> Vec:
        """Return the gradient at x of l(a_is'x, b_is) + r/2 |x|^2, (n,)."""
        row = self.rows[i, s]
        found: Vec = row * self._loss.slope(row @ x, self.values[i, s])
        return found + PROBLEM_SHAPE.ridge * x

    def local(self, i: int) -> CostCoupled:
        """Return f_i as a problem in cvxpy, which is made once."""
        if i not in self._locals:
            self._locals[i] = self._make_local(i)
        return self._locals[i]

    def _make_local(self, i: int) -> CostCoupled:
        import cvxpy as cp

        x = cp.Variable(PROBLEM_SHAPE.entries)
        predictions = self.rows[i] @ x
        values = self.values[i]
        if self._loss.is_label:
            losses = cp.sum(cp.logistic(-cp.multiply(values, predictions)))
        else:
            losses = 0.5 * cp.sum_squares(predictions - values)
        ridge = 0.5 * PROBLEM_SHAPE.ridge * cp.sum_squares(x)
        return CostCoupled(i, x, losses / len(values) + ridge)

    def _find_optimum(self) -> Vec:
        """Return the optimum, by Newton's method on the sum of all f_i."""
        n = PROBLEM_SHAPE.entries
        rows = self.rows.reshape(-1, n)
        values = self.values.reshape(-1)
        x = np.zeros(n)
        for _ in range(PROBLEM_SHAPE.newton_steps):
            predictions = rows @ x
            slopes = self._loss.slope(predictions, values)
            curvatures = self._loss.curvature(predictions, values)
            gradient = rows.T @ slopes / len(rows) + PROBLEM_SHAPE.ridge * x
            hessian = (rows.T * curvatures) @ rows / len(rows)
            hessian += PROBLEM_SHAPE.ridge * np.eye(n)
            x = x - np.linalg.solve(hessian, gradient)
        return x


@lru_cache(maxsize=KEPT_PROBLEMS)
def make_problem(name: str, agents: int, seed: int) -> SharedProblem:
    """Return a problem; the newest problems are kept, because all algorithms solve them."""
    return SharedProblem(name, agents, seed)


def relative_error(x: Mat, optimum: Vec) -> Vec:
    """Return the error of a team, relative to its error at x = 0.

        e = sqrt(sum_i |x_i - x*|^2 / N) / |x*|

    x: (N, K, n) iterates of the agents
    optimum: (n,) x*
    Returns (K,).
    """
    squares = ((x - optimum) ** 2).sum(axis=2).mean(axis=0)
    error: Vec = np.sqrt(squares) / np.linalg.norm(optimum)
    return error
