"""Gradients and projections as a user gives them: functions of numpy arrays, whose results are checked."""

import random
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from crazychoir.errors import ConfigError
from crazychoir.optimization.rounds.iteration import result
from crazychoir.types import Vec

Gradient = Callable[[Vec], ArrayLike]
Project = Callable[[Vec], ArrayLike]


class Checked:
    """A user's function of x at agent i, whose values are finite and have the shape of x, or of `shape`.

    Raises ConfigError that names agent, function, round and row: `agent 3: gradient, round 7[1]: found nan`.
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

    def __call__(self, k: int, *x: Vec, shape: tuple[int, ...] | None = None) -> Vec:
        """Its value at x, in round k."""
        wanted = x[0].shape if shape is None else shape
        return result(
            f"agent {self.i}: {self.name}, round {k}", self.function(*x), wanted
        )


def anywhere(x: Vec) -> Vec:
    """The projection onto the whole space."""
    return x


class Samples:
    """A stochastic gradient: the mean over a random mini-batch of samples, drawn anew in each call.

        g(x) = 1/|B| sum_{s in B} grad l(x, s),   B of `batch` samples, drawn without replacement

    The expectation of g is the gradient of the mean loss of all samples.
    gradient: of the loss of one sample, grad l(x, s);  samples: a sequence of them;  seed: the draws are those of
    (seed, agent), so that each agent has its own and a run repeats.
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
        """The mean gradient of a new mini-batch."""
        drawn = self._chance.sample(range(len(self.samples)), self.batch)
        mean: Vec = np.mean(
            [np.asarray(self.gradient(x, self.samples[s]), dtype=float) for s in drawn],
            axis=0,
        )
        return mean
