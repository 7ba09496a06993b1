"""A table of runs: medians and quartiles, files, a figure for a paper."""

import csv
from collections.abc import Mapping, Sequence
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from crazychoir.api.sweep_rows import FIRST_FIGURES, Row
from crazychoir.api.table_extra import import_pandas, import_parquet
from crazychoir.errors import ConfigError
from crazychoir.files.output_files import output_file
from crazychoir.types import Vec

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from pandas import DataFrame

SUMMARY_PERCENTILES = {"q1": 25.0, "median": 50.0, "q3": 75.0}
"""Percentiles of a summary, by the end of the name of their column."""
SHOWN_ROWS = 10
"""Rows that a notebook shows."""
SEED_INPUT = "seed"
"""The input over which a summary is taken."""


class Table:
    """A table with a row a run: what the sweep has chosen for it, then the figures of its flight.

    rows: the rows; a figure that a row lacks is None
    inputs: names of the columns that the sweep has chosen

    Attributes:
    columns: names of all columns
    """

    def __init__(
        self, rows: Sequence[Mapping[str, Any]], inputs: Sequence[str]
    ) -> None:
        self.inputs = tuple(inputs)
        self.columns = tuple(dict.fromkeys(name for row in rows for name in row))
        self.rows: list[Row] = [
            {name: row.get(name) for name in self.columns} for row in rows
        ]

    def __len__(self) -> int:
        return len(self.rows)

    def __repr__(self) -> str:
        return f"<Table of {len(self)} rows: {', '.join(self.columns)}>"

    def column(self, name: str) -> list[Any]:
        """Return the values of a column.

        Raises ConfigError if there is no such column.
        """
        self._require(name)
        return [row[name] for row in self.rows]

    @property
    def figures(self) -> list[str]:
        """The columns with figures of flights that are numbers."""
        fixed = (*self.inputs, *FIRST_FIGURES, "drones")
        return [
            name
            for name in self.columns
            if name not in fixed and any(_is_number(row[name]) for row in self.rows)
        ]

    def summary(self, by: str | Sequence[str] | None = None) -> "Table":
        """Return the median and the quartiles of each figure, a row for each combination of inputs.

        For the figure `settling_s` the columns are settling_s_q1, settling_s_median and settling_s_q3,
        over the runs that have this figure. `runs` and `succeeded` are counts.

        by: inputs that the rows differ by; None: all but the seed
        """
        named = [by] if isinstance(by, str) else by
        chosen = [n for n in self.inputs if n != SEED_INPUT] if named is None else named
        groups: dict[tuple[Any, ...], list[Row]] = {}
        for name in chosen:
            self._require(name)
        for row in self.rows:
            key = tuple(row[name] for name in chosen)
            groups.setdefault(key, []).append(row)
        rows = [
            dict(zip(chosen, key, strict=True)) | self._summarise(group)
            for key, group in groups.items()
        ]
        return Table(rows, chosen)

    def _summarise(self, group: Sequence[Row]) -> Row:
        summary: Row = {"runs": len(group)}
        if "success" in self.columns:
            summary["succeeded"] = sum(bool(row["success"]) for row in group)
        for name in self.figures:
            values = _list_numbers(group, name)
            for end, share in SUMMARY_PERCENTILES.items():
                found = float(np.percentile(values, share)) if len(values) else None
                summary[f"{name}_{end}"] = found
        return summary

    def to_csv(self, path: str | Path) -> None:
        """Write the rows to a CSV file; None is an empty cell.

        Raises ConfigError if the file cannot be written.
        """
        with (
            output_file(path, "to_csv") as place,
            place.open("w", encoding="utf-8", newline="") as file,
        ):
            writer = csv.writer(file, lineterminator="\n")
            writer.writerow(self.columns)
            writer.writerows(row.values() for row in self.rows)

    def to_parquet(self, path: str | Path) -> None:
        """Write the rows to a Parquet file.

        Raises ConfigError if pyarrow is not installed, or the file cannot be written.
        """
        arrow, parquet = import_parquet()
        with output_file(path, "to_parquet") as place:
            parquet.write_table(arrow.Table.from_pylist(self.rows), place)

    def frame(self) -> "DataFrame":
        """Return the rows as a table of pandas.

        Raises ConfigError if pandas is not installed.
        """
        pandas = import_pandas()
        frame: DataFrame = pandas.DataFrame(self.rows, columns=list(self.columns))
        return frame

    def plot(self, y: str, x: str | None = None, by: str | None = None) -> "Figure":
        """Return a figure of matplotlib: the median of y over x, with a band between the quartiles.

        y: figure to draw
        x: input; None: the first that is not the seed
        by: input with a line a value; None for one line
        Raises ConfigError for a column that does not exist or has no numbers.
        """
        # Matplotlib takes a while to import.
        from crazychoir.api.table_picture import draw_table

        across = x or next((n for n in self.inputs if n != SEED_INPUT), SEED_INPUT)
        for name in (across, y):
            self._require(name)
            if not any(_is_number(row[name]) for row in self.rows):
                raise ConfigError(
                    "plot", f"no numbers of {name}", "a column of numbers"
                )
        chosen = [across] if by is None else [by, across]
        return draw_table(self.summary(chosen).rows, across, y, by)

    def _require(self, name: str) -> None:
        if name not in self.columns:
            raise ConfigError("column", name, ", ".join(self.columns))

    def _repr_html_(self) -> str:
        """Return the first rows as a table for a notebook."""
        head = "".join(f"<th>{escape(name)}</th>" for name in self.columns)
        shown = "".join(
            "<tr>"
            + "".join(f"<td>{escape(format_value(x))}</td>" for x in row.values())
            + "</tr>"
            for row in self.rows[:SHOWN_ROWS]
        )
        more = len(self) - SHOWN_ROWS
        below = f"<p>and {more} more rows</p>" if more > 0 else ""
        return f"<table><tr>{head}</tr>{shown}</table>{below}"


def format_value(value: Any) -> str:
    """Return a value with four digits; empty for None."""
    if value is None:
        return ""
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _list_numbers(rows: Sequence[Row], name: str) -> Vec:
    return np.array([row[name] for row in rows if _is_number(row[name])], float)
