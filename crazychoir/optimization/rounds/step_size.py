"""Step sizes as functions of the round, checked when they are made."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np

from crazychoir.errors import ConfigError
from crazychoir.types import Vec

StepSize = Callable[[int], float]
GROWTH_LIMIT: Final = 1e12
"""Iterates may become this many times as large as the first ones that are not 0."""
LARGE_ITERATE: Final = 1e9
"""Iterates below this have not grown too much, however small the first ones were."""
LARGEST_ITERATE: Final = 1e100
"""Iterates above this overflow soon."""
GROWING_LOOKS: Final = 8
"""Looks in a row at which the iterates must have doubled since the look before."""
ROUNDS_PER_LOOK: Final = 8
"""Rounds from one look at the size of the iterates to the next."""


@dataclass(frozen=True)
class Constant:
    """The constant step a_k = a."""

    a: float
    """Step, above 0."""

    def __post_init__(self) -> None:
        _require_positive("a", self.a)

    def __call__(self, k: int) -> float:
        """Return the step of round k."""
        return self.a


@dataclass(frozen=True)
class Diminishing:
    """The diminishing step a_k = a / (k + 1)^p.

    With 1/2 < p <= 1, sum a_k is infinite and sum a_k^2 is finite.
    """

    a: float
    """First step, above 0."""
    p: float = 1.0
    """Exponent, above 0 and at most 1, so that the sum of the steps is infinite."""

    def __post_init__(self) -> None:
        _require_positive("a", self.a)
        if not 0.0 < self.p <= 1.0:
            raise ConfigError(
                "step size: p",
                self.p,
                "above 0, at most 1",
                "Beyond 1 the steps do not reach anywhere.",
            )

    def __call__(self, k: int) -> float:
        """Return the step of round k."""
        return float(self.a / (k + 1) ** self.p)


def step_size(given: float | StepSize) -> StepSize:
    """Return a step size as a function of the round.

    given: a number, which becomes Constant, or a function. A function is checked in its first three
        rounds.
    """
    if not callable(given):
        return Constant(given)
    for k in range(3):
        _require_positive(f"round {k}", given(k))
    return given


def _require_positive(what: str, a: float) -> None:
    if not (math.isfinite(a) and a > 0.0):
        raise ConfigError(f"step size: {what}", a, "a finite number above 0")


class GrowthWatch:
    """Ends an algorithm with iterates that grow without end, because its step is too large.

    A step a_k that is too large multiplies the iterates in each round, for ever. They have grown too
    much when they are GROWTH_LIMIT times as large as the first ones that are not 0, and above
    LARGE_ITERATE, and have doubled from look to look GROWING_LOOKS times; or when they are near the
    largest numbers there are. So iterates may start from next to nothing, as those of an agent far from
    all data, and may settle at a far optimum.

    where: the agent, the start of an error text
    step: a_k
    bound: what is known of the steps with which the algorithm converges
    """

    def __init__(self, where: str, step: StepSize, bound: str) -> None:
        self._where = where
        self._step = step
        self._bound = bound
        self._first = 0.0
        self._last = 0.0
        self._growing = 0

    def __call__(self, k: int, x: Vec) -> None:
        """Raise ConfigError that names the step, if x has grown too much; x may have any shape.

        x is looked at in every eighth round, because a look costs as much as a round.
        """
        if k % ROUNDS_PER_LOOK:
            return
        size = float(np.abs(x).max(initial=0.0))
        self._first = self._first or size
        self._growing = self._growing + 1 if size >= 2.0 * self._last else 0
        self._last = size
        has_grown = (
            self._growing >= GROWING_LOOKS
            and size > GROWTH_LIMIT * self._first
            and size > LARGE_ITERATE
        )
        if has_grown or not size < LARGEST_ITERATE:
            raise ConfigError(
                f"{self._where}: step {self._step(k):g}, round {k}",
                f"iterates that have grown from {self._first:.3g} to {size:.3g}",
                self._bound,
                "Take a smaller step.",
            )
