"""Pictures of a flight for a column of a paper: 3.5 inches wide, as PNG and PDF."""

from collections.abc import Callable
from itertools import cycle
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from crazychoir.optimization.picture import COLOURS, DASHES, INK
from crazychoir.recording.figures import Flight, Track
from crazychoir.swarm.checks import TOUCHING
from crazychoir.types import Mat

if TYPE_CHECKING:
    from matplotlib.figure import Figure

WIDTH = 3.5
"""inches, of a column."""
NAMED = len(COLOURS)
"""Drones that a legend names; more of them are told by a scale of colours."""
FORMATS = ("png", "pdf")
STYLE: Any = {
    "font.size": 8, "axes.labelsize": 8, "xtick.labelsize": 7, "ytick.labelsize": 7, "legend.fontsize": 7,
    "axes.linewidth": 0.6, "axes.spines.top": False, "axes.spines.right": False, "axes.grid": True,
    "axes.axisbelow": True, "grid.color": "#e6e6e6", "grid.linewidth": 0.5, "lines.linewidth": 1.0,
    "legend.frameon": False, "legend.handlelength": 2.2, "legend.columnspacing": 1.2, "pdf.fonttype": 42,
}  # fmt: skip
REFERENCE: dict[str, Any] = {"color": "#cccccc", "linewidth": 2.8, "zorder": 1.5}
"""A broad band below the line of what was flown."""


def draw(flight: Flight, folder: Path) -> list[Path]:
    """All pictures, into `folder`; returns their files."""
    import matplotlib as mpl
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    pictures: dict[str, tuple[float, Callable[[Figure, Flight], None]]] = {
        "top": (3.3, _draw_top),
        "space": (3.2, _draw_space),
        "tracking": (2.4, _draw_tracking),
        "heights": (2.4, _draw_heights),
        "separation": (2.0, _draw_separation),
    }
    files = []
    for name, (height, picture) in pictures.items():
        with mpl.rc_context(STYLE):
            figure = Figure(figsize=(WIDTH, height), dpi=300, layout="constrained")
            FigureCanvasAgg(figure)
            picture(figure, flight)
            for suffix in FORMATS:
                files.append(folder / f"{name}.{suffix}")
                figure.savefig(files[-1])
    return files


def _draw_top(figure: "Figure", flight: Flight) -> None:
    axes = figure.add_subplot()
    for line, track in _lines(flight):
        axes.plot(*track.p[:, :2].T, **line)
        axes.plot(*track.reference[:, :2].T, **REFERENCE)
        axes.plot(*track.p[0, :2], "o", color=line["color"], markersize=3.5, zorder=4)
    axes.set_aspect("equal")
    axes.margins(0.08)
    axes.set_xlabel("$x$ [m]")
    axes.set_ylabel("$y$ [m]")
    _name(figure, flight, referenced=True, started=True)


def _draw_space(figure: "Figure", flight: Flight) -> None:
    axes: Any = figure.add_subplot(projection="3d")
    for line, track in _lines(flight):
        axes.plot(*track.p.T, **line)
        axes.plot(*track.reference.T, **REFERENCE)
        axes.plot(*track.p[:1].T, "o", color=line["color"], markersize=3.5, zorder=4)
    axes.set_aspect("equal")
    axes.set_xlabel("$x$ [m]", labelpad=-6)
    axes.set_ylabel("$y$ [m]", labelpad=-6)
    axes.set_zlabel("$z$ [m]", labelpad=-6)
    axes.tick_params(pad=-3)
    axes.locator_params(nbins=4)
    _name(figure, flight, referenced=True, started=True, pad=0.16)


def _draw_tracking(figure: "Figure", flight: Flight) -> None:
    axes = figure.add_subplot()
    for line, track in _lines(flight):
        axes.plot(track.t, 100.0 * track.tracking, **line)
    axes.set_ylim(bottom=0.0)
    _along_time(axes, flight, "distance from reference [cm]")
    _name(figure, flight)


def _draw_heights(figure: "Figure", flight: Flight) -> None:
    axes = figure.add_subplot()
    for line, track in _lines(flight):
        axes.plot(track.t, track.p[:, 2], **line)
        axes.plot(track.t, track.reference[:, 2], **REFERENCE)
    _along_time(axes, flight, "$z$ [m]")
    _name(figure, flight, referenced=True)


def _draw_separation(figure: "Figure", flight: Flight) -> None:
    axes = figure.add_subplot()
    axes.plot(flight.times, flight.separation, color=COLOURS[0])
    axes.axhline(TOUCHING, color=COLOURS[1], linestyle=DASHES[1], linewidth=0.8)
    axes.annotate(
        f"may touch: {TOUCHING:g} m", (flight.times[-1], TOUCHING), xytext=(0, 2), textcoords="offset points",
        ha="right", va="bottom", color=COLOURS[1], fontsize=7,
    )  # fmt: skip
    axes.set_ylim(bottom=0.0)
    _along_time(axes, flight, "least distance of two [m]")


def _along_time(axes: Any, flight: Flight, label: str) -> None:
    axes.set_xlim(0.0, float(flight.times[-1]))
    axes.set_xlabel("$t$ [s]")
    axes.set_ylabel(label)


def _lines(flight: Flight) -> list[tuple[dict[str, Any], Track]]:
    """How each drone's line looks, and the drone; dashes show what lies below a line."""
    n = len(flight.tracks)
    looks: Any = zip(COLOURS, cycle(DASHES), strict=False) if n <= NAMED else zip(scale(n), n * ["-"], strict=True)
    return [({"color": c, "linestyle": dash}, track) for (c, dash), track in zip(looks, flight.tracks, strict=False)]


def scale(n: int) -> Mat:
    """n colours, from dark to light."""
    from matplotlib import colormaps

    colours: Mat = colormaps["viridis"](np.linspace(0.0, 0.92, n))
    return colours


def _name(
    figure: "Figure", flight: Flight, referenced: bool = False, started: bool = False, pad: float = 0.02
) -> None:
    """Say which line is which: by a legend above, or by a scale of colours."""
    from matplotlib.lines import Line2D

    handles = []
    if len(flight.tracks) <= NAMED:
        handles += [Line2D([], [], label=f"drone {track.drone}", **line) for line, track in _lines(flight)]
    if referenced and any(np.isfinite(track.reference).any() for track in flight.tracks):
        handles.append(Line2D([], [], label="reference", **REFERENCE))
    if started:
        handles.append(Line2D([], [], label="start", color=INK, marker="o", linestyle="", markersize=3.5))
    if handles:
        figure.legend(handles=handles, loc="outside upper center", ncols=4)
    if len(flight.tracks) > NAMED:
        _draw_scale(figure, flight, pad)


def _draw_scale(figure: "Figure", flight: Flight, pad: float) -> None:
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import BoundaryNorm, ListedColormap

    n = len(flight.tracks)
    norm = BoundaryNorm(np.arange(n + 1) - 0.5, n)
    mappable = ScalarMappable(norm, ListedColormap(list(scale(n))))
    bar = figure.colorbar(mappable, ax=figure.axes[0], label="drone", fraction=0.04, pad=pad)
    marks = np.unique(np.linspace(0, n - 1, min(n, 6)).round().astype(int))
    bar.set_ticks(marks.tolist(), labels=[str(flight.tracks[k].drone) for k in marks])
    bar.ax.minorticks_off()
