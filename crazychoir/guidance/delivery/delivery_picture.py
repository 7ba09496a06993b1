"""A picture of what was flown for tasks that came and went."""

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from crazychoir.files.output_files import save_figure
from crazychoir.guidance.tasks.task_book import Place
from crazychoir.optimization.picture import PICTURE_STYLE
from crazychoir.types import Mat

if TYPE_CHECKING:
    from matplotlib.axes import Axes

FAILURE_COLOUR = "#c00000"
"""Colour of lost robots and undelivered tasks."""


@dataclass(frozen=True)
class DeliveryMap:
    """What was flown and delivered, seen from above."""

    homes: Mapping[int, Place]
    """(2,) m by robot: where it started."""
    ways: Mapping[int, Mat]
    """(n, 2) m by robot: what it flew, from home."""
    pickups: Mapping[int, Place]
    """(2,) m by task."""
    deliveries: Mapping[int, Place]
    """(2,) m by task."""
    undelivered: Collection[int]
    """Tasks that were not delivered."""
    lost: Collection[int]
    """Robots that were lost."""


def draw_flown_ways(path: str | Path, flown: DeliveryMap, title: str) -> None:
    """Draw the room from above, in m, as a PNG or in the format of the suffix of `path`.

    Homes are squares, flown ways are lines with arrows, pickups are triangles up, and deliveries
    are triangles down. Undelivered tasks have red numbers. Lost robots are red crosses at their
    last known places, at home if unknown.

    path: the file to write.
    flown: what is drawn.
    title: title of the picture.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(8.6, 6.2), dpi=200, layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.add_subplot()
    for i, way in flown.ways.items():
        _draw_way(axes, i, way)
    _draw_goods(axes, flown.pickups, "^", "white", "pickup of task", flown.undelivered)
    _draw_goods(
        axes,
        flown.deliveries,
        "v",
        PICTURE_STYLE.ink,
        "delivery of task",
        flown.undelivered,
    )
    _draw_robots(axes, flown)
    axes.set_aspect("equal")
    axes.set(xlabel="x [m]", ylabel="y [m]")
    axes.grid(color="#e6e6e6", linewidth=0.6)
    axes.set_axisbelow(True)
    axes.spines[["top", "right"]].set_visible(False)
    axes.set_title(title, color=PICTURE_STYLE.ink, fontsize=10)
    figure.legend(
        loc="outside right upper", frameon=False, fontsize=8, handlelength=3.2
    )
    save_figure(figure, path, bbox_inches="tight")


def _draw_way(axes: "Axes", i: int, way: Mat) -> None:
    colour = PICTURE_STYLE.colours[i % len(PICTURE_STYLE.colours)]
    length = float(np.linalg.norm(np.diff(way, axis=0), axis=1).sum())
    dash = PICTURE_STYLE.dashes[i % len(PICTURE_STYLE.dashes)]
    axes.plot(
        way[:, 0],
        way[:, 1],
        color=colour,
        linestyle=dash,
        linewidth=1.5,
        label=f"robot {i}: {length:.2f} m",
    )
    style = {
        "arrowstyle": "-|>",
        "color": colour,
        "lw": 0.0,
        "mutation_scale": 11,
        "shrinkA": 0,
        "shrinkB": 0,
    }
    for a, b in pairwise(way):
        tip = a + 0.56 * (b - a)
        tail = a + 0.50 * (b - a)
        axes.annotate(
            "",
            xy=(tip[0], tip[1]),
            xytext=(tail[0], tail[1]),
            arrowprops=style,
            zorder=3,
        )


def _draw_goods(
    axes: "Axes",
    places: Mapping[int, Place],
    marker: str,
    fill: str,
    label: str,
    undelivered: Collection[int],
) -> None:
    x, y = np.reshape(list(places.values()), (-1, 2)).T
    axes.scatter(
        x,
        y,
        s=46,
        marker=marker,
        c=fill,
        edgecolors=PICTURE_STYLE.ink,
        label=label,
        zorder=4,
    )
    for j, place in places.items():
        colour = FAILURE_COLOUR if j in undelivered else PICTURE_STYLE.ink
        axes.annotate(
            str(j),
            place,
            xytext=(6, 4),
            textcoords="offset points",
            fontsize=7.5,
            color=colour,
            zorder=6,
        )


def _draw_robots(axes: "Axes", flown: DeliveryMap) -> None:
    for i, (x, y) in flown.homes.items():
        colour = PICTURE_STYLE.colours[i % len(PICTURE_STYLE.colours)]
        axes.plot(
            x, y, "s", color=colour, markersize=11, markeredgecolor="white", zorder=5
        )
        axes.text(
            x,
            y,
            str(i),
            color="white",
            ha="center",
            va="center_baseline",
            size=7.5,
            weight="bold",
            zorder=6,
        )
    axes.plot([], [], "s", color="#808080", label="home of robot")
    for i in flown.lost:
        x, y = flown.ways[i][-1] if i in flown.ways else flown.homes[i]
        axes.plot(
            x,
            y,
            "X",
            color=FAILURE_COLOUR,
            markersize=13,
            markeredgecolor="white",
            zorder=7,
            label=f"lost: robot {i}",
        )
