"""Read the fields of an instance file; every error names file, key and index."""

import json
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from crazychoir.errors import InstanceError
from crazychoir.files.text_files import read_text
from crazychoir.routing.instance.li_lim import is_li_lim, parse_li_lim
from crazychoir.routing.instance.sizes import INSTANCE_LIMITS
from crazychoir.routing.instance.value_checks import ValueChecks, describe_size
from crazychoir.types import Mat, Vec


@dataclass(frozen=True, slots=True)
class InstanceKeys:
    """Keys of an instance file."""

    required: tuple[str, ...] = ("home", "pickup", "delivery", "load", "capacity")
    """Keys that every instance file must have."""
    optional: tuple[str, ...] = (
        "route_length_limit",
        "capability",
        "end",
        "open_tours",
        "distance",
        "speed",
        "service_time",
        "time_windows",
        "release",
        "initial_load",
        "penalty",
        "priority",
        "objective",
        "recharge",
        "fixed_cost",
    )
    """Keys that an instance file may have."""
    annotations: tuple[str, ...] = (
        "name",
        "note",
        "source",
        "seed",
        "cost",
        "optimum",
        "status",
        "assignment",
        "lp_set_cover_bound",
        "max_tasks_in_any_feasible_route",
        "enumerated_up_to",
    )
    """Keys that describe an instance without being part of it: accepted and ignored."""


INSTANCE_KEYS = InstanceKeys()


COUNT_KEYS = {"N": "home", "M": "load"}
"""Keys that repeat the length of a list; they must agree with it."""
EXAMPLE_ADVICE = "Correct the file; agents/data/lab6.json is an instance (swarm files alone are TOML)."
MOST_TRIPS = 1000
"""Largest number of trips of a robot."""
HIGHEST_PRIORITY = 1000
"""Highest priority of a task."""
EQUALLY_LONG_LISTS = {
    "pickup": "load",
    "delivery": "load",
    "home": "home",
    "capacity": "home",
    "load": "load",
}
"""For each list, the key of the list that must be equally long."""


def read_instance_file(path: str | Path) -> tuple[dict[str, Any], list[str]]:
    """Read an instance file.

    path: a JSON file, or a file of Li and Lim.
    Returns the JSON object, and what a file of Li and Lim calls each task (empty for JSON).
    Raises InstanceError if the file is neither.
    """
    allowed = "one JSON object, or a file of Li and Lim"
    text = read_text(path, allowed, kind=InstanceError, do="Check the path.")
    if is_li_lim(text):
        return parse_li_lim(text, str(path))
    try:
        raw = json.loads(
            text, object_pairs_hook=lambda p: _require_unique_keys(p, str(path))
        )
    except (ValueError, RecursionError) as error:
        if isinstance(error, InstanceError):
            raise
        found = f"no JSON ({error})" if text.strip() else "an empty file"
        raise InstanceError(str(path), found, allowed, EXAMPLE_ADVICE) from None
    if not isinstance(raw, dict):
        raise InstanceError(
            str(path),
            type(raw).__name__,
            "one JSON object {...}",
            "Put the keys into braces.",
        )
    return raw, []


def _require_unique_keys(pairs: list[tuple[str, Any]], where: str) -> dict[str, Any]:
    found: dict[str, Any] = {}
    for key, value in pairs:
        if key in found:
            raise InstanceError(
                f"{where}: {key}",
                "the key twice",
                "each key once",
                "Delete one of them.",
            )
        found[key] = value
    return found


class InstanceFields:
    """The fields of one instance, checked when they are read.

    Every method raises InstanceError with file, key and index if the value is not allowed.
    """

    def __init__(self, raw: dict[str, Any], where: str) -> None:
        self._raw = raw
        self._checks = ValueChecks(where)
        _check_keys(raw, self._checks)
        _check_counts(raw, self._checks)

    def points(self, key: str) -> Mat:
        """Return (n, 2) or (n, 3) m; all points have the dimension of home[0]."""
        rows = self._list(key)
        home = self._list("home")
        wanted = len(home[0]) if isinstance(home[0], list) else 0
        if wanted not in (2, 3):
            raise self._checks.error(
                "home[0]",
                home[0],
                "a point of 2 or 3 numbers",
                "Give x, y or x, y, z in metres.",
            )
        return self._checks.points(key, rows, wanted)

    def amounts(self, key: str) -> Vec:
        """Return (n,) numbers from 0 to INSTANCE_LIMITS.amount."""
        values = self._list(key)
        for r, value in enumerate(values):
            self._checks.number(f"{key}[{r}]", value, most=INSTANCE_LIMITS.amount)
        return np.array(values, dtype=float)

    def limit(self, key: str) -> float:
        """Return a length, not negative; infinity if the key is absent or null."""
        value = self._raw.get(key)
        if value is None:
            return math.inf
        self._checks.number(key, value)
        return float(value)

    def cost(self, key: str) -> float:
        """Return a number, not negative; 0 if the key is absent or null."""
        value = self._raw.get(key)
        self._checks.number(
            key, 0.0 if value is None else value, most=INSTANCE_LIMITS.amount
        )
        return float(value or 0.0)

    def flag(self, key: str) -> bool:
        """Return true or false; false if the key is absent or null."""
        value = self._raw.get(key)
        return value is not None and self._checks.boolean(key, value)

    def trips(self, key: str) -> int:
        """Return a whole number from 1; 1 if the key is absent or null."""
        value = self._raw.get(key)
        if value is None:
            return 1
        allowed = f"a whole number of trips from 1 to {MOST_TRIPS}"
        trips = self._checks.whole_number(
            key, value, range(1, MOST_TRIPS + 1), allowed, "Write a number."
        )
        if trips > 1 and self.flag("open_tours"):
            raise self._checks.error(
                key,
                value,
                "1 in open tours",
                "A robot that recharges must come back: delete open_tours.",
            )
        return trips

    def objective(
        self, key: str, allowed: Sequence[tuple[str, ...]]
    ) -> tuple[str, ...]:
        """Return one of `allowed`; the first if the key is absent or null."""
        value = self._raw.get(key)
        if value is None:
            return allowed[0]
        names: tuple[Any, ...] = ()
        if isinstance(value, str):
            names = (value,)
        elif isinstance(value, list):
            names = tuple(value)
        if names not in allowed:
            listed = "; ".join(
                json.dumps(list(names) if len(names) > 1 else names[0])
                for names in allowed
            )
            raise self._checks.error(key, value, listed, "Choose one.")
        return names

    def ends(self, key: str) -> Mat | None:
        """Return (N, d) m, with homes for null rows; None if the key is absent or null."""
        rows = self._raw.get(key)
        if rows is None:
            return None
        for other in ("distance", "open_tours"):
            if self._raw.get(other):
                raise self._checks.error(
                    key, "an end", f"none beside {other}", "Delete one of the two."
                )
        home = self._raw["home"]
        rows = self._checks.entries(
            key,
            rows,
            len(home),
            f"{len(home)} points or nulls, one a robot",
            "Add or delete entries.",
        )
        filled = [
            at_home if row is None else row
            for row, at_home in zip(rows, home, strict=True)
        ]
        return self._checks.points(key, filled, len(home[0]))

    def matrices(self, key: str) -> npt.NDArray[np.float64] | None:
        """Return (n, n) or (N, n, n) m, n = N + 2M; None if the key is absent or null."""
        rows = self._raw.get(key)
        if rows is None:
            return None
        robots = len(self._raw["home"])
        size = robots + 2 * len(self._raw["load"])
        return self._checks.matrices(key, rows, robots, size)

    def speeds(self, key: str) -> Vec:
        """Return (N,) m/s; 1 if the key is absent or null."""
        return self._checks.numbers(
            key,
            self._raw.get(key),
            len(self._raw["home"]),
            1.0,
            least=INSTANCE_LIMITS.slowest_speed,
            most=INSTANCE_LIMITS.distance_or_speed,
        )

    def times(self, key: str) -> Vec:
        """Return (M,) s; 0 if the key is absent or null."""
        return self._checks.numbers(
            key,
            self._raw.get(key),
            len(self._raw["load"]),
            0.0,
            most=INSTANCE_LIMITS.latest_time,
        )

    def service(self) -> Vec:
        """Return the service times, (2M,) s: pickups, then deliveries."""
        key = "service_time"
        m = len(self._raw["load"])
        value = self._raw.get(key)
        if isinstance(value, list):
            raise self._checks.error(
                key,
                describe_size(value),
                "a number, or an object of pickup and delivery",
                "Name the stops.",
            )
        if not isinstance(value, dict):
            return self._checks.numbers(
                key, self._raw.get(key), 2 * m, 0.0, most=INSTANCE_LIMITS.latest_time
            )
        self._checks.names(key, value, ("pickup", "delivery"))
        return np.concatenate(
            [
                self._checks.numbers(
                    f"{key}.{part}",
                    value.get(part),
                    m,
                    0.0,
                    most=INSTANCE_LIMITS.latest_time,
                )
                for part in ("pickup", "delivery")
            ]
        )

    def windows(self, part: str) -> Mat:
        """Return the windows [from, to] of pickups, deliveries or homes, (n, 2) s.

        A missing window is 0, inf.
        """
        key = f"time_windows.{part}"
        count = len(self._raw["home" if part == "home" else "load"])
        given = self._raw.get("time_windows")
        if given is None:
            given = {}
        if not isinstance(given, dict):
            raise self._checks.error(
                "time_windows",
                given,
                "an object of pickup, delivery and home",
                "Put it into braces.",
            )
        self._checks.names("time_windows", given, ("pickup", "delivery", "home"))
        rows = given.get(part)
        if rows is None:
            return np.tile([0.0, math.inf], (count, 1))
        rows = self._checks.entries(
            key,
            rows,
            count,
            f"{count} windows [from, to] or nulls",
            "Add or delete entries.",
        )
        return np.array(
            [self._checks.window(f"{key}[{r}]", row) for r, row in enumerate(rows)]
        )

    def part_of(self, key: str, capacity: Vec) -> Vec:
        """Return (N,), each at most the robot's capacity; 0 if the key is absent or null."""
        part = self._checks.numbers(
            key, self._raw.get(key), len(capacity), 0.0, most=INSTANCE_LIMITS.amount
        )
        for r in np.flatnonzero(part > capacity):
            raise self._checks.error(
                f"{key}[{r}]",
                float(part[r]),
                f"at most {capacity[r]:g}, its capacity",
                "Correct one.",
            )
        return part

    def penalties(self, key: str) -> Vec:
        """Return (M,); inf for null, which means that the task must be served."""
        rows = self._raw.get(key)
        count = len(self._raw["load"])
        if rows is None:
            return np.full(count, math.inf)
        rows = self._checks.entries(
            key,
            rows,
            count,
            f"{count} numbers or nulls, one a task",
            "Add or delete entries.",
        )
        for r, value in enumerate(rows):
            if value is not None:
                self._checks.number(f"{key}[{r}]", value, most=INSTANCE_LIMITS.amount)
        return np.array(
            [math.inf if value is None else value for value in rows], dtype=float
        )

    def levels(self, key: str) -> npt.NDArray[np.int64]:
        """Return (M,) whole numbers; 0 if the key is absent or null."""
        rows = self._raw.get(key)
        count = len(self._raw["load"])
        if rows is None:
            return np.zeros(count, dtype=np.int64)
        rows = self._checks.entries(
            key,
            rows,
            count,
            f"{count} whole numbers, one a task",
            "Add or delete entries.",
        )
        allowed = f"a whole number from 0 to {HIGHEST_PRIORITY}"
        for r, value in enumerate(rows):
            self._checks.whole_number(
                f"{key}[{r}]", value, range(HIGHEST_PRIORITY + 1), allowed, "Write one."
            )
        return np.array(rows, dtype=np.int64)

    def mask(self, key: str) -> npt.NDArray[np.bool_]:
        """Return (N, M) booleans; all true if the key is absent or null."""
        n = len(self._raw["home"])
        m = len(self._raw["load"])
        rows = self._raw.get(key)
        if rows is None:
            return np.ones((n, m), dtype=bool)
        return self._checks.booleans(key, rows, n, m)

    def _list(self, key: str) -> list[Any]:
        values = self._raw[key]
        like = EQUALLY_LONG_LISTS[key]
        if not isinstance(values, list):
            raise self._checks.error(
                key, describe_size(values), "a list", "Put its entries into brackets."
            )
        if key == "home" and not values:
            raise self._checks.error(
                key, describe_size(values), "a list that is not empty", "Add robots."
            )
        other = self._raw[like]
        if isinstance(other, list) and len(other) != len(values):
            raise self._checks.error(
                key,
                f"{len(values)} entries",
                f"{len(other)}, as many as {like}",
                "Make the lists equally long.",
            )
        return values


def _check_keys(raw: dict[str, Any], checks: ValueChecks) -> None:
    """Check that all keys are known, and that the required ones are there."""
    known = [
        *INSTANCE_KEYS.required,
        *INSTANCE_KEYS.optional,
        *COUNT_KEYS,
        *INSTANCE_KEYS.annotations,
    ]
    for key in raw:
        if key not in known:
            allowed = (
                ", ".join([*INSTANCE_KEYS.required, *INSTANCE_KEYS.optional])
                + "; as annotations "
                + ", ".join([*COUNT_KEYS, *INSTANCE_KEYS.annotations])
            )
            raise checks.error(key, "an unknown key", allowed, "Correct or delete it.")
    for key in INSTANCE_KEYS.required:
        if key not in raw:
            raise checks.error(
                key,
                "nothing",
                f"the keys {', '.join(INSTANCE_KEYS.required)}",
                "Add it.",
            )


def _check_counts(raw: dict[str, Any], checks: ValueChecks) -> None:
    """Check that keys that repeat the length of a list agree with it."""
    for key, of in COUNT_KEYS.items():
        if key in raw and isinstance(raw[of], list) and raw[key] != len(raw[of]):
            raise checks.error(
                key,
                raw[key],
                f"{len(raw[of])}, the length of {of}",
                "Delete the key.",
            )
