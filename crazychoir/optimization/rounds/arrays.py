"""Numbers that a user gives, checked: shapes, and that they are numbers at all."""

from typing import Any

import numpy as np

from crazychoir.errors import ConfigError
from crazychoir.types import Mat, Vec


def vector(
    values: Any, where: str, name: str, size: int | None = None, infinite: bool = False
) -> Vec:
    """A copy as (size,) floats; ConfigError that names the entry. infinite: whether inf is a number here."""
    array: Vec = numbers(values, where, name)
    if array.ndim != 1 or (size is not None and len(array) != size):
        raise ConfigError(
            f"{where}: {name}",
            f"shape {array.shape}",
            f"({'n' if size is None else size},)",
        )
    _require_finite(array, where, name, infinite)
    return array


def matrix(
    values: Any, where: str, name: str, shape: tuple[int | None, int | None]
) -> Mat:
    """A copy as floats of this shape, None: any; ConfigError that names row, column and value."""
    array: Mat = numbers(values, where, name)
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
    """Whether it is one real number, and no truth value."""
    return isinstance(value, (int, float, np.integer, np.floating)) and not isinstance(
        value, bool
    )


def numbers(values: Any, where: str, name: str) -> Any:
    """A copy as floats of any shape; ConfigError where they are none."""
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
