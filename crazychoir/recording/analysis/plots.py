"""Pictures of a flight for one column of a paper: 3.5 inches wide, as PNG and PDF."""

from collections.abc import Callable, Sequence
from functools import partial
from itertools import cycle
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from crazychoir.bus.topics import DRONE_TOPICS
from crazychoir.config.checks import SWARM_LIMITS
from crazychoir.files.output_files import save_figure
from crazychoir.optimization.picture import PICTURE_STYLE
from crazychoir.recording.analysis.figures import RecordedFlight, RecordedTrack
from crazychoir.types import Mat

if TYPE_CHECKING:
    from matplotlib.figure import Figure

COLUMN_WIDTH = 3.5
"""Width of a column in inches."""
MOST_NAMED_DRONES = len(PICTURE_STYLE.colours)
"""Largest number of drones that a legend names; more are shown by a scale of colours."""
PICTURE_FORMATS = ("png", "pdf")
PLOT_STYLE: Any = {
    "font.size": 8,
    "axes.labelsize": 8,
    "xtick.labelsize": 7,
    "ytick.labelsize": 7,
    "legend.fontsize": 7,
    "axes.linewidth": 0.6,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": "#e6e6e6",
    "grid.linewidth": 0.5,
    "lines.linewidth": 1.0,
    "legend.frameon": False,
    "legend.handlelength": 2.2,
    "legend.columnspacing": 1.2,
    "pdf.fonttype": 42,
}
Pictures = dict[str, tuple[float, "Callable[[Figure], None]"]]
"""Height in inches and the drawing function of each picture, by its name."""
Reasons = dict[str, str]
"""Why a picture is not drawn, by its name."""
REFERENCE_BAND_STYLE: dict[str, Any] = {
    "color": "#cccccc",
    "linewidth": 2.8,
    "zorder": 1.5,
}
"""Style of a broad band below the line of what was flown."""

SHORTEST_AXIS = 0.1
"""s: shortest time axis; a recording that was cut off early may have one moment only."""


def draw(pictures: Pictures, folder: Path) -> list[Path]:
    """Write these pictures into `folder`; return their files."""
    import matplotlib as mpl
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    files = []
    for name, (height, picture) in pictures.items():
        with mpl.rc_context(PLOT_STYLE):
            figure = Figure(
                figsize=(COLUMN_WIDTH, height), dpi=300, layout="constrained"
            )
            FigureCanvasAgg(figure)
            picture(figure)
            for suffix in PICTURE_FORMATS:
                files.append(folder / f"{name}.{suffix}")
                save_figure(figure, files[-1])
    return files


def flight_pictures(flight: RecordedFlight) -> tuple[Pictures, Reasons]:
    """Return the pictures of the drones' positions, and why others cannot be drawn."""
    all_pictures: Pictures = {
        "top": (3.3, partial(_draw_top, flight=flight)),
        "space": (3.2, partial(_draw_space, flight=flight)),
        "tracking": (2.4, partial(_draw_tracking, flight=flight)),
        "heights": (2.4, partial(_draw_heights, flight=flight)),
        "separation": (2.0, partial(_draw_separation, flight=flight)),
    }
    missing: Reasons = {}
    if not flight.tracks:
        missing = dict.fromkeys(all_pictures, "no truth or state of any drone")
    elif not any(np.isfinite(track.tracking).any() for track in flight.tracks):
        missing["tracking"] = "no reference while it was known where a drone was"
    if flight.tracks and not np.isfinite(flight.separation).any():
        missing["separation"] = "no two drones at one time"
    return {
        name: picture for name, picture in all_pictures.items() if name not in missing
    }, missing


def _draw_top(figure: "Figure", flight: RecordedFlight) -> None:
    axes = figure.add_subplot()
    for line, track in styled_tracks(flight):
        axes.plot(*track.p[:, :2].T, **line)
        axes.plot(*track.reference[:, :2].T, **REFERENCE_BAND_STYLE)
        axes.plot(*track.p[0, :2], "o", color=line["color"], markersize=3.5, zorder=4)
    axes.set_aspect("equal")
    axes.margins(0.08)
    axes.set_xlabel("$x$ [m]")
    axes.set_ylabel("$y$ [m]")
    add_flight_legend(figure, flight, band=_reference_label(flight), started=True)


def _draw_space(figure: "Figure", flight: RecordedFlight) -> None:
    axes: Any = figure.add_subplot(projection="3d")
    for line, track in styled_tracks(flight):
        axes.plot(*track.p.T, **line)
        axes.plot(*track.reference.T, **REFERENCE_BAND_STYLE)
        axes.plot(*track.p[:1].T, "o", color=line["color"], markersize=3.5, zorder=4)
    axes.set_aspect("equal")
    axes.set_xlabel("$x$ [m]", labelpad=-6)
    axes.set_ylabel("$y$ [m]", labelpad=-6)
    axes.set_zlabel("$z$ [m]", labelpad=-6)
    axes.tick_params(pad=-3)
    axes.locator_params(nbins=4)
    add_flight_legend(
        figure, flight, band=_reference_label(flight), started=True, pad=0.16
    )


def _draw_tracking(figure: "Figure", flight: RecordedFlight) -> None:
    axes = figure.add_subplot()
    for line, track in styled_tracks(flight):
        axes.plot(track.t, 100.0 * track.tracking, **line)
    axes.set_ylim(bottom=0.0)
    set_time_axis(axes, float(flight.times[-1]), "distance from reference [cm]")
    add_flight_legend(figure, flight)


def _draw_heights(figure: "Figure", flight: RecordedFlight) -> None:
    axes = figure.add_subplot()
    for line, track in styled_tracks(flight):
        axes.plot(track.t, track.p[:, 2], **line)
        axes.plot(track.t, track.reference[:, 2], **REFERENCE_BAND_STYLE)
    set_time_axis(axes, float(flight.times[-1]), "$z$ [m]")
    add_flight_legend(figure, flight, band=_reference_label(flight))


def _draw_separation(figure: "Figure", flight: RecordedFlight) -> None:
    axes = figure.add_subplot()
    axes.plot(flight.times, flight.separation, color=PICTURE_STYLE.colours[0])
    limits = {"may touch": SWARM_LIMITS.touching_distance}
    if flight.kept_distance is not None:
        limits["kept side by side"] = flight.kept_distance
    for k, (name, limit) in enumerate(limits.items(), 1):
        _draw_limit(axes, f"{name}: {limit:g} m", limit, float(flight.times[-1]), k)
    axes.set_ylim(bottom=0.0)
    set_time_axis(axes, float(flight.times[-1]), "least distance of two [m]")


def _draw_limit(axes: Any, text: str, limit: float, last: float, k: int) -> None:
    """Draw a level line in the style k with its text at its right end, `last` s."""
    colour = PICTURE_STYLE.colours[k]
    axes.axhline(limit, color=colour, linestyle=PICTURE_STYLE.dashes[k], linewidth=0.8)
    axes.annotate(
        text,
        (last, limit),
        xytext=(0, 2),
        textcoords="offset points",
        ha="right",
        va="bottom",
        color=colour,
        fontsize=7,
    )


def set_time_axis(axes: Any, last: float, label: str) -> None:
    """Set up the time axis from 0 to `last` s, or to SHORTEST_AXIS, and the label of the other axis."""
    axes.set_xlim(0.0, max(last, SHORTEST_AXIS))
    axes.set_xlabel("$t$ [s]")
    axes.set_ylabel(label)


def styled_tracks(flight: RecordedFlight) -> list[tuple[dict[str, Any], RecordedTrack]]:
    """Return the line style of each drone with its track."""
    return list(zip(line_styles(len(flight.tracks)), flight.tracks, strict=True))


def line_styles(n: int) -> list[dict[str, Any]]:
    """Return the styles of the lines of n drones; dashes let a line below be seen."""
    told: Any = (
        zip(PICTURE_STYLE.colours[:n], cycle(PICTURE_STYLE.dashes), strict=False)
        if n <= MOST_NAMED_DRONES
        else zip(colour_scale(n), n * ["-"], strict=True)
    )
    return [{"color": colour, "linestyle": dash} for colour, dash in told]


def colour_scale(n: int) -> Mat:
    """Return n colours, from dark to light."""
    from matplotlib import colormaps

    colours: Mat = colormaps["viridis"](np.linspace(0.0, 0.92, n))
    return colours


def _reference_label(flight: RecordedFlight) -> str:
    """Return the name of the band; empty if there is no reference."""
    return (
        "reference"
        if any(np.isfinite(track.reference).any() for track in flight.tracks)
        else ""
    )


def add_flight_legend(
    figure: "Figure",
    flight: RecordedFlight,
    band: str = "",
    started: bool = False,
    pad: float = 0.02,
) -> None:
    """Add a legend of the drones and of the band.

    Drones without recorded truth are drawn from their own state and marked.
    """
    own = [track.source == DRONE_TOPICS.state.name for track in flight.tracks]
    marks = [" (state)" if one else "" for one in own]
    names = [
        f"{track.drone}{mark}" for track, mark in zip(flight.tracks, marks, strict=True)
    ]
    note = ""
    if len(own) > MOST_NAMED_DRONES and any(own):
        note = " (state)" if all(own) else " (some: state)"
    add_drone_legend(figure, names, f"drone{note}", band, started, pad)


def add_drone_legend(
    figure: "Figure",
    names: Sequence[str],
    label: str = "drone",
    band: str = "",
    started: bool = False,
    pad: float = 0.02,
) -> None:
    """Add a legend above the picture, or for many drones a scale of colours with this label."""
    from matplotlib.lines import Line2D

    handles = []
    if len(names) <= MOST_NAMED_DRONES:
        styles = zip(names, line_styles(len(names)), strict=True)
        handles += [
            Line2D([], [], label=f"drone {one}", **style) for one, style in styles
        ]
    if band:
        handles.append(Line2D([], [], label=band, **REFERENCE_BAND_STYLE))
    if started:
        handles.append(
            Line2D(
                [],
                [],
                label="start",
                color=PICTURE_STYLE.ink,
                marker="o",
                linestyle="",
                markersize=3.5,
            )
        )
    if handles:
        figure.legend(
            handles=handles,
            loc="outside upper center",
            ncols=4 if max(map(len, names)) < 6 else 3,
        )
    if len(names) > MOST_NAMED_DRONES:
        _draw_scale(figure, names, label, pad)


def _draw_scale(figure: "Figure", names: Sequence[str], label: str, pad: float) -> None:
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import BoundaryNorm, ListedColormap

    n = len(names)
    norm = BoundaryNorm(np.arange(n + 1) - 0.5, n)
    mappable = ScalarMappable(norm, ListedColormap(list(colour_scale(n))))
    bar = figure.colorbar(
        mappable, ax=figure.axes[0], label=label, fraction=0.04, pad=pad
    )
    marks = np.unique(np.linspace(0, n - 1, min(n, 6)).round().astype(int))
    bar.set_ticks(marks.tolist(), labels=[names[k].split()[0] for k in marks])
    bar.ax.minorticks_off()
