"""What the algorithms of this room check of a message before they calculate with it."""

from collections.abc import Mapping
from typing import Any, Final, TypeVar, cast

import numpy as np
import numpy.typing as npt

from crazychoir.errors import ConfigError

A = TypeVar("A", bound=npt.NDArray[Any])
INTEGER: Final = (int, np.integer)
NUMBER: Final = (float, *INTEGER)
SHOWN: Final = 8
"""Parts of a malformed message that an error names."""


def like(i: int, j: int, x: Any, own: A) -> A:
    """The array x that agent j has sent to i, if it is shaped as i's own; else raises ConfigError."""
    if type(x) is not np.ndarray or x.shape != own.shape:
        found = f"shape {x.shape}" if isinstance(x, np.ndarray) else type(x).__name__
        raise ConfigError(
            f"agent {i}: message of agent {j}", found, f"shape {own.shape}, as its own"
        )
    return cast(A, x)


def parts(i: int, k: int, heard: Mapping[int, Any], *kinds: Any) -> Mapping[int, Any]:
    """What agent i has heard in round k, if each message is a list of as many parts, of these kinds.

    kinds: of each part, a type, a tuple of types, or object for any.
    Raises ConfigError that names the neighbour and the round.
    """
    for j, message in heard.items():
        whole = isinstance(message, list | tuple) and len(message) == len(kinds)
        if not (whole and all(map(isinstance, message, kinds))):
            raise malformed(
                f"agent {i}",
                j,
                k,
                message,
                f"a list of {len(kinds)}: {', '.join(map(_named, kinds))}",
            )
    return heard


def malformed(where: str, j: int, k: int, message: Any, allowed: str) -> ConfigError:
    """The error of what agent j has sent in round k, which is not what it should be."""
    found = type(message).__name__
    if isinstance(message, list | tuple):
        found = f"a list of {len(message)}: {', '.join(type(part).__name__ for part in message[:SHOWN])}"
    elif isinstance(message, np.ndarray):
        found = f"shape {message.shape}"
    return ConfigError(f"{where}: message of agent {j}, round {k}", found, allowed)


def _named(kind: Any) -> str:
    if isinstance(kind, tuple):
        return " or ".join(map(_named, kind))
    return "anything" if kind is object else str(kind.__name__)


def require_heard(i: int, neighbors: tuple[int, ...], heard: Mapping[int, Any]) -> None:
    """Raise ConfigError unless exactly the neighbours are heard, which are in increasing order."""
    if tuple(heard) != neighbors:
        allowed = f"messages of its neighbors {list(neighbors)}, in each round"
        raise ConfigError(
            f"agent {i}",
            f"messages of {list(heard)}",
            allowed,
            "Take a static, undirected graph.",
        )
