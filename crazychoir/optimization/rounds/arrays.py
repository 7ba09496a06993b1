"""Check the numbers that a user gives: their shapes, and that they are numbers at all."""

from typing import Any

import numpy as np

from crazychoir.errors import ConfigError
from crazychoir.types import Mat, Vec


def copy_vector(
    values: Any, where: str, name: str, size: int | None = None, infinite: bool = False
) -> Vec:
    """Return a copy of the values as (size,) floats.

    size: wanted length, None for any length
    infinite: accept inf
    Raises ConfigError that names the wrong entry.
    """
    array: Vec = copy_numbers(values, where, name)
    if array.ndim != 1 or (size is not None and len(array) != size):
        raise ConfigError(
            f"{where}: {name}",
            f"shape {array.shape}",
            f"({'n' if size is None else size},)",
        )
    _require_finite(array, where, name, infinite)
    return array


def copy_matrix(
    values: Any, where: str, name: str, shape: tuple[int | None, int | None]
) -> Mat:
    """Return a copy of the values as floats of this shape.

    shape: wanted shape, None for any size
    Raises ConfigError that names row, column and value.
    """
    array: Mat = copy_numbers(values, where, name)
    if array.ndim != 2 or any(
        want not in (None, have) for want, have in zip(shape, array.shape, strict=True)
    ):
        rows, columns = ("n" if size is None else size for size in shape)
        raise ConfigError(
            f"{where}: {name}", f"shape {array.shape}", f"({rows}, {columns})"
        )
    _require_finite(array, where, name, infinite=False)
    return array


def is_number(value: Any) -> bool:
    """Return True if the value is one real number, and not a bool."""
    return isinstance(value, (int, float, np.integer, np.floating)) and not isinstance(
        value, bool
    )


def copy_numbers(values: Any, where: str, name: str) -> Any:
    """Return a copy of the values as floats; raise ConfigError if they are not numbers."""
    try:
        return np.array(values, dtype=float)
    except (TypeError, ValueError) as error:
        raise ConfigError(
            f"{where}: {name}", type(values).__name__, f"an array of numbers ({error})"
        ) from error


def _require_finite(array: Any, where: str, name: str, infinite: bool) -> None:
    bad = np.argwhere(np.isnan(array) if infinite else ~np.isfinite(array))
    if len(bad):
        index = tuple(int(k) for k in bad[0])
        allowed = "a number, or inf" if infinite else "a finite number"
        raise ConfigError(
            f"{where}: {name}[{', '.join(map(str, index))}]", f"{array[index]}", allowed
        )
