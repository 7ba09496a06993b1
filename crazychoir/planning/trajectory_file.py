"""Trajectories in CSV files: samples, or the pieces of crazyswarm and uav_trajectories."""

import re
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
from scipy.interpolate import BPoly, PPoly

from crazychoir.files.recorded_times import require_later, require_seconds
from crazychoir.planning.number_table import (
    TableError,
    check_increasing,
    parse_table,
    read_table,
    read_table_text,
    write_table,
)
from crazychoir.planning.piecewise import POLYNOMIAL_DEGREE, Piecewise
from crazychoir.planning.spline import fit_spline, unwrap_yaws
from crazychoir.planning.trajectory import Trajectory, sample_setpoints
from crazychoir.types import Mat


@dataclass(frozen=True, slots=True)
class SampleColumns:
    """Columns of a file of samples."""

    place: tuple[str, ...] = ("t", "x", "y", "z")
    """Columns of time and place."""
    yaw: tuple[str] = ("yaw",)
    """Column of the yaw."""
    derivatives: tuple[tuple[str, ...], ...] = (
        ("vx", "vy", "vz"),
        ("ax", "ay", "az"),
        ("jx", "jy", "jz"),
    )
    """Columns of velocity, acceleration and jerk."""
    yaw_rate: tuple[str] = ("yaw_rate",)
    """Column of the yaw rate."""


SAMPLE_COLUMNS = SampleColumns()


PIECE_COLUMNS = (
    "duration",
    *(
        f"{axis}^{n}"
        for axis in ("x", "y", "z", "yaw")
        for n in range(POLYNOMIAL_DEGREE + 1)
    ),
)
PIECES_START = re.compile(r"[\s\ufeff#,;\"']*duration\b", re.IGNORECASE)
"""Start of a file of pieces."""
SPARSE_TABLE_ROWS = 20
"""Rows of a table: one with fewer is written by hand, and its samples may be far from each other."""
LARGEST_JUMP = (
    0.01,
    0.1,
)
"""Largest jump between two pieces: m and rad, then m/s and rad/s.

A larger jump is a mistake, not rounding.
"""


def write_samples(
    path: str | Path, trajectory: Trajectory, rate: float = 100.0
) -> None:
    """Write t, x, y, z, yaw, then v, a, j and the yaw rate; s, m, rad.

    path: of the file
    trajectory: the trajectory
    rate: Hz, rows a second; the end of the trajectory is an additional row
    """
    t, x = sample_setpoints(trajectory, rate)
    names = [
        *SAMPLE_COLUMNS.place,
        *SAMPLE_COLUMNS.yaw,
        *(name for group in SAMPLE_COLUMNS.derivatives for name in group),
        *SAMPLE_COLUMNS.yaw_rate,
    ]
    write_table(
        path, names, np.column_stack([t, x[:, 0:3], x[:, 12], x[:, 3:12], x[:, 13]])
    )


def read_samples(path: str | Path, is_recording: bool = False) -> Piecewise:
    """Return the trajectory through the samples of a CSV file.

    The columns are t s, x, y, z m. Further columns are optional: vx, vy, vz; then ax, ay, az, which
    need v; then jx, jy, jz, which need a; yaw rad, 0 without it; then yaw_rate, which needs yaw.
    With derivatives, the trajectory has them all at each sample (Hermite polynomials). Without, it
    is the clamped cubic spline, at rest at both ends. The yaw is cubic, and turns the short way from
    each row to the next.

    is_recording: whether the times come from a clock; they are then refused if they are not in s
    Raises TableError with file, line and column.
    """
    table = read_table(
        path,
        SAMPLE_COLUMNS.place,
        [SAMPLE_COLUMNS.yaw, *SAMPLE_COLUMNS.derivatives, SAMPLE_COLUMNS.yaw_rate],
    )
    if is_recording:
        _require_times(path, table)
    check_increasing(path, table, "t")
    t = table["t"] - table["t"][0]
    if len(t) < 2:
        raise TableError(
            f"{path}", "one row", "at least two: where it starts and where it ends"
        )
    given = [
        np.column_stack([table[name] for name in group])
        for group in SAMPLE_COLUMNS.derivatives
        if group[0] in table
    ]
    if [group[0] in table for group in SAMPLE_COLUMNS.derivatives] != [
        n < len(given) for n in range(len(SAMPLE_COLUMNS.derivatives))
    ]:
        raise TableError(
            f"{path}",
            "a higher derivative without the lower ones",
            "v; v and a; v, a and j",
        )
    if SAMPLE_COLUMNS.yaw_rate[0] in table and SAMPLE_COLUMNS.yaw[0] not in table:
        raise TableError(
            f"{path}",
            "a column yaw_rate without yaw",
            "yaw and yaw_rate, yaw alone, or neither",
        )
    places = np.column_stack([table[name] for name in SAMPLE_COLUMNS.place[1:]])
    yaws = unwrap_yaws(table.get(SAMPLE_COLUMNS.yaw[0], np.zeros(len(t))), len(t))
    plain = fit_spline(t, places, yaws, degree=3)
    coefficients = plain.coefficients.copy()
    if given:
        coefficients[:, 0:3] = _fit_hermite(t, [places, *given])
    if SAMPLE_COLUMNS.yaw_rate[0] in table:
        coefficients[:, 3:] = _fit_hermite(
            t, [yaws[:, None], table["yaw_rate"][:, None]]
        )
    return Piecewise(coefficients, np.diff(t))


def _require_times(path: str | Path, table: dict[str, Mat]) -> None:
    """Raise ConfigError for times of a recording that are not in s, or that jump."""
    lines = [round(line) for line in table["line"].tolist()]
    times: list[float] = table["t"].tolist()
    require_seconds(path, lines, times, SPARSE_TABLE_ROWS)
    for line, (before, t) in zip(lines[1:], pairwise(times), strict=True):
        require_later(path, line, before, t)


def _fit_hermite(t: Mat, derivatives: list[Mat]) -> Mat:
    """Return the coefficients of the polynomials with given derivatives.

    t: (k,) s
    derivatives: (k, n) each, from the 0th on
    Returns (k - 1, n, 8).
    """
    curve = PPoly.from_bernstein_basis(
        BPoly.from_derivatives(t, np.stack(derivatives, axis=1))
    )
    c = np.asarray(curve.c)[::-1].transpose(1, 2, 0)
    return np.pad(c, [(0, 0), (0, 0), (0, POLYNOMIAL_DEGREE + 1 - c.shape[2])])


def write_pieces(path: str | Path, flight: Piecewise) -> None:
    """Write one piece a row: duration, x^0..x^7, y^0..y^7, z^0..z^7, yaw^0..yaw^7.

    The units are s, m and rad. The time of a piece begins at its start.
    """
    k = len(flight.durations)
    write_table(
        path,
        PIECE_COLUMNS,
        np.column_stack([flight.durations, flight.coefficients.reshape(k, -1)]),
    )


def has_pieces(text: str) -> bool:
    """Return whether the text of a file has pieces: its first column is named duration."""
    return PIECES_START.match(text) is not None


def read_pieces(path: str | Path) -> Piecewise:
    """Return the pieces of a CSV file with the columns of `write_pieces`.

    Raises TableError with file, line and column; also if a piece starts more than 0.01 m or 0.1 m/s
    (rad, rad/s) from the end of the piece before.
    """
    return parse_pieces(read_table_text(path), path)


def parse_pieces(text: str, path: str | Path) -> Piecewise:
    """Apply `read_pieces` to the text of a file; `path` is its name in errors."""
    table = parse_table(text, path, PIECE_COLUMNS)
    short = table["duration"] <= 0.0
    if short.any():
        k = int(np.argmax(short))
        where = f"{path}, line {table['line'][k]:.0f}, column {list(table).index('duration') + 1} (duration)"
        raise TableError(
            where, f"{table['duration'][k]:g}", "a positive number of seconds"
        )
    coefficients = np.column_stack([table[name] for name in PIECE_COLUMNS[1:]]).reshape(
        -1, 4, POLYNOMIAL_DEGREE + 1
    )
    flight = Piecewise(coefficients, table["duration"])
    _check_joints(path, flight, table["line"])
    return flight


def _check_joints(path: str | Path, flight: Piecewise, lines: Mat) -> None:
    """Raise TableError at the first piece that does not join the piece before."""
    for k in range(1, len(lines)):
        two = Piecewise(
            flight.coefficients[k - 1 : k + 1], flight.durations[k - 1 : k + 1]
        )
        for order, (name, most) in enumerate(
            zip(("place", "velocity"), LARGEST_JUMP, strict=True)
        ):
            jump = float(two.jumps[:, order].max())
            if jump > most:
                found = f"a {name} {jump:.3g} off the end of the piece before"
                raise TableError(
                    f"{path}, line {lines[k]:.0f}",
                    found,
                    f"at most {most:g}",
                    "Pieces must join.",
                )
