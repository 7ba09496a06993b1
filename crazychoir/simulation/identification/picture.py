"""Draw how the errors of open-loop predictions grow with time, and flights in closed loop from above."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from crazychoir.files.output_files import save_figure
from crazychoir.optimization.picture import PICTURE_STYLE
from crazychoir.simulation.identification.closed_loop import FlownAgain
from crazychoir.simulation.identification.flights import FLIGHT_TIME_STEP
from crazychoir.simulation.identification.scores import OpenLoopErrors

if TYPE_CHECKING:
    from matplotlib.axes import Axes

DRAWN_ERRORS = ((0, "position error [mm]"), (2, "attitude error [deg]"))
"""Columns of the errors that are drawn, and the labels of their axes."""
PATHS_A_ROW = 4
"""Flights side by side in a picture of paths."""


def draw_errors(path: Path, scored: Sequence[OpenLoopErrors], title: str) -> None:
    """Write a picture of the RMSE of position and attitude over the time ahead, a line a model.

    Raises ConfigError if the file cannot be written.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(7.2, 4.4), dpi=200, layout="constrained")
    FigureCanvasAgg(figure)
    for axes, (column, label) in zip(figure.subplots(1, 2), DRAWN_ERRORS, strict=True):
        _draw_column(axes, scored, column)
        axes.set_ylabel(label)
    handles, labels = figure.axes[0].get_legend_handles_labels()
    figure.legend(
        handles, labels, loc="outside lower center", ncols=2, frameon=False, fontsize=8
    )
    figure.suptitle(title, color=PICTURE_STYLE.ink, fontsize=10, parse_math=False)
    save_figure(figure, path)


def draw_paths(path: Path, flown: Sequence[FlownAgain]) -> None:
    """Write a picture of each flight in the air from above: set-points, recorded and simulated path.

    Raises ConfigError if the file cannot be written.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    lines = -(-len(flown) // PATHS_A_ROW)
    columns = min(len(flown), PATHS_A_ROW)
    figure = Figure(
        figsize=(2.4 * columns, 2.5 * lines + 0.5), dpi=200, layout="constrained"
    )
    FigureCanvasAgg(figure)
    grid = figure.subplots(lines, columns, squeeze=False)
    for axes in grid.flat[len(flown) :]:
        axes.set_axis_off()
    for axes, one in zip(grid.flat, flown, strict=False):
        _draw_path(axes, one)
    handles, labels = grid.flat[0].get_legend_handles_labels()
    figure.legend(
        handles, labels, loc="outside lower center", ncols=3, frameon=False, fontsize=8
    )
    save_figure(figure, path)


def _draw_path(axes: "Axes", flown: FlownAgain) -> None:
    a, b = flown.flight.airborne
    lines = (
        ("set-points", flown.setpoints, "#b0b0b0"),
        ("recorded", flown.flight.p, PICTURE_STYLE.colours[0]),
        ("simulated", flown.states, PICTURE_STYLE.colours[1]),
    )
    for label, places, colour in lines:
        axes.plot(
            places[a:b, 0], places[a:b, 1], color=colour, linewidth=0.7, label=label
        )
    axes.set_aspect("equal", adjustable="datalim")
    axes.set_title(flown.flight.name, fontsize=6, parse_math=False)
    axes.tick_params(labelsize=6)
    axes.spines[["top", "right"]].set_visible(False)


def _draw_column(axes: "Axes", scored: Sequence[OpenLoopErrors], column: int) -> None:
    for number, errors in enumerate(scored):
        rows = np.arange(1, errors.errors.shape[1])
        axes.semilogy(
            rows * FLIGHT_TIME_STEP,
            [errors.rmse(int(row))[column] for row in rows],
            color=PICTURE_STYLE.colours[number % len(PICTURE_STYLE.colours)],
            linestyle=PICTURE_STYLE.dashes[number % len(PICTURE_STYLE.dashes)],
            linewidth=1.2,
            label=errors.model,
        )
    axes.grid(color="#e6e6e6", linewidth=0.6)
    axes.set_axisbelow(True)
    axes.spines[["top", "right"]].set_visible(False)
    axes.set_xlabel("time ahead [s]")
