"""Checks of single values of an instance file; every error names file, key and index."""

import json
import math
import sys
from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from crazychoir.errors import InstanceError
from crazychoir.routing.instance.sizes import INSTANCE_LIMITS
from crazychoir.types import Mat, Vec


class ValueChecks:
    """Checks values of one file, whatever their key means.

    Every method raises InstanceError with file, key and index if the value is not allowed.
    where: name of the file
    """

    def __init__(self, where: str) -> None:
        self._where = where

    def error(self, key: str, found: object, allowed: str, do: str) -> InstanceError:
        """Return the error for a value of this file."""
        return InstanceError(f"{self._where}: {key}", found, allowed, do)

    def number(
        self,
        where: str,
        value: object,
        least: float = 0.0,
        most: float = sys.float_info.max,
    ) -> None:
        """Check that a value is a number from `least` to `most`."""
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise self.error(
                where,
                json.dumps(value, default=str),
                "a number",
                "Write a number, without quotes.",
            )
        if not least <= value <= most:
            found = (
                value
                if isinstance(value, float) or abs(value) <= sys.float_info.max
                else math.inf
            )
            allowed = f"a number from {least:g}" + (
                f" to {most:g}" if most < sys.float_info.max else " on, finite"
            )
            raise self.error(where, found, allowed, "Correct the value.")

    def entries(
        self, key: str, rows: object, count: int, allowed: str, do: str
    ) -> list[Any]:
        """Return the rows if they are a list of `count` entries.

        allowed: what the error text allows
        do: what the error text advises
        """
        if not isinstance(rows, list) or len(rows) != count:
            raise self.error(key, describe_size(rows), allowed, do)
        return rows

    def whole_number(
        self, key: str, value: object, numbers: range, allowed: str, do: str
    ) -> int:
        """Return the value if it is a whole number in the range.

        allowed: what the error text allows
        do: what the error text advises
        """
        is_whole = isinstance(value, int) and not isinstance(value, bool)
        if not is_whole or value not in numbers:
            raise self.error(key, value, allowed, do)
        return int(value)  # type: ignore[call-overload, no-any-return]

    def boolean(self, key: str, value: object) -> bool:
        """Return the value if it is true or false."""
        if not isinstance(value, bool):
            raise self.error(key, value, "true or false", "Write a boolean.")
        return value

    def booleans(
        self, key: str, rows: object, robots: int, tasks: int
    ) -> npt.NDArray[np.bool_]:
        """Return (robots, tasks) booleans."""
        wanted = f"{robots} rows, one a robot (as many as home)"
        listed = self.entries(key, rows, robots, wanted, "Add or delete rows.")
        for r, row in enumerate(listed):
            self.entries(
                f"{key}[{r}]",
                row,
                tasks,
                f"{tasks} booleans, one a task",
                "Add or delete entries.",
            )
            for c, value in enumerate(row):
                self.boolean(f"{key}[{r}][{c}]", value)
        return np.array(listed, dtype=bool)

    def matrices(
        self, key: str, rows: Any, robots: int, size: int
    ) -> npt.NDArray[np.float64]:
        """Return (size, size) or (robots, size, size) m: one matrix, or one a robot."""
        first = rows[0] if isinstance(rows, list) and rows else None
        if not (isinstance(first, list) and first and isinstance(first[0], list)):
            return self.matrix(key, rows, size)
        wanted = f"{robots} matrices, one a robot, or one"
        self.entries(key, rows, robots, wanted, "Add or delete matrices.")
        matrices = [self.matrix(f"{key}[{i}]", m, size) for i, m in enumerate(rows)]
        return np.array(matrices)

    def names(self, key: str, given: dict[str, Any], allowed: Sequence[str]) -> None:
        """Check that an object has no other names than the allowed ones."""
        for name in given:
            if name not in allowed:
                raise self.error(
                    f"{key}.{name}",
                    "an unknown key",
                    ", ".join(allowed),
                    "Correct or delete it.",
                )

    def points(self, key: str, rows: list[Any], wanted: int) -> Mat:
        """Return (n, wanted) m: points of `wanted` coordinates."""
        for r, row in enumerate(rows):
            if not isinstance(row, list) or len(row) != wanted:
                raise self.error(
                    f"{key}[{r}]",
                    row,
                    f"a list of {wanted} numbers, as home[0]",
                    "All points share one dimension.",
                )
            for c, value in enumerate(row):
                self.number(
                    f"{key}[{r}][{c}]",
                    value,
                    least=-INSTANCE_LIMITS.distance_or_speed,
                    most=INSTANCE_LIMITS.distance_or_speed,
                )
        return np.array(rows, dtype=float).reshape(len(rows), wanted)

    def matrix(self, key: str, rows: object, size: int) -> Mat:
        """Return (size, size) m: a matrix of distances."""
        wanted = f"{size} numbers: homes, pickups, deliveries"
        if not isinstance(rows, list) or len(rows) != size:
            raise self.error(
                key,
                describe_size(rows),
                f"{size} rows of {wanted}",
                "Add or delete rows.",
            )
        for r, row in enumerate(rows):
            if not isinstance(row, list) or len(row) != size:
                raise self.error(
                    f"{key}[{r}]", describe_size(row), wanted, "Add or delete entries."
                )
            for c, value in enumerate(row):
                self.number(
                    f"{key}[{r}][{c}]", value, most=INSTANCE_LIMITS.distance_or_speed
                )
        return np.array(rows, dtype=float)

    def window(self, key: str, row: object) -> tuple[float, float]:
        """Return a window (from, to) in s; 0, inf for null."""
        if row is None:
            return 0.0, math.inf
        if not isinstance(row, list) or len(row) != 2:
            raise self.error(
                key,
                row,
                "[from, to] in seconds, or null",
                "Write two numbers; to may be null.",
            )
        self.number(f"{key}[0]", row[0], most=INSTANCE_LIMITS.latest_time)
        if row[1] is None:
            return float(row[0]), math.inf
        self.number(f"{key}[1]", row[1], most=INSTANCE_LIMITS.latest_time)
        if row[1] < row[0]:
            raise self.error(
                key,
                row,
                "[from, to] with to not before from",
                "Correct one of the two.",
            )
        return float(row[0]), float(row[1])

    def numbers(
        self,
        key: str,
        value: Any,
        count: int,
        default: float,
        least: float = 0.0,
        most: float = 0.0,
    ) -> Vec:
        """Return (count,): one number for all, or a list; `default` if null."""
        if value is None:
            return np.full(count, default)
        if not isinstance(value, list):
            self.number(key, value, least, most)
            return np.full(count, float(value))
        if len(value) != count:
            raise self.error(
                key,
                describe_size(value),
                f"one number, or {count} of them",
                "Add or delete entries.",
            )
        for r, number in enumerate(value):
            self.number(f"{key}[{r}]", number, least, most)
        return np.array(value, dtype=float)


def describe_size(value: object) -> str:
    """Return the length of a list in words, or the value itself."""
    return f"{len(value)} entries" if isinstance(value, list) else repr(value)
