"""The parts that iterative algorithms share: the count of rounds, and checks of numbers."""

from abc import abstractmethod
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from crazychoir.errors import ConfigError
from crazychoir.types import Vec


class Iteration:
    """One agent's part of an iterative algorithm: a Round.

    A subclass writes `message` and `update`.

    i: id of the agent
    k: rounds done
    rounds: number of rounds until `done`. None means that something else ends the algorithm, such
        as `Until`
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
        """True when the last round is over."""
        return self.rounds is not None and self.k >= self.rounds

    @abstractmethod
    def message(self) -> Any:
        """Return the message to the neighbours in this round."""

    @abstractmethod
    def update(self, heard: Mapping[int, Any]) -> None:
        """Compute the equation of round k with the messages of the neighbours."""

    def step(self, heard: Mapping[int, Any]) -> None:
        """Take the messages of the neighbours in this round."""
        self.update(heard)
        self.k += 1


def copy_state(where: str, x: ArrayLike) -> Vec:
    """Return a copy of x as float64; a number becomes an array of shape (1,).

    Raises ConfigError that names the first entry that is not finite.
    """
    try:
        values = np.atleast_1d(np.array(x, dtype=float))
    except (TypeError, ValueError) as error:
        raise ConfigError(
            where, type(x).__name__, "numbers, or an array of them"
        ) from error
    return require_finite_state(where, values)


def require_finite_state(where: str, values: Vec) -> Vec:
    """Return the values; raise ConfigError that names the first value that is not finite."""
    if not np.isfinite(values).all():
        place = tuple(int(n) for n in np.argwhere(~np.isfinite(values))[0])
        row = "".join(f"[{n}]" for n in place)
        raise ConfigError(f"{where}{row}", f"{values[place]}", "finite numbers")
    return values


def require_result(where: str, value: ArrayLike, shape: tuple[int, ...]) -> Vec:
    """Return the result of a user's function as finite float64 of this shape.

    Raises ConfigError if the shape is wrong or a value is not finite.
    """
    values = np.asarray(value, dtype=float)
    if values.shape != shape:
        raise ConfigError(where, f"shape {values.shape}", f"shape {shape}")
    return require_finite_state(where, values)
