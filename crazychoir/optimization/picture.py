"""Draw how a team converges, as a picture for a page or a paper."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
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


CONVERGENCE_WIDTH = 6.4
"""Width of the picture, in inches."""
PANEL_HEIGHT = 2.6
"""Height of a panel, in inches."""
MOST_DRAWN_ENTRIES = 4
"""Number of entries of a value that are drawn."""

Recorded = Mapping[str, Mapping[int, Any]]
"""{name: {agent: (K+1, ...)}}, the series of the agents by the name of the value."""


def draw_convergence(
    recorded: Recorded,
    path: str | Path,
    title: str = "",
    times: Mapping[int, Vec] | None = None,
    common: bool = True,
) -> None:
    """Write a picture of the convergence; the suffix of `path` decides the format, such as PNG.

    One panel shows the entries of a value of each agent. The panel below it shows, on a logarithmic
    axis, the distance of each agent from the team's mean at the end. A magnitude, which is one
    number and never negative, such as an error, has one panel with a logarithmic axis. Only x has
    both panels in each case.

    recorded: the values to draw, in this order
    path: file to write
    title: title of the picture
    times: {agent: (K+1,) s}, abscissa for agents that are not in step; None for rounds
    common: True if the agents are to agree on x; else the distance is that of each agent from its
        own last x
    Raises ConfigError for values that are not numbers.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(dpi=200, layout="constrained")
    FigureCanvasAgg(figure)
    fill_convergence(figure, recorded, title, times, common)
    save_figure(figure, path, bbox_inches="tight")


def fill_convergence(
    figure: "Figure",
    recorded: Recorded,
    title: str = "",
    times: Mapping[int, Vec] | None = None,
    common: bool = True,
) -> None:
    """Draw the picture of `draw_convergence` into an empty figure, and set the size of the figure."""
    panels: list[Callable[[Any], None]] = []
    for name, series in recorded.items():
        x = {i: _stack_entries(i, name, values) for i, values in series.items()}
        at = times or {i: np.arange(len(one), dtype=float) for i, one in x.items()}
        if name != "x" and _are_magnitudes(x):
            panels.append(partial(_draw_magnitudes, x=x, at=at, name=name))
            continue
        agrees = common or name != "x"
        panels.append(partial(_draw_entries, x=x, at=at, name=name))
        panels.append(partial(_draw_distances, x=x, at=at, name=name, common=agrees))
    figure.set_size_inches(CONVERGENCE_WIDTH, PANEL_HEIGHT * len(panels))
    column = figure.subplots(len(panels), 1, sharex=True, squeeze=False)[:, 0]
    for axes, draw_panel in zip(column, panels, strict=True):
        draw_panel(axes)
        axes.grid(color="#e6e6e6", linewidth=0.6)
        axes.set_axisbelow(True)
        axes.spines[["top", "right"]].set_visible(False)
    column[-1].set_xlabel("time [s]" if times else "round")
    figure.suptitle(
        make_readable(title), color=PICTURE_STYLE.ink, fontsize=10, parse_math=False
    )


def _are_magnitudes(x: Mapping[int, Vec]) -> bool:
    """Return whether each value is one number, and none is negative."""
    return all(values.shape[1] == 1 and (values >= 0).all() for values in x.values())


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


def _draw_magnitudes(
    axes: "Axes", x: Mapping[int, Vec], at: Mapping[int, Vec], name: str
) -> None:
    for i, values in x.items():
        _draw_logarithm(axes, i, at[i], values[:, 0])
    axes.set_ylabel(f"{name} of each agent")


def _draw_distances(
    axes: "Axes", x: Mapping[int, Vec], at: Mapping[int, Vec], name: str, common: bool
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
        _draw_logarithm(axes, i, at[i], distance)
    what = "its own end" if mean is None else "the mean at the end"
    axes.set_ylabel(f"distance of {name} from\n{what}")


def _draw_logarithm(axes: "Axes", i: int, at: Vec, values: Vec) -> None:
    """Draw the line of agent i on a logarithmic axis, with a gap where a value is 0."""
    axes.semilogy(
        at,
        np.where(values == 0.0, np.nan, values),
        color=PICTURE_STYLE.colours[i % len(PICTURE_STYLE.colours)],
        linestyle=PICTURE_STYLE.dashes[i % len(PICTURE_STYLE.dashes)],
        linewidth=0.9,
    )
