"""What the iterative algorithms of this room share: the count of rounds, and what is checked of numbers."""

from abc import abstractmethod
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from crazychoir.errors import ConfigError
from crazychoir.types import Vec


class Iteration:
    """One agent's part of an iterative algorithm: a Round of which a subclass writes `message` and `update`.

    i: the agent;  k: rounds done;  rounds: how many until `done`, None: until something else ends it, as `Until` does.
    """

    def __init__(self, i: int, rounds: int | None = None) -> None:
        if rounds is not None and rounds < 0:
            raise ConfigError(
                f"agent {i}: rounds",
                rounds,
                "0 or more, the same at all agents; None for no end",
            )
        self.i = i
        self.rounds = rounds
        self.k = 0

    @property
    def done(self) -> bool:
        """Whether the last round is over."""
        return self.rounds is not None and self.k >= self.rounds

    @abstractmethod
    def message(self) -> Any:
        """What the neighbours get in this round."""

    @abstractmethod
    def update(self, heard: Mapping[int, Any]) -> None:
        """The equation: round k, with the neighbours' messages."""

    def step(self, heard: Mapping[int, Any]) -> None:
        """Take the neighbours' messages of this round."""
        self.update(heard)
        self.k += 1


def vector(where: str, x: ArrayLike) -> Vec:
    """A copy of x, of float64, a number as (1,); raises ConfigError that names the first entry that is not finite."""
    try:
        values = np.atleast_1d(np.array(x, dtype=float))
    except (TypeError, ValueError) as error:
        raise ConfigError(
            where, type(x).__name__, "numbers, or an array of them"
        ) from error
    return finite(where, values)


def finite(where: str, values: Vec) -> Vec:
    """The values, if they all are finite numbers; raises ConfigError that names the first that is none."""
    if not np.isfinite(values).all():
        place = tuple(int(n) for n in np.argwhere(~np.isfinite(values))[0])
        row = "".join(f"[{n}]" for n in place)
        raise ConfigError(f"{where}{row}", f"{values[place]}", "finite numbers")
    return values


def result(where: str, value: ArrayLike, shape: tuple[int, ...]) -> Vec:
    """What a function of the user's has returned, as finite float64 of this shape; raises ConfigError."""
    values = np.asarray(value, dtype=float)
    if values.shape != shape:
        raise ConfigError(where, f"shape {values.shape}", f"shape {shape}")
    return finite(where, values)
