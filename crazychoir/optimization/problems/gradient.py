"""Check the gradients and projections of the user, which are functions of numpy arrays."""

import random
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from crazychoir.errors import ConfigError
from crazychoir.optimization.rounds.iteration import require_result
from crazychoir.types import Vec

Gradient = Callable[[Vec], ArrayLike]
Project = Callable[[Vec], ArrayLike]
LARGE_ARGUMENT = 1e6
"""At an x as large as this, an error text says how large x is: the step may be too large."""


class CheckedFunction:
    """A function of x that the user wrote for agent i, with a check of its results.

    The result must be finite and have the shape of x, or the shape `shape` of the call.
    Raises ConfigError that names agent, function, round and row:
    `agent 3: gradient, round 7[1]: found nan`.

    i: id of the agent
    name: name of the function in error texts
    function: the function itself
    """

    def __init__(self, i: int, name: str, function: Callable[..., ArrayLike]) -> None:
        if not callable(function):
            do = "Give its method `project`." if hasattr(function, "project") else ""
            raise ConfigError(
                f"agent {i}: {name}",
                type(function).__name__,
                "a function of numpy arrays",
                do,
            )
        self.i = i
        self.name = name
        self.function = function

    def __call__(self, k: int, *x: Any, shape: tuple[int, ...] | None = None) -> Vec:
        """Return the value at x in round k.

        x: arguments of the function, the first one an array
        shape: shape of the value; None for the shape of the first argument
        """
        wanted = x[0].shape if shape is None else shape
        where = f"agent {self.i}: {self.name}, round {k}"
        try:
            return require_result(where, self.function(*x), wanted)
        except ConfigError as error:
            size = float(np.abs(x[0]).max(initial=0.0))
            if size < LARGE_ARGUMENT:
                raise
            found = f"{error.found} at an x that has grown to {size:.3g}"
            do = "Take a smaller step, or a smaller start."
            raise ConfigError(error.where, found, error.allowed, do) from None


def keep_point(x: Vec) -> Vec:
    """Return x: the projection onto the whole space."""
    return x


@dataclass(frozen=True)
class ProjectedCost:
    """An agent's part of  min sum_i f_i(x), x in X."""

    gradient: Gradient
    """g_i of the whole x, a sub-gradient of f_i or a stochastic one, see `Samples`."""
    project: Project = keep_point
    """P_X, the projection onto X, the same set at all agents."""


class Samples:
    """A stochastic gradient: the mean over a random mini-batch, drawn anew in each call.

        g(x) = 1/|B| sum_{s in B} grad l(x, s),   B of `batch` samples, drawn without replacement

    The expectation of g is the gradient of the mean loss of all samples.

    i: id of the agent
    gradient: gradient of the loss of one sample, grad l(x, s)
    samples: sequence of all samples of this agent
    batch: number of samples in a mini-batch
    seed: seed of the draws; they depend on (seed, agent), so that each agent has its own and a
        run can be repeated
    """

    def __init__(
        self,
        i: int,
        gradient: Callable[[Vec, Any], ArrayLike],
        samples: Sequence[Any],
        batch: int = 1,
        seed: int = 0,
    ) -> None:
        if not 1 <= batch <= len(samples):
            raise ConfigError(
                f"agent {i}: batch",
                batch,
                f"1 to {len(samples)}, the number of its samples",
            )
        self.gradient = gradient
        self.samples = samples
        self.batch = batch
        self._chance = random.Random(f"{seed} {i}")  # noqa: S311 - which samples, not secrets

    def __call__(self, x: Vec) -> Vec:
        """Return the mean gradient of a new mini-batch."""
        mean: Vec = np.mean([self.one(x, s) for s in self.draw()], axis=0)
        return mean

    def draw(self) -> list[int]:
        """Return the indices of the samples of a new mini-batch."""
        return self._chance.sample(range(len(self.samples)), self.batch)

    def one(self, x: Vec, s: int) -> Vec:
        """Return the gradient at x of the loss of the sample with index s."""
        return np.asarray(self.gradient(x, self.samples[s]), dtype=float)
