"""Pictures of the comparison over two columns of a paper, as PNG and PDF."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from crazychoir.bench.convergence.study import Case, CaseResult
from crazychoir.bench.paper.pictures import MARKER_SHAPES, use_plain_log_ticks
from crazychoir.optimization.picture import PICTURE_STYLE
from crazychoir.recording.analysis.plots import COLUMN_WIDTH, Pictures, draw

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

PAGE_WIDTH: Final = 2.0 * COLUMN_WIDTH + 0.16
"""Width of both columns and the gap between them, inches."""
MARKS_A_LINE: Final = 8
"""Marks on a line of the first picture."""
LEGEND_COLUMNS: Final = 5
LEAST_DRAWN_ERROR: Final = 1e-13
"""Lower end of the axis of the error: the rest is rounding."""


@dataclass(frozen=True)
class DrawnEffort:
    """A figure of an effort on an axis."""

    key: str
    """Its name in the rows."""
    scale: float
    """Factor from the unit of the rows to the unit of the axis."""
    label: str
    """Label of the axis."""


DRAWN_EFFORTS: Final = (
    DrawnEffort("rounds", 1.0, "rounds"),
    DrawnEffort("messages_an_agent", 1.0, "messages an agent"),
    DrawnEffort("bytes_an_agent", 1e-3, "kB an agent"),
)


def draw_comparison(
    results: Sequence[CaseResult],
    rows: Sequence[dict[str, Any]],
    accuracy: float,
    folder: Path,
) -> list[Path]:
    """Draw the errors of the first case, and the efforts over loss, graph and size.

    results: all results
    rows: their rows of `summarise`
    accuracy: relative error that the efforts reach
    folder: folder of the files
    Returns the files.
    """
    base = results[0].case
    first = [result for result in results if result.case == base]
    pictures: Pictures = {"error": (2.7, partial(_draw_errors, results=first))}
    axes = _list_varied(base, [result.case for result in results])
    if axes:
        height = 0.6 + 1.5 * len(DRAWN_EFFORTS)
        fill = partial(
            _draw_efforts, results=results, rows=rows, varied=axes, accuracy=accuracy
        )
        pictures["effort"] = (height, fill)
    return draw(pictures, folder)


def _draw_errors(figure: "Figure", results: Sequence[CaseResult]) -> None:
    """Draw the error over rounds, messages and bytes: median, and a band between quartiles."""
    figure.set_size_inches(PAGE_WIDTH, figure.get_figheight())
    axes = figure.subplots(1, len(DRAWN_EFFORTS), sharey=True)
    for number, result in enumerate(results):
        rounds = result.list_rounds()
        middle = _column(rounds, "error_median")
        low = _column(rounds, "error_lower")
        high = _column(rounds, "error_upper")
        style = line_style(number)
        every = max(1, len(rounds) // MARKS_A_LINE)
        shift = number * every // max(1, len(results))
        for panel, effort in zip(axes, DRAWN_EFFORTS, strict=True):
            key = "round" if effort.key == "rounds" else effort.key
            at = effort.scale * _column(rounds, key)
            panel.semilogy(
                at,
                middle,
                label=result.contender.label,
                markersize=3.0,
                markevery=(shift, every),
                **style,
            )
            panel.fill_between(
                at, low, high, color=style["color"], alpha=0.15, linewidth=0.0
            )
    for panel, effort in zip(axes, DRAWN_EFFORTS, strict=True):
        panel.set_xlabel(effort.label)
        panel.set_xlim(left=0.0)
    _limit_errors(axes[0], results)
    axes[0].set_ylabel("relative error")
    _add_legend(figure, axes[0])


def _limit_errors(axes: "Axes", results: Sequence[CaseResult]) -> None:
    """Show errors from rounding up to a little above the start, also where a line diverges."""
    least = min(
        (float(np.nanmin(result.error_quartiles()[1])) for result in results),
        default=1.0,
    )
    axes.set_ylim(max(LEAST_DRAWN_ERROR, 0.3 * min(least, 0.1)), 5.0)


def _list_varied(base: Case, cases: Iterable[Case]) -> dict[str, list[Case]]:
    """Return the cases that differ from the base in one part alone, with the base, by this part."""
    found = {}
    for part in ("loss", "graph", "agents"):
        mine = [
            case for case in dict.fromkeys(cases) if _is_variation(base, case, part)
        ]
        if len(mine) > 1:
            found[part] = mine
    return found


def _is_variation(base: Case, case: Case, part: str) -> bool:
    others = {"loss", "graph", "agents"} - {part}
    return all(getattr(base, other) == getattr(case, other) for other in others)


def _draw_efforts(
    figure: "Figure",
    results: Sequence[CaseResult],
    rows: Sequence[dict[str, Any]],
    varied: dict[str, list[Case]],
    accuracy: float,
) -> None:
    """Draw rounds, messages and bytes until the accuracy, over what was varied."""
    figure.set_size_inches(PAGE_WIDTH, figure.get_figheight())
    panels = figure.subplots(
        len(DRAWN_EFFORTS), len(varied), sharex="col", sharey="row", squeeze=False
    )
    labels = {result.contender.name: result.contender.label for result in results}
    for column, (part, cases) in enumerate(varied.items()):
        ordered = cases if part == "graph" else sorted(cases, key=_reader(part))
        places = _place(part, ordered)
        for number, (name, label) in enumerate(labels.items()):
            mine = {
                result.case: row
                for result, row in zip(results, rows, strict=True)
                if result.contender.name == name
            }
            for line, effort in enumerate(DRAWN_EFFORTS):
                values = [mine[case][f"{effort.key}_median"] for case in ordered]
                heights = [np.nan if v is None else effort.scale * v for v in values]
                panels[line, column].plot(
                    places, heights, label=label, markersize=3.0, **line_style(number)
                )
        ticks = [_describe(part, case) for case in ordered]
        panels[-1, column].set_xticks(places, ticks)
        panels[-1, column].set_xlabel(
            {"loss": "loss [%]", "graph": "graph", "agents": "agents"}[part]
        )
        panels[-1, column].margins(x=0.12)
    for line, effort in enumerate(DRAWN_EFFORTS):
        panels[line, 0].set_ylabel(f"{effort.label}\nuntil error {accuracy:g}")
        use_plain_log_ticks(panels[line, 0])
    _add_legend(figure, panels[0, 0])


def _reader(part: str) -> Callable[[Case], Any]:
    return lambda case: getattr(case, part)


def _place(part: str, cases: Sequence[Case]) -> list[float]:
    """Return the places on the axis: the loss itself, or one place after the other."""
    if part == "loss":
        return [100.0 * case.loss for case in cases]
    return [float(place) for place in range(len(cases))]


def _describe(part: str, case: Case) -> str:
    if part == "loss":
        return f"{100.0 * case.loss:g}"
    return str(getattr(case, part))


def _column(rows: Sequence[dict[str, Any]], key: str) -> Any:
    return np.array([row[key] for row in rows], dtype=float)


def line_style(number: int) -> dict[str, Any]:
    """Return colour, dash and mark of a line; 28 lines have styles of their own."""
    colours = PICTURE_STYLE.colours
    dashes = PICTURE_STYLE.dashes
    return {
        "color": colours[number % len(colours)],
        "linestyle": dashes[number % len(dashes)],
        "marker": MARKER_SHAPES[(number + number // len(colours)) % len(MARKER_SHAPES)],
    }


def _add_legend(figure: "Figure", axes: "Axes") -> None:
    handles, labels = axes.get_legend_handles_labels()
    columns = min(LEGEND_COLUMNS, len(labels))
    figure.legend(handles, labels, loc="outside upper center", ncols=columns)
