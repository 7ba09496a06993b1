"""Draw how the errors of open-loop predictions grow with time."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from crazychoir.files.output_files import save_figure
from crazychoir.optimization.picture import PICTURE_STYLE
from crazychoir.simulation.identification.flights import FLIGHT_TIME_STEP
from crazychoir.simulation.identification.scores import OpenLoopErrors

if TYPE_CHECKING:
    from matplotlib.axes import Axes

DRAWN_ERRORS = ((0, "position error [mm]"), (2, "attitude error [deg]"))
"""Columns of the errors that are drawn, and the labels of their axes."""


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
