"""Hand-drawn strokes: reading, checking, thinning, and splitting at corners."""

import math
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path

import numpy as np
import numpy.typing as npt

from crazychoir.errors import ConfigError
from crazychoir.planning.number_table import TableError, parse_table, read_table
from crazychoir.types import Mat, Vec

STROKE_COLUMNS = ("stroke", "t", "x", "y")
"""Columns of a CSV file of strokes."""

THINNING_SHARE = 0.25
"""Share of the spacing. Points closer than this show the tremor of the hand, not the shape."""
SHARP_TURN = math.radians(80.0)
"""Turn in rad within one spacing that is flown as a stop, not as a bend."""


def read_strokes(path: str | Path) -> list[Mat]:
    """Return the strokes of a CSV file, each (k, 3) rows t s, x, y m.

    The columns are stroke, t, x, y. The rows of a stroke stand together.
    Raises TableError with file, line and column; also if a stroke comes back, or t goes back within
    a stroke.
    """
    return _split_into_strokes(read_table(path, STROKE_COLUMNS), path)


def parse_strokes(text: str, path: str) -> list[Mat]:
    """Apply `read_strokes` to the contents of a file; `path` is its name in errors."""
    return _split_into_strokes(parse_table(text, path, STROKE_COLUMNS), path)


def format_strokes(strokes: Sequence[Mat]) -> str:
    """Return strokes, (k, 3) rows t, x, y, as a text that `parse_strokes` reads."""
    rows = (
        f"{n},{t:.4f},{x:.5f},{y:.5f}"
        for n, stroke in enumerate(strokes)
        for t, x, y in stroke.tolist()
    )
    return "\n".join([",".join(STROKE_COLUMNS), *rows]) + "\n"


def _split_into_strokes(table: dict[str, Mat], path: str | Path) -> list[Mat]:
    """Return the strokes of a table; raise TableError for rows out of order."""
    ids = table["stroke"]
    rows = np.column_stack([table["t"], table["x"], table["y"]])
    starts = np.flatnonzero(np.diff(ids, prepend=np.nan))
    for k in starts.tolist():
        if (ids[:k] == ids[k]).any():
            where = f"{path}, line {table['line'][k]:.0f}, column {list(table).index('stroke') + 1} (stroke)"
            raise TableError(
                where, f"{ids[k]:g} again", "the rows of a stroke one after the other"
            )
    back = (np.diff(table["t"], prepend=-np.inf) < 0.0) & (
        np.diff(ids, prepend=np.nan) == 0.0
    )
    if back.any():
        k = int(np.argmax(back))
        where = f"{path}, line {table['line'][k]:.0f}, column {list(table).index('t') + 1} (t)"
        raise TableError(
            where,
            f"{table['t'][k]:g}",
            f"not before the {table['t'][k - 1]:g} s of the row before",
        )
    return np.split(rows, starts[1:])


def check_stroke(stroke: npt.ArrayLike, where: str) -> tuple[Vec, Mat]:
    """Return times and points of a stroke, without repeated points.

    stroke: (k, 2) rows x, y or (k, 3) rows t, x, y
    where: name in errors
    Returns times (k,) s, zero without t, and points (k, 2) m.
    Raises ConfigError, with `where` and the row, for wrong shapes, numbers that are not finite, or
    times that go back.
    """
    rows = np.asarray(stroke, dtype=float)
    if rows.ndim != 2 or rows.shape[1] not in (2, 3) or len(rows) == 0:
        raise ConfigError(
            where,
            f"shape {rows.shape}",
            "(k, 2): rows of x, y, or (k, 3): rows of t, x, y",
        )
    if not np.isfinite(rows).all():
        k = int(np.argmin(np.isfinite(rows).all(axis=1)))
        raise ConfigError(f"{where}[{k}]", rows[k].tolist(), "finite numbers")
    if rows.shape[1] == 2:
        rows = np.column_stack([np.zeros(len(rows)), rows])
    elif (np.diff(rows[:, 0]) < 0.0).any():
        k = int(np.argmax(np.diff(rows[:, 0]) < 0.0)) + 1
        raise ConfigError(
            f"{where}[{k}]: t",
            float(rows[k, 0]),
            f"not before the {rows[k - 1, 0]:g} s of the last row",
        )
    moved = np.linalg.norm(np.diff(rows[:, 1:], axis=0), axis=1) > 1e-9
    rows = rows[np.concatenate([[True], moved])]
    return rows[:, 0], rows[:, 1:]


def thin_line(xy: Mat, distance: float) -> list[int]:
    """Return the indices of the points of a line that are kept.

    They are the first point, each point at least `distance` m from the kept point before it, and
    the last point.

    xy: (k, 2) m
    distance: m
    """
    kept = [0]
    for i in range(1, len(xy)):
        if math.dist(xy[i], xy[kept[-1]]) >= distance:
            kept.append(i)
    if len(kept) > 1 and math.dist(xy[-1], xy[kept[-1]]) < 0.5 * distance:
        kept.pop()
    return kept if math.dist(xy[-1], xy[kept[-1]]) < 1e-9 else [*kept, len(xy) - 1]


def split_stroke(t: Vec, xy: Mat, spacing: float) -> list[tuple[Vec, Mat]]:
    """Return times (n,) s and points (n, 2) m of each part of the thinned stroke.

    A part ends, and the next one begins, at the point of a sharp turn.
    t: (k,) s
    xy: (k, 2) m
    spacing: m, over which a turn is measured
    """
    kept = thin_line(xy, THINNING_SHARE * spacing)
    cuts = [0, *_find_corners(xy[kept], spacing), len(kept) - 1]
    parts = [kept[a : b + 1] for a, b in pairwise(cuts)]
    return [(t[part], xy[part]) for part in parts]


def fill_line(t: Vec, xy: Mat, distance: float) -> tuple[Vec, Mat]:
    """Return times and points with further points between them, at most `distance` m apart.

    All given points are kept.
    t: (k,) s
    xy: (k, 2) m
    distance: m
    Returns (n,) s and (n, 2) m.
    """
    steps = np.linalg.norm(np.diff(xy, axis=0), axis=1)
    pieces = np.maximum(np.ceil(steps / distance - 1e-9), 1.0)
    last_piece = np.cumsum([0.0, *pieces])
    index = np.arange(len(xy))
    at = np.interp(np.arange(last_piece[-1] + 1.0), last_piece, index)
    places = [np.interp(at, index, xy[:, axis]) for axis in range(2)]
    return np.interp(at, index, t), np.column_stack(places)


def _find_corners(xy: Mat, reach: float) -> list[int]:
    """Return the indices where the line turns by SHARP_TURN or more.

    The turn is measured between the points `reach` m behind and ahead. Near a corner, only the
    sharpest turn within 2 reach counts.
    """
    turns = np.zeros(len(xy))
    for i in range(1, len(xy) - 1):
        far = np.linalg.norm(xy - xy[i], axis=1) >= reach
        behind = np.flatnonzero(far[:i])
        ahead = np.flatnonzero(far[i:])
        if len(behind) and len(ahead):
            a = xy[i] - xy[behind[-1]]
            b = xy[i + ahead[0]] - xy[i]
            turns[i] = abs(math.atan2(a[0] * b[1] - a[1] * b[0], a @ b))
    corners: list[int] = []
    while turns.max(initial=0.0) >= SHARP_TURN:
        sharpest = int(np.argmax(turns))
        corners.append(sharpest)
        turns[np.linalg.norm(xy - xy[sharpest], axis=1) < 2.0 * reach] = 0.0
    return sorted(corners)
