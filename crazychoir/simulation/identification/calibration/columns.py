"""Read the columns of a recorded flight from a file of arrays or a table with named columns."""

import csv
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from crazychoir.errors import ConfigError
from crazychoir.files.text_files import describe_unreadable
from crazychoir.numerics.math3d import STANDARD_GRAVITY
from crazychoir.simulation.identification.array_files import read_array_file
from crazychoir.simulation.identification.flights import FLIGHT_TIME_STEP
from crazychoir.types import Mat, Vec


class ColumnRules(NamedTuple):
    """How columns are read."""

    longest_step: float = 0.035
    """Longest time in s between two rows that are not a gap."""
    fewest_rows: int = 500
    """Least number of rows."""
    greatest_ratio: float = 65535.0
    """PWM ratio of a duty cycle of 1."""


COLUMN_RULES = ColumnRules()
REQUIRED_WIDTHS = {"p": 3, "q": 4, "gyro": 3, "duty": 4, "vbat": 1}
"""Number of components of each array that a calibration needs.

p: m, world: place of the markers
q: [x, y, z, w], markers to world
gyro: rad/s, body
duty: 0..1: duty cycles of motors 1 to 4, after the compensation of the battery
vbat: V under load
"""
OPTIONAL_WIDTHS = {"acc": 3, "sp": 3, "delay": 1, "gap": 1}
"""Number of components of each array that helps.

acc: m/s2, body: accelerometer; without it there is no lag
sp: m, world: set-point of the place; without it feedback biases what is found
delay: s: what the drone recorded at t happened at t - delay; without it the clocks are aligned
gap: s: time between the two packets around the row; without it interpolated rows are searched
"""
ARRAY_WIDTHS = {**REQUIRED_WIDTHS, **OPTIONAL_WIDTHS}
TABLE_NAMES: dict[str, tuple[tuple[str, ...], ...]] = {
    "p": (("x", "y", "z"),),
    "q": (("qx", "qy", "qz", "qw"),),
    "gyro": (("gyro_x", "gyro_y", "gyro_z"), ("gyro.x", "gyro.y", "gyro.z")),
    "duty": (
        ("duty_1", "duty_2", "duty_3", "duty_4"),
        ("motor.m1", "motor.m2", "motor.m3", "motor.m4"),
    ),
    "vbat": (("vbat",), ("pm.vbat",)),
    "acc": (("acc_x", "acc_y", "acc_z"), ("acc.x", "acc.y", "acc.z")),
    "sp": (("sp_x", "sp_y", "sp_z"),),
    "delay": (("delay",),),
    "gap": (("gap",),),
}
"""Names of the columns of each array in a table: in SI units, or as log variables of the firmware."""
FIRMWARE_FACTORS = {
    "gyro.x": math.radians(1.0),
    "motor.m1": 1.0 / COLUMN_RULES.greatest_ratio,
    "acc.x": STANDARD_GRAVITY,
}
"""SI units in the firmware's unit, by the first column of an array; 1 for others."""
LARGEST_VALUES = {
    "p": (100.0, "m"),
    "gyro": (40.0, "rad/s"),
    "acc": (200.0, "m/s^2"),
    "duty": (1.0, "shares of the full duty"),
    "vbat": (30.0, "V"),
}
"""Largest size of a number in each array, and its unit: larger ones are in another unit."""
LONGEST_USUAL_STEP = 0.2
"""s between two rows, the median of a flight: a longer one is in another unit."""
FIRMWARE_LOGS = (
    *TABLE_NAMES["gyro"][1],
    *TABLE_NAMES["acc"][1],
    *TABLE_NAMES["duty"][1],
    "pm.vbat",
)
"""Log variables of the firmware that a calibration reads."""


def read_columns(path: Path) -> dict[str, Mat]:
    """Return the columns of a flight, a row each 10 ms: `t` (n,) and the arrays of ARRAY_WIDTHS that it has.

    path: .npz with these arrays, or a table .csv with the columns of TABLE_NAMES
    Raises ConfigError if a required array is missing, not finite, or too short.
    """
    if path.suffix == ".npz":
        allowed = f"a file .npz with t, {', '.join(REQUIRED_WIDTHS)}"
        raw = read_array_file(path, allowed)
    else:
        raw = _read_table(path)
    return regularise(raw, str(path))


def regularise(raw: Mapping[str, Mat], where: str) -> dict[str, Mat]:
    """Return columns with a row each 10 ms, and check them.

    Arrays with times of their own are interpolated; times further apart than COLUMN_RULES.longest_step become gaps.

    raw: `t` (n,) in s and arrays of n rows
    where: name of the recording, for errors
    Raises ConfigError as `read_columns`.
    """
    missing = [name for name in ("t", *REQUIRED_WIDTHS) if name not in raw]
    if missing:
        raise ConfigError(
            where,
            f"no {', '.join(missing)}",
            f"t, {', '.join(REQUIRED_WIDTHS)}",
            "Record them: the log variables motor.m1 to motor.m4, gyro.x to gyro.z and pm.vbat, "
            "and acc.x to acc.z for the lag.",
        )
    t = np.asarray(raw["t"], float)
    rows = t.shape[0] if t.ndim == 1 else 0
    if rows < COLUMN_RULES.fewest_rows or not np.all(np.diff(t) > 0.0):
        raise ConfigError(
            f"{where}: t",
            f"{rows} rows",
            f"{COLUMN_RULES.fewest_rows} rows or more with growing times",
        )
    usual_step = float(np.median(np.diff(t)))
    if usual_step > LONGEST_USUAL_STEP:
        raise ConfigError(
            f"{where}: t",
            f"{usual_step:g} from row to row",
            f"s, at most {LONGEST_USUAL_STEP:g} from row to row",
        )
    grid = np.arange(t[0], t[-1] + 1e-9, FLIGHT_TIME_STEP)
    columns: dict[str, Mat] = {"t": grid - grid[0]}
    for name, width in ARRAY_WIDTHS.items():
        if name not in raw:
            continue
        column = np.asarray(raw[name], float)
        if column.shape not in ((rows, width), (rows,)[: 2 - (width > 1)]):
            raise ConfigError(
                f"{where}: {name}", f"shape {column.shape}", f"({rows}, {width})"
            )
        if not np.isfinite(column).all():
            raise ConfigError(
                f"{where}: {name}", "a number that is not finite", "finite numbers"
            )
        _check_unit(column, name, where)
        flat = column.reshape(rows, width)
        if name == "q":
            flat = make_continuous(flat)
        sampled = np.column_stack([np.interp(grid, t, part) for part in flat.T])
        columns[name] = sampled[:, 0] if width == 1 else sampled
    columns["q"] /= np.linalg.norm(columns["q"], axis=1)[:, None]
    steps = np.interp(grid, t[:-1], np.diff(t))
    if steps.max() > COLUMN_RULES.longest_step:
        columns["gap"] = np.maximum(columns.get("gap", 0.0), steps)
    return columns


def _check_unit(column: Mat, name: str, where: str) -> None:
    """Raise ConfigError if the numbers of an array are too large for its unit."""
    if name not in LARGEST_VALUES:
        return
    limit, unit = LARGEST_VALUES[name]
    largest = float(np.abs(column).max())
    if largest > limit:
        firmware = TABLE_NAMES[name][-1]
        do = (
            f"If these are numbers of the firmware, name the columns {', '.join(firmware)}."
            if firmware[0] in FIRMWARE_FACTORS
            else ""
        )
        allowed = f"{unit}, at most {limit:g}"
        raise ConfigError(f"{where}: {name}", f"{largest:g}", allowed, do)


def make_continuous(q: Mat) -> Mat:
    """Return the quaternions (n, 4) with signs that do not jump."""
    flips = np.where((q[1:] * q[:-1]).sum(axis=1) < 0.0, -1.0, 1.0)
    signs = np.concatenate([[1.0], np.cumprod(flips)])
    return np.asarray(q * signs[:, None])


def _read_table(path: Path) -> dict[str, Mat]:
    """Return the arrays of a table; its first line has the names of the columns."""
    try:
        with path.open(newline="", encoding="utf-8-sig") as file:
            lines = list(csv.reader(file))
        names = [name.strip() for name in lines[0]]
        numbers = np.array([[float(cell) for cell in row] for row in lines[1:] if row])
    except (OSError, ValueError, IndexError) as error:
        found = f"no table of numbers ({error})"
        if isinstance(error, OSError):
            found = describe_unreadable(error)
        elif isinstance(error, IndexError):
            found = "an empty file"
        allowed = "a table .csv with a line of names, then numbers"
        raise ConfigError(str(path), found, allowed) from error
    if numbers.ndim != 2 or numbers.shape[1] != len(names):
        raise ConfigError(
            str(path), f"{len(names)} names", "one name for each column of numbers"
        )
    named = dict(zip(names, numbers.T, strict=True))
    _refuse_parts(named, str(path))
    return gather_arrays(named)


def _refuse_parts(named: Mapping[str, Vec], where: str) -> None:
    """Raise ConfigError if a table has some of the columns of an array, and not all."""
    for choices in TABLE_NAMES.values():
        if any(all(name in named for name in names) for names in choices):
            continue
        for names in choices:
            there = [name for name in names if name in named]
            if there:
                missing = ", ".join(name for name in names if name not in named)
                found = f"{', '.join(there)} without {missing}"
                raise ConfigError(where, found, f"all of {', '.join(names)}, or none")


def gather_arrays(named: Mapping[str, Vec]) -> dict[str, Mat]:
    """Return the arrays in SI units that named columns make together; `t` is one of them."""
    arrays: dict[str, Mat] = {"t": named["t"]} if "t" in named else {}
    for array, choices in TABLE_NAMES.items():
        for names in choices:
            if all(name in named for name in names):
                arrays[array] = _stack(named, names)
                break
    return arrays


def _stack(named: Mapping[str, Vec], names: Sequence[str]) -> Mat:
    factor = FIRMWARE_FACTORS.get(names[0], 1.0)
    stacked = factor * np.column_stack([named[name] for name in names])
    return stacked[:, 0] if len(names) == 1 else stacked
