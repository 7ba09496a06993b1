"""Draw how a team converges, as a picture for a page or a paper."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from crazychoir.errors import ConfigError
from crazychoir.files.output_files import save_figure
from crazychoir.files.path_texts import make_readable
from crazychoir.types import Vec

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


@dataclass(frozen=True, slots=True)
class PictureStyle:
    """Colours and lines of all pictures."""

    colours: tuple[str, ...] = (
        "#0072B2",
        "#D55E00",
        "#009E73",
        "#CC79A7",
        "#E69F00",
        "#56B4E9",
        "#000000",
    )
    """Colours of Okabe and Ito, which differ for every kind of colour vision.

    The dashes of the lines carry the same information.
    """
    dashes: tuple[Any, ...] = ("-", (0, (5, 2)), (0, (1, 1.2)), (0, (5, 1.5, 1, 1.5)))
    """Line styles of the entries."""
    ink: str = "#303030"
    """Colour of the title."""


PICTURE_STYLE = PictureStyle()


CONVERGENCE_SIZE = (6.4, 5.2)
"""Width and height of the picture, in inches."""
MOST_DRAWN_ENTRIES = 4
"""Number of entries of x that are drawn."""


def draw_convergence(
    series: Mapping[int, Any],
    path: str | Path,
    name: str,
    title: str = "",
    times: Mapping[int, Vec] | None = None,
    common: bool = True,
) -> None:
    """Write a picture of the convergence; the suffix of `path` decides the format, such as PNG.

    The upper part shows the entries of x of each agent. The lower part shows, on a logarithmic
    axis, the distance of each agent from the team's mean at the end.

    series: {agent: (K+1, ...)}
    path: file to write
    name: name of the value
    title: title of the picture
    times: {agent: (K+1,) s}, abscissa for agents that are not in step; None for rounds
    common: True if the agents are to agree; else the lower part shows the distance of each agent
        from its own last value
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=CONVERGENCE_SIZE, dpi=200, layout="constrained")
    FigureCanvasAgg(figure)
    fill_convergence(figure, series, name, title, times, common)
    save_figure(figure, path, bbox_inches="tight")


def fill_convergence(
    figure: "Figure",
    series: Mapping[int, Any],
    name: str,
    title: str = "",
    times: Mapping[int, Vec] | None = None,
    common: bool = True,
) -> None:
    """Draw the picture of `draw_convergence` into an empty figure."""
    x = {i: _stack_entries(i, name, values) for i, values in series.items()}
    at = times or {i: np.arange(len(values), dtype=float) for i, values in x.items()}
    above, below = figure.subplots(2, 1, sharex=True)
    _draw_entries(above, x, at, name)
    _draw_distances(below, x, at, common)
    below.set_xlabel("time [s]" if times else "round")
    for axes in (above, below):
        axes.grid(color="#e6e6e6", linewidth=0.6)
        axes.set_axisbelow(True)
        axes.spines[["top", "right"]].set_visible(False)
    figure.suptitle(
        make_readable(title), color=PICTURE_STYLE.ink, fontsize=10, parse_math=False
    )


def _stack_entries(i: int, name: str, values: Any) -> Vec:
    """Return the values of agent i as an array (K+1, entries)."""
    if not isinstance(values, np.ndarray) or values.dtype.kind not in "fiub":
        raise ConfigError(
            f"picture: {name} of agent {i}",
            "no numbers of one shape",
            "an array, to draw it",
        )
    return values.reshape(len(values), -1).astype(float)


def _draw_entries(
    axes: "Axes", x: Mapping[int, Vec], at: Mapping[int, Vec], name: str
) -> None:
    for i, values in x.items():
        for n in range(min(values.shape[1], MOST_DRAWN_ENTRIES)):
            label = None
            if i == min(x):
                label = f"{name}[{n}]" if values.shape[1] > 1 else name
            axes.plot(
                at[i],
                values[:, n],
                color=PICTURE_STYLE.colours[n],
                linestyle=PICTURE_STYLE.dashes[n],
                linewidth=0.9,
                alpha=0.8,
                label=label,
            )
    axes.set_ylabel(f"{name} of each agent")
    axes.legend(frameon=False, fontsize=8, ncols=MOST_DRAWN_ENTRIES)


def _draw_distances(
    axes: "Axes", x: Mapping[int, Vec], at: Mapping[int, Vec], common: bool
) -> None:
    """Draw the distances from the mean of all last values.

    If the agents need not agree, draw each agent's distance from its own last value.
    """
    sizes = {values.shape[1] for values in x.values()}
    mean = (
        np.mean([values[-1] for values in x.values()], axis=0)
        if common and len(sizes) == 1
        else None
    )
    for i, values in x.items():
        distance = np.abs(values - (values[-1] if mean is None else mean)).max(axis=1)
        distance[distance == 0.0] = np.nan
        colour = PICTURE_STYLE.colours[i % len(PICTURE_STYLE.colours)]
        axes.semilogy(
            at[i],
            distance,
            color=colour,
            linestyle=PICTURE_STYLE.dashes[i % len(PICTURE_STYLE.dashes)],
            linewidth=0.9,
        )
    what = "its own end" if mean is None else "the mean at the end"
    axes.set_ylabel(f"distance from\n{what}")
