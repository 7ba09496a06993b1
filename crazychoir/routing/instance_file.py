"""Reading the fields of an instance file; every complaint names file, key and index."""

import json
import math
import sys
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from crazychoir.errors import InstanceError
from crazychoir.types import Mat, Vec

REQUIRED = ("home", "pickup", "delivery", "load", "capacity")
OPTIONAL = ("route_length_limit", "capability")
COUNTS = {"N": "home", "M": "load"}
"""Keys that repeat the length of a list; they must agree with it."""
ANNOTATIONS = (
    "name", "note", "source", "seed", "cost", "optimum", "status", "assignment",
    "lp_set_cover_bound", "max_tasks_in_any_feasible_route", "enumerated_up_to",
)  # fmt: skip
"""Keys that describe an instance without being part of it: accepted and ignored."""
FARTHEST, MOST = 1e5, 1e6
"""m of a coordinate; units of load: beyond them the rounding of a sum exceeds the slack of limits."""
LIKE = {"pickup": "load", "delivery": "load", "home": "home", "capacity": "home", "load": "load"}
"""The key whose length a list must have."""


def read(path: str | Path) -> dict[str, Any]:
    """The JSON object in the file `path`."""
    try:
        raw = json.loads(Path(path).read_text(encoding="utf-8"), object_pairs_hook=lambda p: _unique(p, str(path)))
    except OSError as error:
        raise InstanceError(str(path), error.strerror or "no file", "a readable JSON file", "Check the path.") from None
    except (ValueError, RecursionError) as error:
        if isinstance(error, InstanceError):
            raise
        raise InstanceError(str(path), f"no JSON ({error})", "one JSON object", "Mend the file.") from None
    if not isinstance(raw, dict):
        raise InstanceError(str(path), type(raw).__name__, "one JSON object {...}", "Put the keys into braces.")
    return raw


def _unique(pairs: list[tuple[str, Any]], where: str) -> dict[str, Any]:
    found: dict[str, Any] = {}
    for key, value in pairs:
        if key in found:
            raise InstanceError(f"{where}: {key}", "the key twice", "each key once", "Delete one of them.")
        found[key] = value
    return found


class Fields:
    """The fields of one instance, checked as they are taken."""

    def __init__(self, raw: dict[str, Any], where: str) -> None:
        self._raw, self._where = raw, where
        known = [*REQUIRED, *OPTIONAL, *COUNTS, *ANNOTATIONS]
        for key in raw:
            if key not in known:
                allowed = ", ".join([*REQUIRED, *OPTIONAL]) + "; as annotations " + ", ".join([*COUNTS, *ANNOTATIONS])
                raise self._error(key, "an unknown key", allowed, "Correct or delete it.")
        for key in REQUIRED:
            if key not in raw:
                raise self._error(key, "nothing", f"the keys {', '.join(REQUIRED)}", "Add it.")
        self._check_counts()

    def points(self, key: str) -> Mat:
        """(n, 2) or (n, 3), all of the dimension of home[0]."""
        rows = self._list(key)
        home = self._list("home")
        wanted = len(home[0]) if isinstance(home[0], list) else 0
        if wanted not in (2, 3):
            raise self._error("home[0]", home[0], "a point of 2 or 3 numbers", "Give x, y or x, y, z in metres.")
        for r, row in enumerate(rows):
            if not isinstance(row, list) or len(row) != wanted:
                raise self._error(
                    f"{key}[{r}]", row, f"a list of {wanted} numbers, as home[0]", "All points share one dimension."
                )
            for c, value in enumerate(row):
                self._number(f"{key}[{r}][{c}]", value, least=-FARTHEST, most=FARTHEST)
        return np.array(rows, dtype=float)

    def amounts(self, key: str) -> Vec:
        """(n,), 0 to MOST."""
        values = self._list(key)
        for r, value in enumerate(values):
            self._number(f"{key}[{r}]", value, most=MOST)
        return np.array(values, dtype=float)

    def limit(self, key: str) -> float:
        """A length, not negative, or infinity where the key is absent or null."""
        value = self._raw.get(key)
        if value is None:
            return math.inf
        self._number(key, value)
        return float(value)

    def mask(self, key: str) -> npt.NDArray[np.bool_]:
        """(N, M) booleans, all true where the key is absent or null."""
        n, m = len(self._raw["home"]), len(self._raw["load"])
        rows = self._raw.get(key)
        if rows is None:
            return np.ones((n, m), dtype=bool)
        if not isinstance(rows, list) or len(rows) != n:
            raise self._error(key, _size(rows), f"{n} rows, one a robot (as many as home)", "Add or delete rows.")
        for r, row in enumerate(rows):
            if not isinstance(row, list) or len(row) != m:
                raise self._error(f"{key}[{r}]", _size(row), f"{m} booleans, one a task", "Add or delete entries.")
            for c, value in enumerate(row):
                if not isinstance(value, bool):
                    raise self._error(f"{key}[{r}][{c}]", value, "true or false", "Write a boolean.")
        return np.array(rows, dtype=bool)

    def _list(self, key: str) -> list[Any]:
        values, like = self._raw[key], LIKE[key]
        if not isinstance(values, list) or not values:
            raise self._error(key, _size(values), "a list that is not empty", "Add entries.")
        other = self._raw[like]
        if isinstance(other, list) and len(other) != len(values):
            raise self._error(
                key, f"{len(values)} entries", f"{len(other)}, as many as {like}", "Make the lists equally long."
            )
        return values

    def _number(self, where: str, value: object, least: float = 0.0, most: float = sys.float_info.max) -> None:
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise self._error(where, value, "a number", "Write a number.")
        if not least <= value <= most:
            found = value if isinstance(value, float) or abs(value) <= sys.float_info.max else math.inf
            allowed = f"a number from {least:g}" + (f" to {most:g}" if most < sys.float_info.max else " on, finite")
            raise self._error(where, found, allowed, "Mend the value.")

    def _check_counts(self) -> None:
        for key, of in COUNTS.items():
            if key in self._raw and isinstance(self._raw[of], list) and self._raw[key] != len(self._raw[of]):
                raise self._error(key, self._raw[key], f"{len(self._raw[of])}, the length of {of}", "Delete the key.")

    def _error(self, key: str, found: object, allowed: str, do: str) -> InstanceError:
        return InstanceError(f"{self._where}: {key}", found, allowed, do)


def _size(value: object) -> str:
    return f"{len(value)} entries" if isinstance(value, list) else repr(value)
