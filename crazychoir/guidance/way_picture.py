"""What drones have flown, from above, and a figure of each over time beside it, as a picture."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from crazychoir.optimization.picture import COLOURS, DASHES, INK
from crazychoir.types import Point

if TYPE_CHECKING:
    from matplotlib.axes import Axes

GREY = "#909090"
Ways = Mapping[int, Sequence[Sequence[float]]]


def draw_ways(
    path: str | Path, ways: Ways, beside: Mapping[int, Any], label: str, goals: Mapping[int, Point] | None = None,
    seen: Ways | None = None, target: Point | None = None,
) -> None:  # fmt: skip
    """Write a PNG (or what the suffix of `path` says).

    Left: ways, rows [t s, x, y, .. m], from their dots;  goals: crosses, (2,) m or more;  seen: ways of others, grey;
    target: a star.  Right: beside, (T,) of each drone at the times of its way, with its label.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(7.2, 3.4), dpi=150, layout="constrained")
    FigureCanvasAgg(figure)
    above, right = figure.subplots(1, 2)
    for other in (seen or {}).values():
        above.plot(*np.array(other)[:, 1:3].T, color=GREY, linewidth=0.9, linestyle=(0, (1, 1.2)))
        above.plot(*other[-1][1:3], "s", color=GREY, markersize=4)
    for i, way in ways.items():
        rows, look = np.array(way), _look(i)
        above.plot(rows[:, 1], rows[:, 2], **look, label=f"drone {i}")
        above.plot(rows[0, 1], rows[0, 2], "o", color=look["color"], markersize=3.5)
        right.plot(rows[: len(beside[i]), 0], beside[i], **look)
    for i, place in (goals or {}).items():
        above.plot(place[0], place[1], "x", color=_look(i)["color"], markersize=7, markeredgewidth=1.6)
    if target is not None:
        above.plot(target[0], target[1], "*", color=INK, markersize=9)
    above.set_aspect("equal", adjustable="datalim")
    above.set(xlabel="x [m]", ylabel="y [m]")
    right.set(xlabel="t [s]", ylabel=label)
    for axes in (above, right):
        _tidy(axes)
    figure.legend(loc="outside upper center", ncols=6, frameon=False, fontsize=8)
    figure.savefig(path)


def _look(i: int) -> dict[str, Any]:
    return {"color": COLOURS[i % len(COLOURS)], "linestyle": DASHES[i % len(DASHES)], "linewidth": 1.3}


def _tidy(axes: "Axes") -> None:
    axes.grid(color="#e6e6e6", linewidth=0.6)
    axes.set_axisbelow(True)
    axes.spines[["top", "right"]].set_visible(False)
