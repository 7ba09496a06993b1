"""Pictures of the benchmarks for a column of a paper.

Lines differ in colour, dash and mark.
"""

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from statistics import median
from typing import TYPE_CHECKING, Any

from crazychoir.bench.paper.ablation import ABLATION_GRAPHS
from crazychoir.bench.significance import relative_excess
from crazychoir.files.output_files import save_figure
from crazychoir.optimization.picture import PICTURE_STYLE
from crazychoir.recording.analysis.plots import COLUMN_WIDTH, PLOT_STYLE
from crazychoir.routing.distributed.pickup_delivery import PLANNING_METHODS

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

MARKER_SHAPES = "os^vDPX"
PERCENT_TICKS = (0, 1, 2, 5, 10, 20, 50, 100, 200, 500)
"""Ticks in per cent, on a scale that is linear up to 1."""
Rows = list[dict[str, Any]]


@dataclass(frozen=True)
class PlottedQuantity:
    """A quantity of the rows on an axis of a picture."""

    key: str
    """Its name in the rows."""
    scale: float = 1.0
    """Factor from the unit of the rows to the unit of the axis."""
    label: str = ""
    """Label of the axis."""


def draw(
    name: str, height: float, folder: Path, picture: Callable[["Figure"], None]
) -> Path:
    """Draw one picture of a column's width, as PNG; height: inches."""
    import matplotlib as mpl
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    with mpl.rc_context(PLOT_STYLE):
        figure = Figure(figsize=(COLUMN_WIDTH, height), dpi=300, layout="constrained")
        FigureCanvasAgg(figure)
        picture(figure)
        file = folder / f"{name}.png"
        save_figure(figure, file)
    return file


def draw_ablation(rows: Rows, folder: Path) -> list[Path]:
    """Draw loss, size and method, from the rows of `ablation.summary`."""
    of = {
        study: [row for row in rows if row["study"] == study]
        for study in ("loss", "size", "method")
    }
    return [
        draw("loss", 3.4, folder, lambda figure: _draw_loss(figure, of["loss"])),
        draw("size", 4.6, folder, lambda figure: _draw_size(figure, of["size"])),
        draw("method", 3.4, folder, lambda figure: _draw_method(figure, of["method"])),
    ]


def _draw_loss(figure: "Figure", rows: Rows) -> None:
    """Draw communication time and kB a robot over the loss, for independent losses and bursts."""
    axes = figure.subplots(2, 2, sharex=True, sharey="row")
    patterns = [
        ("independent", None),
        ("bursts", next((r["burst"] for r in rows if r["burst"]), None)),
    ]
    loss = PlottedQuantity("loss", 100.0, "loss [%]")
    quantities = [
        PlottedQuantity("communication_s", label="communication [s]"),
        PlottedQuantity("bytes_a_robot", 1e-3, "kB a robot"),
    ]
    for column, (title, burst) in enumerate(patterns):
        here = [row for row in rows if row["burst"] == burst or row["loss"] == 0.0]
        axes[0, column].set_title(title, fontsize=8)
        axes[1, column].set_xlabel(loss.label)
        for line, quantity in enumerate(quantities):
            for graph in _names_in_rows(ABLATION_GRAPHS, here, "graph"):
                _line(axes[line, column], here, ("graph", graph), loss, quantity)
            use_plain_log_ticks(axes[line, column])
            if column == 0:
                axes[line, column].set_ylabel(quantity.label)
    _legend(figure, axes[0, 0])


def _draw_size(figure: "Figure", rows: Rows) -> None:
    """Draw rounds, kB and CPU a robot over the size of the team."""
    axes = figure.subplots(3, 1, sharex=True)
    robots = PlottedQuantity("robots", label="robots")
    quantities = [
        PlottedQuantity("rounds", label="rounds"),
        PlottedQuantity("bytes_a_robot", 1e-3, "kB a robot"),
        PlottedQuantity("cpu_s_a_robot", label="CPU s a robot"),
    ]
    for panel, quantity in zip(axes, quantities, strict=True):
        for graph in _names_in_rows(ABLATION_GRAPHS, rows, "graph"):
            _line(panel, rows, ("graph", graph), robots, quantity)
        panel.set(ylabel=quantity.label, xscale="log")
        use_plain_log_ticks(panel)
    sizes = sorted({row["robots"] for row in rows})
    axes[-1].set_xticks(sizes, [str(n) for n in sizes])
    axes[-1].minorticks_off()
    axes[-1].set_xlabel(robots.label)
    _legend(figure, axes[0])


def _draw_method(figure: "Figure", rows: Rows) -> None:
    """Draw the excess cost over the best method, and the bytes sent, by the size of the team."""
    axes = figure.subplots(2, 1, sharex=True)
    robots = PlottedQuantity("robots", label="robots")
    excess = PlottedQuantity("over", label="median cost over\nthe best [%]")
    sent = PlottedQuantity("bytes_a_robot", 1e-3, "kB a robot")
    best = {
        n: min(r["cost_median"] for r in rows if r["robots"] == n)
        for n in {row["robots"] for row in rows}
    }
    extra = [
        row | {"over_median": 100.0 * (row["cost_median"] / best[row["robots"]] - 1.0)}
        for row in rows
    ]
    for method in _names_in_rows(PLANNING_METHODS, rows, "method"):
        _line(axes[0], extra, ("method", method), robots, excess, quartiles=False)
        _line(axes[1], rows, ("method", method), robots, sent)
    axes[0].set_ylabel(excess.label)
    axes[1].set(ylabel=sent.label, xlabel=robots.label)
    use_plain_log_ticks(axes[1])
    axes[1].set_xticks(sorted(best))
    _legend(figure, axes[0], columns=2)


def draw_routing(rows: Rows, folder: Path) -> list[Path]:
    """Draw anytime curves of a largest instance, and gaps by size, from rows of `bench.routing`."""
    largest = max((row["tasks"] for row in rows), default=0)
    at = min(row["seed"] for row in rows)
    one = [
        row
        for row in rows
        if row["tasks"] == largest and row["seed"] == at and row["curve"]
    ]
    return [
        draw("anytime", 2.4, folder, lambda figure: _draw_anytime(figure, one)),
        draw("solvers", 2.6, folder, lambda figure: _draw_solvers(figure, rows)),
    ]


def _draw_anytime(figure: "Figure", rows: Rows) -> None:
    """Draw the cost of the best plan over time; each line goes on until its solver has ended."""
    axes = figure.add_subplot()
    for number, row in enumerate(rows):
        times, costs = zip(*row["curve"], strict=True)
        ends = max(row["wall_s"] or 0.0, times[-1])
        axes.step(
            [*times, ends],
            [*costs, costs[-1]],
            where="post",
            label=row["name"],
            markersize=2.5,
            markevery=1 + len(times) // 10,
            **_marked_line_style(number),
        )
    if rows:
        axes.set_title(
            f"{rows[0]['robots']} robots, {rows[0]['tasks']} tasks", fontsize=8
        )
        use_plain_log_ticks(axes, "x")
    axes.set(xlabel="time [s]", ylabel="cost [m]")
    _legend(figure, axes)


def _draw_solvers(figure: "Figure", rows: Rows) -> None:
    """Draw the excess cost of each solver over the best plan of the run.

    A point is an instance, a bar the median.
    """
    axes = figure.add_subplot()
    over = _excess_over_best([row for row in rows if row["feasible"]])
    names = list(dict.fromkeys(name for name, _ in over))
    sizes = sorted({tasks for _, tasks in over})
    width = 0.8 / max(len(names), 1)
    for number, name in enumerate(names):
        colour = PICTURE_STYLE.colours[number % len(PICTURE_STYLE.colours)]
        mark = MARKER_SHAPES[number % len(MARKER_SHAPES)]
        of = {
            place: over[name, tasks]
            for place, tasks in enumerate(sizes)
            if (name, tasks) in over
        }
        offset = (number - (len(names) - 1) / 2) * width
        xs = [place + offset for place, values in of.items() for _ in values]
        ys = [value for values in of.values() for value in values]
        axes.plot(xs, ys, mark, markersize=2.5, color=colour, label=name)
        for place, values in of.items():
            at = place + offset
            axes.hlines(
                median(values),
                at - 0.4 * width,
                at + 0.4 * width,
                color=colour,
                linewidth=1.2,
            )
    axes.set_yscale("symlog", linthresh=1.0)
    axes.set_yticks(PERCENT_TICKS, [str(tick) for tick in PERCENT_TICKS])
    axes.set_ylim(
        -0.1, 2.0 * max((max(values) for values in over.values()), default=1.0) + 0.1
    )
    axes.set_xticks(range(len(sizes)), [f"{tasks} tasks" for tasks in sizes])
    axes.set_ylabel("cost over the best [%]")
    _legend(figure, axes, columns=2)


def _excess_over_best(rows: Rows) -> dict[tuple[str, int], list[float]]:
    """Return {(solver, tasks): per cent over the best plan of each instance}."""
    best: dict[tuple[int, int], float] = {}
    for row in rows:
        best[_key(row)] = min(row["cost"], best.get(_key(row), math.inf))
    found: dict[tuple[str, int], list[float]] = {}
    for row in rows:
        found.setdefault((row["name"], row["tasks"]), []).append(
            relative_excess(row["cost"], best[_key(row)])
        )
    return found


def _key(row: dict[str, Any]) -> tuple[int, int]:
    return row["tasks"], row["seed"]


def _line(
    axes: "Axes",
    rows: Rows,
    of: tuple[str, str],
    x: PlottedQuantity,
    y: PlottedQuantity,
    quartiles: bool = True,
) -> None:
    """Draw the medians of the rows with key = value, with a bar from quartile to quartile.

    axes: axes to draw on
    rows: rows of a summary
    of: the key and its value
    x: quantity on the x axis
    y: quantity on the y axis
    quartiles: whether to draw the bars
    """
    key, value = of
    mine = sorted(
        (row for row in rows if row[key] == value), key=lambda row: row[x.key]
    )
    number = [*ABLATION_GRAPHS, *PLANNING_METHODS].index(value) % len(ABLATION_GRAPHS)
    places = [row[x.key] * x.scale for row in mine]
    middle = [row[f"{y.key}_median"] * y.scale for row in mine]
    axes.plot(places, middle, label=value, markersize=2.5, **_marked_line_style(number))
    if quartiles:
        low, high = (
            [row[f"{y.key}_{end}"] * y.scale for row in mine]
            for end in ("lower", "upper")
        )
        axes.vlines(
            places, low, high, color=PICTURE_STYLE.colours[number], linewidth=0.8
        )


def use_plain_log_ticks(axes: "Axes", which: str = "y") -> None:
    """Set a logarithmic scale of x or y with ticks at 1, 2, 5, 10, ... in plain numbers."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullLocator

    axes.set(**{f"{which}scale": "log"})
    axis = axes.yaxis if which == "y" else axes.xaxis
    axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axis.set_minor_locator(NullLocator())
    axis.set_major_formatter(FuncFormatter(lambda value, place: f"{value:g}"))


def _marked_line_style(number: int) -> dict[str, Any]:
    at = number % len(PICTURE_STYLE.colours)
    return {
        "color": PICTURE_STYLE.colours[at],
        "linestyle": PICTURE_STYLE.dashes[at % len(PICTURE_STYLE.dashes)],
        "marker": MARKER_SHAPES[at],
    }


def _names_in_rows(names: Iterable[str], rows: Rows, key: str) -> list[str]:
    there = {row[key] for row in rows}
    return [name for name in names if name in there]


def _legend(figure: "Figure", axes: "Axes", columns: int = 3) -> None:
    handles, labels = axes.get_legend_handles_labels()
    if labels:
        figure.legend(handles, labels, loc="outside upper center", ncols=columns)
