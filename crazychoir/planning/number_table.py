"""Tables of numbers in CSV files; each error names file, line and column."""

import codecs
import csv
import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from crazychoir.errors import ConfigError
from crazychoir.files.examples import describe_shipped_file
from crazychoir.types import Mat

READABLE_CSV_TEXT = "a readable CSV file, UTF-8"
"""Text for what is allowed."""
COLUMN_UNITS = (
    "s",
    "m",
    "rad",
    "m/s",
    "rad/s",
    "m/s^2",
    "m/s2",
    "m/s²",
    "m/s^3",
    "m/s3",
    "m/s³",
)
"""Units that may follow the name of a column; numbers are never converted."""
COLUMN_ALIASES = {"time": "t"}
"""Other names of columns."""


@dataclass(frozen=True, slots=True)
class _TablePatterns:
    """Patterns of a CSV file of numbers."""

    line_end: re.Pattern[str] = re.compile(r"\r\n|\r|\n")
    """The end of a line."""
    separator_line: re.Pattern[str] = re.compile(r"\s*\"?sep=([,;\t])\"?\s*\Z")
    """a line that declares the separator, as Excel writes it."""
    name_and_unit: re.Pattern[str] = re.compile(
        r"([^\[\](){}]*)[\[(]([^\[\](){}]*)[\])]"
    )
    """The name of a column with its unit in brackets."""
    number: re.Pattern[str] = re.compile(
        r"\s*[-+]?(?:[0-9]+(?:[.,][0-9]*)?|[.,][0-9]+)(?:[eE][-+]?[0-9]+)?\s*\Z"
    )
    """a number with a point or a comma."""


_TABLE_PATTERNS = _TablePatterns()


TableLine = tuple[int, list[str]]
"""The number of a line, and its cells."""


class TableError(ConfigError):
    """An error in a CSV file of numbers, with file, line and column."""


def read_table(
    path: str | Path, required: Sequence[str], optional: Sequence[Sequence[str]] = ()
) -> dict[str, Mat]:
    """Return the columns of a CSV file by name, each (k,), and "line" (k,): the line of each row.

    The first line names the columns, in any order, in small letters or capitals. A name may be
    followed by its unit, x [m]. Empty lines, an empty last column, and the text after a # are
    ignored. A comment that names the columns is taken for the first line if numbers follow. Columns
    are separated by commas, semicolons, tabs or blanks, as the names are. Decimals may have a comma
    if columns are not separated by commas. The text is UTF-8, UTF-16 with a byte-order mark, or
    Latin-1.

    path: of the file
    required: columns that must be there
    optional: groups of columns; of each group all or none are there
    Raises TableError for a file that cannot be read so.
    """
    return parse_table(read_table_text(path), path, required, optional)


def read_table_text(path: str | Path) -> str:
    """Return the text of a CSV file; raise TableError for a file that cannot be read."""
    try:
        return _decode_text(Path(path).read_bytes())
    except (OSError, ValueError) as error:
        do = describe_shipped_file(Path(path).name)
        raise TableError(f"{path}", f"{error}", READABLE_CSV_TEXT, do) from error


def parse_table(
    text: str,
    path: str | Path,
    required: Sequence[str],
    optional: Sequence[Sequence[str]] = (),
) -> dict[str, Mat]:
    """Apply `read_table` to the contents of a file; `path` is its name in errors."""
    try:
        (first, names), rows = _split_lines(text.removeprefix("\ufeff"), path, required)
    except csv.Error as error:
        raise TableError(f"{path}", f"{error}", READABLE_CSV_TEXT) from error
    head = [
        _parse_column(path, first, column, name) for column, name in enumerate(names, 1)
    ]
    _check_head(path, first, head, required, optional)
    if not rows:
        raise TableError(
            f"{path}",
            "no row of numbers",
            "at least one row below the names of the columns",
        )
    _check_decimals(path, head, rows)
    numbers = [_parse_row_numbers(path, number, head, cells) for number, cells in rows]
    table = dict(zip(head, np.array(numbers).T, strict=True))
    return table | {"line": np.array([float(number) for number, _ in rows])}


def _decode_text(raw: bytes) -> str:
    """Return the text of a file.

    Latin-1 is taken if nothing else fits, for comments: numbers and names are ASCII.
    """
    if raw.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        return raw.decode("utf-16")
    try:
        return raw.decode("utf-8-sig")
    except UnicodeDecodeError:
        if b"\0" in raw:
            raise
        return raw.decode("latin-1")


def _split_lines(
    text: str, path: str | Path, required: Sequence[str]
) -> tuple[TableLine, list[TableLine]]:
    """Return the line of names and the lines of numbers, cut into cells."""
    separator = ""
    comments: list[tuple[int, str]] = []
    head: TableLine | None = None
    rows: list[TableLine] = []
    for number, written in enumerate(_TABLE_PATTERNS.line_end.split(text), 1):
        line, _, comment = written.partition("#")
        if not line.strip(" \t,;"):
            comments.append((number, comment))
        elif head is None and (declared := _TABLE_PATTERNS.separator_line.match(line)):
            separator = declared[1]
        elif head is None and not all(
            map(_is_number, _split_cells(line, separator or _find_separator(line)))
        ):
            separator = separator or _find_separator(line)
            head = (number, _split_cells(line, separator))
        else:
            if head is None:
                head = _find_head(comments, required)
                if head is None:
                    allowed = f"first a line with the names of the columns: {', '.join(required)}"
                    raise TableError(
                        f"{path}, line {number}", "numbers without names", allowed
                    )
                separator = separator or _find_separator(line)
            rows.append((number, _split_row(line, separator, len(head[1]))))
    if head is None:
        raise TableError(
            f"{path}",
            "an empty file",
            "a line with the names of the columns, then rows of numbers",
        )
    return head, rows


def _find_head(
    comments: list[tuple[int, str]], required: Sequence[str]
) -> TableLine | None:
    """Return the last comment that names all required columns; None if there is none."""
    for number, comment in reversed(comments):
        names = _split_cells(comment, _find_separator(comment))
        if {_split_name_and_unit(name)[0] for name in names} >= set(required):
            return number, names
    return None


def _find_separator(line: str) -> str:
    """Return the separator of the cells of a line; a blank stands for any number of blanks."""
    return next((mark for mark in (";", "\t", ",") if mark in line.strip()), " ")


def _split_row(line: str, separator: str, columns: int) -> list[str]:
    """Return the cells of a row; an empty last one counts where the row has no more cells than columns."""
    cells = _split_cells(line, separator)
    ends_empty = separator != " " and line.rstrip().endswith(separator)
    return [*cells, ""] if ends_empty and len(cells) == columns - 1 else cells


def _split_cells(line: str, separator: str) -> list[str]:
    """Return the cells of a line, without an empty last cell."""
    if separator == " ":
        return line.split()
    cells = [cell.strip() for cell in next(csv.reader([line], delimiter=separator))]
    return cells if cells[-1] else cells[:-1]


def _parse_column(path: str | Path, line: int, column: int, written: str) -> str:
    """Return the name of a column in small letters, without its unit."""
    name, unit = _split_name_and_unit(written)
    if unit and unit not in COLUMN_UNITS:
        raise TableError(
            f"{path}, line {line}, column {column}",
            repr(written),
            f"units: {', '.join(COLUMN_UNITS)}",
        )
    return name


def _split_name_and_unit(written: str) -> tuple[str, str]:
    """Return the parts of x [m]; the unit is empty if there is none."""
    found = _TABLE_PATTERNS.name_and_unit.fullmatch(written.lower().strip())
    name = (found[1] if found else written.lower()).strip()
    return COLUMN_ALIASES.get(name, name), found[2].strip() if found else ""


def _check_decimals(path: str | Path, head: list[str], rows: list[TableLine]) -> None:
    """Raise TableError if some decimals have a comma and others a point."""
    has_point = any("." in cell for _, cells in rows for cell in cells)
    for line, cells in rows if has_point else ():
        for column, (name, cell) in enumerate(zip(head, cells, strict=False), 1):
            if "," in cell:
                where = f"{path}, line {line}, column {column} ({name})"
                raise TableError(
                    where, repr(cell), "a point in each number, or a comma in each"
                )


def _is_number(cell: str) -> bool:
    """Return whether a cell is a number."""
    return _TABLE_PATTERNS.number.match(cell) is not None


def _check_head(
    path: str | Path,
    line: int,
    head: list[str],
    required: Sequence[str],
    optional: Sequence[Sequence[str]],
) -> None:
    """Raise TableError for an unknown, repeated or missing column."""
    known = [*required, *(name for group in optional for name in group)]
    for column, name in enumerate(head, 1):
        if name not in known or head.index(name) != column - 1:
            allowed = f"each of {', '.join(known)} once"
            raise TableError(
                f"{path}, line {line}, column {column}", repr(name), allowed
            )
    for group in (
        required,
        *(group for group in optional if any(name in head for name in group)),
    ):
        missing = [name for name in group if name not in head]
        if missing:
            raise TableError(
                f"{path}, line {line}",
                f"no column {', '.join(missing)}",
                f"{', '.join(group)}",
            )


def _parse_row_numbers(
    path: str | Path, line: int, head: list[str], cells: list[str]
) -> list[float]:
    """Return the numbers of a row."""
    if len(cells) != len(head):
        do = (
            "Separate columns by semicolons if decimals have a comma."
            if len(cells) > len(head)
            else ""
        )
        raise TableError(
            f"{path}, line {line}",
            f"{len(cells)} columns",
            f"{len(head)}, as in the line of names",
            do,
        )
    named = enumerate(zip(head, cells, strict=True), 1)
    return [
        _parse_number(path, line, column, name, cell) for column, (name, cell) in named
    ]


def _parse_number(
    path: str | Path, line: int, column: int, name: str, cell: str
) -> float:
    """Return the number in a cell; raise TableError if it is not finite."""
    value = float(cell.replace(",", ".")) if _is_number(cell) else math.nan
    if not math.isfinite(value):
        raise TableError(
            f"{path}, line {line}, column {column} ({name})",
            repr(cell),
            "a finite number",
        )
    return value


def check_increasing(path: str | Path, table: dict[str, Mat], name: str) -> None:
    """Raise TableError at the first row with a value not above the row before.

    name: of the column
    """
    steps = np.diff(table[name]) > 0.0
    if not steps.all():
        k = int(np.argmin(steps)) + 1
        where = f"{path}, line {table['line'][k]:.0f}, column {list(table).index(name) + 1} ({name})"
        raise TableError(
            where,
            f"{table[name][k]:g}",
            f"more than the {table[name][k - 1]:g} of the row before",
        )


def write_table(path: str | Path, columns: Sequence[str], rows: Mat) -> None:
    """Write rows (k, n) under their names (n,), each number to its last digit."""
    with open(path, "w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(columns)
        writer.writerows(rows.tolist())
