"""Pictures of a swarm's flight from above; with them, a mission's `picture` may be one line."""

from collections.abc import Collection, Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from crazychoir.files.output_files import save_figure
from crazychoir.optimization.picture import PICTURE_STYLE
from crazychoir.types import Mat, Point, Vec

if TYPE_CHECKING:
    from matplotlib.axes import Axes

LEADER_COLOUR = "#D55E00"  # colour of leaders
SEEN_WAY_COLOUR = "#909090"
PLAN_STYLE: dict[str, Any] = {"color": "#cccccc", "linewidth": 4.0, "zorder": 1}
"""Style of a broad band below the line of what was flown."""
Ways = Mapping[int, Sequence[Sequence[float]]]


def draw_tracks(
    results: Mapping[int, Mapping[str, Any]],
    path: str | Path,
    *,
    leaders: Collection[int] = (),
    edges: Iterable[tuple[int, int]] = (),
    marks: Mapping[str, Vec] | None = None,
    title: str = "",
) -> None:
    """Write a picture of the room from above, in m: a PNG, or what the suffix of `path` says.

    Lines are the flown tracks, empty circles the starts, filled circles the ends with the drones'
    numbers.
    results: results of all drones, as `picture(config, results, path)` gets them; result["track"]
        is
        (n, 4) = t s, p m, world, for a drone with a known track
    path: the file to write
    leaders: drones drawn as squares in another colour
    edges: pairs of drones; their ends are joined by thin lines
    marks: {name: (k, 2) or (k, 3) m}: places of the mission, drawn as crosses
    title: title of the picture
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    tracks: dict[int, Mat] = {
        i: np.asarray(r["track"])[:, 1:3]
        for i, r in results.items()
        if len(r.get("track", ()))
    }
    figure = Figure(figsize=(4.6, 4.2), dpi=130, layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.add_subplot()
    for i, j in edges:
        if i in tracks and j in tracks:
            axes.plot(
                *np.array([tracks[i][-1], tracks[j][-1]]).T,
                color="#dddddd",
                linewidth=0.8,
                zorder=1,
            )
    for i, track in tracks.items():
        colour, mark = (
            (LEADER_COLOUR, "s") if i in leaders else (PICTURE_STYLE.colours[0], "o")
        )
        axes.plot(*track.T, color=colour, linewidth=0.9, alpha=0.8, zorder=2)
        axes.plot(
            *track[0],
            mark,
            color=colour,
            markersize=4.5,
            markerfacecolor="white",
            zorder=3,
        )
        axes.plot(*track[-1], mark, color=colour, markersize=4.5, zorder=4)
        axes.annotate(
            str(i),
            track[-1],
            xytext=(3, 3),
            textcoords="offset points",
            fontsize=6,
            color=PICTURE_STYLE.ink,
            zorder=5,
        )
    for colour, (name, places) in zip(
        PICTURE_STYLE.colours[2:], (marks or {}).items(), strict=False
    ):
        axes.plot(
            *np.atleast_2d(places)[:, :2].T,
            "x",
            color=colour,
            markersize=5,
            label=name,
            zorder=5,
        )
    _draw_tracks_legend(axes, leaders, tracks, bool(marks))
    axes.set_aspect("equal")
    axes.margins(0.08)
    axes.set(xlabel="x [m]", ylabel="y [m]", title=title)
    _tidy_axes(axes)
    save_figure(figure, path)


def _draw_tracks_legend(
    axes: "Axes", leaders: Collection[int], tracks: Collection[int], marked: bool
) -> None:
    """Draw the legend above the picture."""
    from matplotlib.lines import Line2D

    def mark(label: str, kind: str, colour: str, fill: str | None = None) -> Line2D:
        return Line2D(
            [],
            [],
            label=label,
            marker=kind,
            color=colour,
            markersize=4.5,
            markerfacecolor=fill or colour,
        )

    handles: list[Any] = [mark("start", "o", PICTURE_STYLE.colours[0], "white")]
    handles.append(
        mark("follower" if leaders else "end", "o", PICTURE_STYLE.colours[0])
    )
    if any(i in tracks for i in leaders):
        handles.append(mark("leader", "s", LEADER_COLOUR))
    handles += axes.get_legend_handles_labels()[0] if marked else []
    axes.figure.legend(
        handles=handles, loc="outside upper center", ncols=4, frameon=False, fontsize=7
    )


def draw_ways(
    path: str | Path,
    ways: Ways,
    beside: Mapping[int, Any],
    label: str,
    goals: Mapping[int, Point] | None = None,
    seen: Ways | None = None,
    target: Point | None = None,
) -> None:
    """Write a picture of ways from above, and of a quantity beside it over time.

    The file is a PNG, or what the suffix of `path` says.
    path: the file to write
    ways: rows [t s, x, y, .. m] of each drone, drawn from a dot at the start
    beside: (T,): the quantity of each drone at the times of its way, drawn on the right
    label: label of that quantity
    goals: (2,) m or more: goal of each drone, drawn as a cross
    seen: ways of others, drawn in grey
    target: place drawn as a star
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(7.2, 3.4), dpi=150, layout="constrained")
    FigureCanvasAgg(figure)
    above, right = figure.subplots(1, 2)
    for other in (seen or {}).values():
        above.plot(
            *np.array(other)[:, 1:3].T,
            color=SEEN_WAY_COLOUR,
            linewidth=0.9,
            linestyle=(0, (1, 1.2)),
        )
        above.plot(*other[-1][1:3], "s", color=SEEN_WAY_COLOUR, markersize=4)
    for i, way in ways.items():
        rows = np.array(way)
        look = _way_style(i)
        above.plot(rows[:, 1], rows[:, 2], **look, label=f"drone {i}")
        above.plot(rows[0, 1], rows[0, 2], "o", color=look["color"], markersize=3.5)
        right.plot(rows[: len(beside[i]), 0], beside[i], **look)
    for i, place in (goals or {}).items():
        above.plot(
            place[0],
            place[1],
            "x",
            color=_way_style(i)["color"],
            markersize=7,
            markeredgewidth=1.6,
        )
    if target is not None:
        above.plot(target[0], target[1], "*", color=PICTURE_STYLE.ink, markersize=9)
    above.set_aspect("equal", adjustable="datalim")
    above.set(xlabel="x [m]", ylabel="y [m]")
    right.set(xlabel="t [s]", ylabel=label)
    for axes in (above, right):
        _tidy_axes(axes)
    figure.legend(loc="outside upper center", ncols=6, frameon=False, fontsize=8)
    save_figure(figure, path)


def draw_plans(
    path: str | Path, results: Mapping[int, Mapping[str, Any]], plans: Mapping[int, Mat]
) -> None:
    """Write a picture from above of what was flown over what was planned, in m.

    The file is a PNG, or what the suffix of `path` says.
    path: the file to write
    results: result["way"] has rows [t s, x, y, .. m] of what a drone flew of its plan. Without them,
        as of a drone that has failed, result["track"] is drawn: the rows of its whole flight.
    plans: (n, 2) m or more of each drone, drawn as a broad grey line
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(5.6, 4.2), dpi=150, layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.add_subplot()
    for i, plan in plans.items():
        axes.plot(*plan[:, :2].T, **PLAN_STYLE)
        result = results.get(i, {})
        known = [result[key] for key in ("way", "track") if len(result.get(key, ()))]
        if not known:
            continue
        flown = np.asarray(known[0])
        look = _way_style(i)
        axes.plot(flown[:, 1], flown[:, 2], **look)
        start = (flown[0, 1], flown[0, 2])
        axes.plot(*start, "o", color=look["color"], markersize=4, zorder=4)
        axes.annotate(
            str(i), start, xytext=(4, 4), textcoords="offset points", fontsize=7
        )
    axes.set_aspect("equal")
    axes.margins(0.08)
    axes.set(xlabel="x [m]", ylabel="y [m]")
    _tidy_axes(axes)
    axes.legend(
        handles=_make_plan_legend(),
        loc="lower center",
        bbox_to_anchor=(0.5, 1.0),
        ncols=3,
        frameon=False,
        fontsize=8,
    )
    save_figure(figure, path, bbox_inches="tight")


def _make_plan_legend() -> list[Any]:
    from matplotlib.lines import Line2D

    flown: dict[str, Any] = {"color": PICTURE_STYLE.colours[0], "linewidth": 1.3}
    start: dict[str, Any] = {
        "color": PICTURE_STYLE.colours[0],
        "marker": "o",
        "markersize": 4,
    }
    return [
        Line2D([], [], label="plan", **PLAN_STYLE),
        Line2D([], [], label="flown", **flown),
        Line2D([], [], label="start", linestyle="", **start),
    ]


def draw_heights(
    path: str | Path,
    results: Mapping[int, Mapping[str, Any]],
    goals: Mapping[int, Point],
) -> None:
    """Write a picture of ways from above, and of their heights over time.

    path: the file to write
    results: result["way"] has rows [t s, x, y, z m]
    goals: (3,) m: goal of each drone, drawn as a cross
    """
    ways = {i: result["way"] for i, result in results.items()}
    heights = {i: np.array(way)[:, 3] for i, way in ways.items()}
    draw_ways(path, ways, heights, "z [m]", goals)


def _way_style(i: int) -> dict[str, Any]:
    return {
        "color": PICTURE_STYLE.colours[i % len(PICTURE_STYLE.colours)],
        "linestyle": PICTURE_STYLE.dashes[i % len(PICTURE_STYLE.dashes)],
        "linewidth": 1.3,
    }


def _tidy_axes(axes: "Axes") -> None:
    axes.grid(color="#e6e6e6", linewidth=0.6)
    axes.set_axisbelow(True)
    axes.spines[["top", "right"]].set_visible(False)
