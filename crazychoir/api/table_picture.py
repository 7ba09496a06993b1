"""The picture of a table: medians over an input, with bands between the quartiles."""

from collections.abc import Sequence
from typing import Any

import matplotlib as mpl

from crazychoir.api.pictures import ShownFigure, make_figure
from crazychoir.api.sweep_rows import Row
from crazychoir.recording.analysis.plots import COLUMN_WIDTH, PLOT_STYLE, line_styles

PICTURE_HEIGHT = 2.4
"""Height of the picture, in inches."""
BAND_OPACITY = 0.18
"""Opacity of the band between the quartiles, 0 to 1."""
COLUMN_UNITS = {"_m_s": "m/s", "_m": "m", "_s": "s"}
"""Unit of a column, by the end of its name."""
LINE_MARKS = "os^Dv<>"
"""Marks of the medians, a letter a line."""


def draw_table(summary: Sequence[Row], x: str, y: str, by: str | None) -> ShownFigure:
    """Return the figure of the medians and quartiles of y over x.

    summary: medians and quartiles, a row for each x and each value of `by`
    by: input with a line a value; None for one line
    """
    lines = list(dict.fromkeys(row.get(by) if by else None for row in summary))
    with mpl.rc_context(PLOT_STYLE):
        figure = make_figure(COLUMN_WIDTH, PICTURE_HEIGHT)
        axes = figure.add_subplot()
        for number, (value, style) in enumerate(
            zip(lines, line_styles(len(lines)), strict=True)
        ):
            rows = [row for row in summary if by is None or row[by] == value]
            label = None if by is None else f"{by} {value}"
            _draw_line(axes, rows, x, y, style | {"label": label}, number)
        axes.set_xlabel(write_label(x))
        axes.set_ylabel(write_label(y))
        if by is not None:
            figure.legend(loc="outside upper center", ncols=3)
    return figure


def _draw_line(
    axes: Any,
    rows: list[dict[str, Any]],
    x: str,
    y: str,
    style: dict[str, Any],
    number: int,
) -> None:
    """Draw the medians of one line, and the band between its quartiles.

    rows: medians and quartiles, those without a median are left out
    number: number of the line, for its mark
    """
    known = sorted(
        (row for row in rows if row[f"{y}_median"] is not None),
        key=lambda row: float(row[x]),
    )
    at = [row[x] for row in known]
    medians = [row[f"{y}_median"] for row in known]
    lower = [row[f"{y}_q1"] for row in known]
    upper = [row[f"{y}_q3"] for row in known]
    axes.fill_between(
        at, lower, upper, color=style["color"], alpha=BAND_OPACITY, linewidth=0.0
    )
    axes.plot(
        at,
        medians,
        marker=LINE_MARKS[number % len(LINE_MARKS)],
        markersize=3.5,
        **style,
    )


def write_label(name: str) -> str:
    """Return the name of a column as the label of an axis: "settling_s" is "settling [s]"."""
    for suffix, unit in COLUMN_UNITS.items():
        if name.endswith(suffix):
            return f"{name.removesuffix(suffix).replace('_', ' ')} [{unit}]"
    return name.replace("_", " ")
