"""What the algorithms of this room check of a message before they calculate with it."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from crazychoir.errors import ConfigError
from crazychoir.types import Vec


def like(i: int, j: int, x: Any, own: Vec) -> Vec:
    """The array x that agent j has sent to i, if it is shaped as i's own; else raises ConfigError."""
    if type(x) is not np.ndarray or x.shape != own.shape:
        found = f"shape {x.shape}" if isinstance(x, np.ndarray) else type(x).__name__
        raise ConfigError(f"agent {i}: message of agent {j}", found, f"shape {own.shape}, as its own")
    return x


def require_heard(i: int, neighbors: tuple[int, ...], heard: Mapping[int, Any]) -> None:
    """Raise ConfigError unless exactly the neighbours are heard, which are in increasing order."""
    if tuple(heard) != neighbors:
        allowed = f"messages of its neighbors {list(neighbors)}, in each round"
        raise ConfigError(f"agent {i}", f"messages of {list(heard)}", allowed, "Take a static, undirected graph.")
