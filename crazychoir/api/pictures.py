"""Figures of matplotlib that a notebook shows, and that are fit for a paper."""

from collections.abc import Sequence
from io import BytesIO

import matplotlib as mpl
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from crazychoir.errors import ConfigError
from crazychoir.recording.analysis.plots import (
    COLUMN_WIDTH,
    PLOT_STYLE,
    Pictures,
    Reasons,
)

SHOWN_RESOLUTION = 144
"""Resolution of a figure in a notebook, in dots an inch; `savefig` uses that of the figure."""
SAVED_RESOLUTION = 300
"""Resolution of a saved figure, in dots an inch."""


class ShownFigure(Figure):
    """A figure that a notebook shows as the value of a cell, without pyplot."""

    def _repr_png_(self) -> bytes:
        picture = BytesIO()
        self.savefig(picture, format="png", dpi=SHOWN_RESOLUTION)
        return picture.getvalue()


def make_figure(width: float, height: float) -> ShownFigure:
    """Return an empty figure of this size in inches."""
    figure = ShownFigure(
        figsize=(width, height), dpi=SAVED_RESOLUTION, layout="constrained"
    )
    FigureCanvasAgg(figure)
    return figure


def draw_panels(
    pictures: Pictures, missing: Reasons, names: Sequence[str]
) -> ShownFigure:
    """Return a figure with these pictures side by side, each one column of a paper wide.

    pictures: the pictures that can be drawn
    missing: why others cannot be drawn
    names: names of the pictures to draw
    Raises ConfigError for a picture that cannot be drawn.
    """
    for name in names:
        if name not in pictures:
            found = f"{name}: {missing[name]}" if name in missing else name
            raise ConfigError("plot", found, ", ".join(pictures))
    with mpl.rc_context(PLOT_STYLE):
        height = max(pictures[name][0] for name in names)
        figure = make_figure(COLUMN_WIDTH * len(names), height)
        parts = figure.subfigures(1, len(names), squeeze=False)[0]
        for part, name in zip(parts, names, strict=True):
            _, draw = pictures[name]
            draw(part)
    return figure
