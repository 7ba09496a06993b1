"""Values that follow from a swarm file, computed once and shared by all drones of a process."""

from collections.abc import Callable, Hashable
from typing import Any, Concatenate, ParamSpec, TypeVar

from crazychoir.config.tables import Swarm

S = TypeVar("S", bound=Swarm)
"""The swarm file."""
P = ParamSpec("P")
R = TypeVar("R")

_SHARED_VALUES = "shared_values"
"""Key under which a swarm file keeps the values that follow from it."""


def share(
    config: S,
    compute: Callable[Concatenate[S, P], R],
    *args: P.args,
    **kwargs: P.kwargs,
) -> R:
    """Return compute(config, *args), which is computed once for each swarm file.

    Without this, each of N drones would look through N drones. The value lives as long as the swarm
    file. All callers get the same value, so they must not change it. An error is not kept.

    config: the swarm file, which is frozen
    compute: a function of the module, not a lambda
    args: further arguments, hashable
    """
    values: dict[Hashable, Any] = config.__dict__.setdefault(_SHARED_VALUES, {})
    key = (compute, args, *kwargs.items())
    if key not in values:
        values[key] = compute(config, *args, **kwargs)
    found: R = values[key]
    return found
