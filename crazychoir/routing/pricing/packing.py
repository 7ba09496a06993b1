"""Coding of columns for messages."""

from collections.abc import Sequence
from itertools import accumulate
from typing import Any

import numpy as np

from crazychoir.routing.pricing.route_table import RouteColumn


def pack_columns(columns: Sequence[RouteColumn]) -> list[Any]:
    """Return lengths (K,), numbers of tasks (K,), and all tasks in one array.

    The codec handles a few arrays much faster than many small lists.
    """
    tasks = [j for column in columns for j in column.tasks]
    sizes = [len(column.tasks) for column in columns]
    return [
        np.array([c.length for c in columns], dtype=float),
        np.array(sizes, np.int16),
        np.array(tasks, np.int16),
    ]


def unpack_columns(parts: Sequence[Any]) -> list[RouteColumn]:
    """Return the columns that `pack_columns` coded."""
    lengths, sizes, tasks = (part.tolist() for part in parts)
    ends = list(accumulate(sizes))
    return [
        RouteColumn(length, tuple(tasks[end - n : end]))
        for length, n, end in zip(lengths, sizes, ends, strict=True)
    ]
