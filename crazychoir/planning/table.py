"""Tables of numbers in CSV files; every complaint names file, line and column."""

import csv
import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from crazychoir.errors import ConfigError
from crazychoir.math3d import Mat

CSV = "a readable CSV file, UTF-8"


class TableError(ConfigError):
    """A CSV file of numbers is wrong: file, line, column."""


def read_table(path: str | Path, required: Sequence[str], optional: Sequence[Sequence[str]] = ()) -> dict[str, Mat]:
    """Columns of the CSV file by name, each (k,), and "line" (k,), where each row stands.

    The first line names the columns, in any order and in small letters or capitals; `required` ones must be there, of
    each group of `optional` ones all or none. Empty lines and an empty last column are left out.
    Errors: TableError.
    """
    try:
        text = Path(path).read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        raise TableError(f"{path}", f"{error}", CSV) from error
    return parse_table(text, path, required, optional)


def parse_table(
    text: str, path: str | Path, required: Sequence[str], optional: Sequence[Sequence[str]] = ()
) -> dict[str, Mat]:
    """`read_table` of what a file contains; path: what errors call it."""
    lines = _lines(text, path)
    head = [name.strip().lstrip("# ").lower() for name in lines[0][1]]
    _check_head(path, lines[0][0], head, required, optional)
    rows = [_numbers(path, number, head, cells) for number, cells in lines[1:]]
    if not rows:
        raise TableError(f"{path}", "no row of numbers", "at least one row below the names of the columns")
    table = dict(zip(head, np.array(rows).T, strict=True))
    return table | {"line": np.array([float(number) for number, _ in lines[1:]])}


def _lines(text: str, path: str | Path) -> list[tuple[int, list[str]]]:
    """(number of the line, its cells), without empty lines and trailing empty cells."""
    try:
        reader = csv.reader(text.splitlines(keepends=True))
        lines = [(reader.line_num, cells[:-1] if not cells[-1].strip() else cells) for cells in reader if cells]
    except csv.Error as error:
        raise TableError(f"{path}", f"{error}", CSV) from error
    if not lines:
        raise TableError(f"{path}", "an empty file", "a line with the names of the columns, then rows of numbers")
    return [(number, cells) for number, cells in lines if cells]


def _check_head(
    path: str | Path, line: int, head: list[str], required: Sequence[str], optional: Sequence[Sequence[str]]
) -> None:
    known = [*required, *(name for group in optional for name in group)]
    for column, name in enumerate(head, 1):
        if name not in known or head.index(name) != column - 1:
            allowed = f"each of {', '.join(known)} once"
            raise TableError(f"{path}, line {line}, column {column}", repr(name), allowed)
    for group in (required, *(group for group in optional if any(name in head for name in group))):
        missing = [name for name in group if name not in head]
        if missing:
            raise TableError(f"{path}, line {line}", f"no column {', '.join(missing)}", f"{', '.join(group)}")


def _numbers(path: str | Path, line: int, head: list[str], cells: list[str]) -> list[float]:
    if len(cells) != len(head):
        raise TableError(f"{path}, line {line}", f"{len(cells)} columns", f"{len(head)}, as in the first line")
    named = enumerate(zip(head, cells, strict=True), 1)
    return [_number(path, line, column, name, cell) for column, (name, cell) in named]


def _number(path: str | Path, line: int, column: int, name: str, cell: str) -> float:
    try:
        value = float(cell)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise TableError(f"{path}, line {line}, column {column} ({name})", repr(cell), "a finite number")
    return value


def check_increasing(path: str | Path, table: dict[str, Mat], name: str) -> None:
    """Raise a TableError at the first row whose value in the column is not above that of the row before."""
    steps = np.diff(table[name]) > 0.0
    if not steps.all():
        k = int(np.argmin(steps)) + 1
        where = f"{path}, line {table['line'][k]:.0f}, column {list(table).index(name) + 1} ({name})"
        raise TableError(where, f"{table[name][k]:g}", f"more than the {table[name][k - 1]:g} of the row before")


def write_table(path: str | Path, columns: Sequence[str], rows: Mat) -> None:
    """The rows (k, n) under their names (n,), each number to its last digit."""
    with open(path, "w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(columns)
        writer.writerows(rows.tolist())
