"""Picture of a plan for a page or a paper."""

from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from crazychoir.files.output_files import save_figure
from crazychoir.optimization.picture import PICTURE_STYLE
from crazychoir.routing.instance.instance import Instance
from crazychoir.routing.instance.plan import Route, RoutePlan
from crazychoir.routing.instance.schedule import Trip, is_timed, split_into_trips
from crazychoir.routing.instance.vehicle import OBJECTIVE_NAMES
from crazychoir.types import Mat, Vec

if TYPE_CHECKING:
    from matplotlib.axes import Axes

CROWDED_TASK_COUNT = 40
"""Number of tasks above which the picture is larger, so that names do not overlap."""
CROWDED_PICTURE_SCALE = 1.7
"""Factor by which the picture is larger then."""


def draw_routes(instance: Instance, plan: RoutePlan, path: str | Path) -> None:
    """Write a picture of the routes, seen from above, in m.

    instance: the tasks and the robots.
    plan: the routes to draw.
    path: the file; its suffix selects the format, such as PNG.

    Squares: homes, with the robot's number.
    Crosses: where robots end, if not at home.
    Triangles up: pickups. Triangles down: deliveries. Each has its task and, in three dimensions,
    its height in m.
    Arrows: the routes, with their lengths in the legend.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    scale = CROWDED_PICTURE_SCALE if len(instance.tasks) > CROWDED_TASK_COUNT else 1.0
    figure = Figure(figsize=(8.6 * scale, 6.2 * scale), dpi=200, layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.add_subplot()
    timed = is_timed(instance)
    for route in plan.routes:
        _draw_route(axes, instance, route, timed)
    _draw_points(axes, instance)
    axes.set_aspect("equal")
    axes.margins(0.06)
    axes.set_xlabel("x [m]")
    axes.set_ylabel("y [m]")
    axes.grid(color="#e6e6e6", linewidth=0.6)
    axes.set_axisbelow(True)
    axes.spines[["top", "right"]].set_visible(False)
    axes.set_title(_describe_plan(instance, plan), color=PICTURE_STYLE.ink, fontsize=10)
    figure.legend(
        loc="outside right upper", frameon=False, fontsize=8, handlelength=3.2
    )
    save_figure(figure, path, bbox_inches="tight")


def _describe_plan(instance: Instance, plan: RoutePlan) -> str:
    """Return how many robots fly, how far, until when, and which tasks are refused."""
    flown = sum(route.length for route in plan.routes)
    text = f"{len(plan.routes)} of {instance.robots} robots fly {flown:.2f} m"
    if OBJECTIVE_NAMES.makespan in plan.objective:
        text += f" until {plan.makespan:.2f} s"
    served = {j for route in plan.routes for j in route.tasks}
    refused = [str(j) for j in range(len(instance.tasks)) if j not in served]
    return text + (f"; refused: {', '.join(refused)}" if refused else "")


def _draw_route(axes: "Axes", instance: Instance, route: Route, timed: bool) -> None:
    """Draw one line for each trip, in the robot's colour."""
    flown = split_into_trips(instance, route)
    colour = PICTURE_STYLE.colours[route.robot % len(PICTURE_STYLE.colours)]
    for trip, tour in zip(flown, _list_tours(instance, route), strict=True):
        dash = PICTURE_STYLE.dashes[
            (route.robot + trip.number - 1) % len(PICTURE_STYLE.dashes)
        ]
        label = _describe_trip(trip, several=len(flown) > 1, timed=timed)
        axes.plot(
            tour[:, 0],
            tour[:, 1],
            color=colour,
            linestyle=dash,
            linewidth=1.5,
            label=label,
            zorder=2,
        )
        for a, b in pairwise(tour):
            _draw_arrow(axes, a, b, colour)


def _describe_trip(trip: Trip, several: bool, timed: bool) -> str:
    tasks = ", ".join(str(stop.task) for stop in trip.stops if stop.kind == "delivery")
    name = (
        f"robot {trip.robot}, trip {trip.number}" if several else f"robot {trip.robot}"
    )
    return (
        f"{name}: {trip.length:.2f} m"
        + (f", until {trip.end:.2f} s" if timed else "")
        + f", tasks {tasks}"
    )


def _draw_arrow(axes: "Axes", a: Vec, b: Vec, colour: str) -> None:
    """Draw an arrow head in the middle of the leg from a to b."""
    tip = a + 0.56 * (b - a)
    tail = a + 0.50 * (b - a)
    style = {
        "arrowstyle": "-|>",
        "color": colour,
        "lw": 0.0,
        "mutation_scale": 11,
        "shrinkA": 0,
        "shrinkB": 0,
    }
    axes.annotate(
        "", xy=(tip[0], tip[1]), xytext=(tail[0], tail[1]), arrowprops=style, zorder=3
    )


def _draw_points(axes: "Axes", instance: Instance) -> None:
    tasks = instance.tasks
    for i, end in enumerate([] if instance.end is None else instance.end):
        axes.plot(
            end[0],
            end[1],
            "X",
            color=PICTURE_STYLE.colours[i % len(PICTURE_STYLE.colours)],
            markersize=8,
            markeredgecolor="white",
            zorder=4,
        )
    for i, home in enumerate(instance.home):
        colour = PICTURE_STYLE.colours[i % len(PICTURE_STYLE.colours)]
        axes.plot(
            home[0],
            home[1],
            "s",
            color=colour,
            markersize=11,
            markeredgecolor="white",
            zorder=5,
        )
        x = float(home[0])
        y = float(home[1])
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
    height = ", ↑ height in m" if tasks.pickup.shape[1] == 3 else ""
    _draw_goods(axes, tasks.pickup, "^", "white", f"pickup of task{height}")
    _draw_goods(axes, tasks.delivery, "v", PICTURE_STYLE.ink, "delivery of task")
    _write_names(axes, tasks.pickup)
    _write_names(axes, tasks.delivery)


def _draw_goods(axes: "Axes", points: Mat, marker: str, fill: str, label: str) -> None:
    axes.scatter(
        points[:, 0],
        points[:, 1],
        s=46,
        marker=marker,
        c=fill,
        edgecolors=PICTURE_STYLE.ink,
        label=label,
        zorder=4,
    )


def _write_names(axes: "Axes", points: Mat) -> None:
    """Write task numbers beside points, with the height of the points in three dimensions."""
    box = {
        "boxstyle": "round,pad=0.1",
        "facecolor": "white",
        "edgecolor": "none",
        "alpha": 0.75,
    }
    for j, point in enumerate(points):
        name = f"{j} ↑{point[2]:.1f}" if len(point) == 3 else str(j)
        axes.annotate(
            name,
            point[:2],
            xytext=(6, 4),
            textcoords="offset points",
            fontsize=7.5,
            color=PICTURE_STYLE.ink,
            zorder=6,
            bbox=box,
        )


def _list_tours(instance: Instance, route: Route) -> list[Mat]:
    """Return the points of each trip, (n, 2) or (n, 3) m.

    A trip begins at home or at the robot's end point; then come the stops and the end point.
    """
    home = instance.home[route.robot]
    tasks = instance.tasks
    end = home if instance.end is None else instance.end[route.robot]
    at = {"pickup": tasks.pickup, "delivery": tasks.delivery}
    tours = [[home]]
    for stop in route.stops:
        if stop.kind == "recharge":
            tours[-1].append(end)
            tours.append([end])
        else:
            tours[-1].append(at[stop.kind][stop.task])
    if not instance.open_tours:
        tours[-1].append(end)
    return [np.array(tour) for tour in tours]
