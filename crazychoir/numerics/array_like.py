"""Conversion of the numbers that users' code hands over into float64, once, on arrival."""

import numbers

import numpy as np

from crazychoir.types import Vec


def to_floats(value: object, shape: tuple[int, ...]) -> Vec | None:
    """Return the value as a float64 array that kernels take, a new one only if needed.

    Lists, tuples, whole numbers, truth values, numpy's scalars and arrays of other types are
    converted, also arrays that are read-only, big-endian or not contiguous. A masked entry becomes
    NaN.

    shape: shape that the value must have
    Returns None for texts, complex numbers, missing values and other shapes.
    """
    if (
        type(value) is np.ndarray
        and value.dtype == np.float64
        and value.shape == shape
        and value.flags.carray
    ):
        return value
    try:
        found = np.asarray(
            np.ma.filled(value.astype(float), np.nan)
            if isinstance(value, np.ma.MaskedArray)
            else value
        )
        if found.shape != shape:
            return None
        if found.dtype.kind == "O" and not all(
            isinstance(one, numbers.Real) for one in found.flat
        ):
            return None
        return (
            np.array(found, dtype=np.float64, order="C")
            if found.dtype.kind in "biufO"
            else None
        )
    except (TypeError, ValueError, OverflowError):
        return None


def describe_value(value: object) -> str:
    """Return a short description of a value: its type, and an array's dtype and shape."""
    try:
        text = " ".join(repr(value).split())
    except Exception:  # noqa: BLE001 - the repr of a user's class may fail
        text = ""
    if isinstance(value, np.ndarray):
        return f"{value.dtype} array of shape {value.shape}, {text:.60}"
    return f"{type(value).__name__} {text:.80}".strip()
