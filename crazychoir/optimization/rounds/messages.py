"""Checks of a message before an algorithm calculates with it."""

from collections.abc import Mapping
from typing import Any, Final, TypeVar, cast

import numpy as np
import numpy.typing as npt

from crazychoir.errors import ConfigError

A = TypeVar("A", bound=npt.NDArray[Any])
INTEGER_TYPES: Final = (int, np.integer)
"""Types of an integer."""
REAL_NUMBER_TYPES: Final = (float, *INTEGER_TYPES)
"""Types of a real number."""
MOST_SHOWN_PARTS: Final = 8
"""Largest number of parts of a malformed message that an error names."""


def check_array(i: int, j: int, x: Any, own: A) -> A:
    """Return the array x that agent j sent to agent i.

    Raises ConfigError unless it has the shape of agent i's own array.
    """
    if type(x) is not np.ndarray or x.shape != own.shape:
        found = f"shape {x.shape}" if isinstance(x, np.ndarray) else type(x).__name__
        raise ConfigError(
            f"agent {i}: message of agent {j}", found, f"shape {own.shape}, as its own"
        )
    return cast(A, x)


def check_parts(
    i: int, k: int, heard: Mapping[int, Any], *kinds: Any
) -> Mapping[int, Any]:
    """Return the messages of round k, after a check of their parts.

    i: id of the receiver
    k: round, for error texts
    heard: messages by neighbour
    kinds: type of each part of a message: a type, a tuple of types, or object for any type
    Raises ConfigError that names the neighbour and the round of a message that does not fit.
    """
    for j, message in heard.items():
        whole = isinstance(message, list | tuple) and len(message) == len(kinds)
        if not (whole and all(map(isinstance, message, kinds))):
            raise build_malformed_error(
                f"agent {i}",
                j,
                k,
                message,
                f"a list of {len(kinds)}: {', '.join(map(_name_type, kinds))}",
            )
    return heard


def build_malformed_error(
    where: str, j: int, k: int, message: Any, allowed: str
) -> ConfigError:
    """Return the error for a malformed message that agent j sent in round k."""
    found = type(message).__name__
    if isinstance(message, list | tuple):
        found = f"a list of {len(message)}: {', '.join(type(part).__name__ for part in message[:MOST_SHOWN_PARTS])}"
    elif isinstance(message, np.ndarray):
        found = f"shape {message.shape}"
    return ConfigError(f"{where}: message of agent {j}, round {k}", found, allowed)


def _name_type(kind: Any) -> str:
    if isinstance(kind, tuple):
        return " or ".join(map(_name_type, kind))
    return "anything" if kind is object else str(kind.__name__)


def require_heard(i: int, neighbors: tuple[int, ...], heard: Mapping[int, Any]) -> None:
    """Raise ConfigError unless exactly the neighbours are heard, in increasing order of id."""
    if tuple(heard) != neighbors:
        allowed = f"messages of its neighbors {list(neighbors)}, in each round"
        raise ConfigError(
            f"agent {i}",
            f"messages of {list(heard)}",
            allowed,
            "Take a static, undirected graph.",
        )
