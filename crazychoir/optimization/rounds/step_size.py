"""Step sizes as functions of the round, checked when they are made."""

import math
from collections.abc import Callable
from dataclasses import dataclass

from crazychoir.errors import ConfigError

StepSize = Callable[[int], float]


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
