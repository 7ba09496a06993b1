"""The scene of a running swarm: fence, drones, trails, planned routes, and tasks."""

from collections import deque
from dataclasses import dataclass
from typing import Any

import numpy as np

from crazychoir.dashboard.model import SwarmModel
from crazychoir.dashboard.polling import Overview, TaskBoard
from crazychoir.recording.ros.scene import (
    Color,
    SceneShape,
    ShapeKind,
    drone_color,
    still_shapes,
)
from crazychoir.types import Vec


@dataclass(frozen=True, slots=True)
class LiveSceneLimits:
    """Lengths, sizes and colours of what moves in a scene."""

    trail_step: float = 0.03
    """m: least distance between two points of a trail."""
    most_trail_points: int = 300
    """Largest number of points of a trail; the oldest are dropped."""
    trail_thickness: float = 0.01
    """m: thickness of a trail."""
    trail_opacity: float = 0.6
    """Opacity of a trail."""
    route_thickness: float = 0.02
    """m: thickness of a route."""
    route_opacity: float = 0.35
    """Opacity of a route."""
    task_diameter: float = 0.15
    """m: diameter of the ball at a task."""
    most_tasks: int = 500
    """Largest number of tasks that are shown, the newest."""


LIVE_SCENE = LiveSceneLimits()
OPEN_TASK_COLOR: Color = (0.902, 0.624, 0.0, 1.0)
DONE_TASK_COLOR: Color = (0.0, 0.62, 0.451, 0.6)
TASK_COLORS: dict[str, Color] = {
    "aboard": (0.337, 0.706, 0.914, 1.0),
    "delivered": DONE_TASK_COLOR,
    "done": DONE_TASK_COLOR,
    "cancelled": (0.5, 0.5, 0.5, 0.4),
    "lost": (0.835, 0.369, 0.0, 1.0),
}
"""Colours of tasks by fate, for all but open ones."""


class LiveScene:
    """Collects trails, and describes the scene.

    model: what is known of the drones
    overview: the routes that drones report
    board: the tasks of the mission
    """

    def __init__(self, model: SwarmModel, overview: Overview, board: TaskBoard) -> None:
        self._model = model
        self._overview = overview
        self._board = board
        self._still = still_shapes(model.config)
        self._trails: dict[int, deque[Vec]] = {
            i: deque(maxlen=LIVE_SCENE.most_trail_points) for i in model.config.ids
        }

    def note_places(self) -> None:
        """Lengthen the trail of each drone that has moved."""
        for i, trail in self._trails.items():
            p = self._model.position(i)
            if p is None:
                continue
            if not trail or np.linalg.norm(p - trail[-1]) >= LIVE_SCENE.trail_step:
                trail.append(p)

    def shapes(self) -> list[SceneShape]:
        """Return all shapes of the scene as it is now."""
        return [*self._still, *self._lines(), *self._task_shapes()]

    def _lines(self) -> list[SceneShape]:
        """Return the trails and the routes."""
        found = []
        for i, trail in self._trails.items():
            if len(trail) > 1:
                color = _fade(drone_color(i), LIVE_SCENE.trail_opacity)
                found.append(
                    SceneShape(
                        f"trail of drone {i}",
                        ShapeKind.LINE_STRIP,
                        np.array(trail),
                        LIVE_SCENE.trail_thickness,
                        color,
                    )
                )
        for i, route in self._overview.routes.items():
            begin = self._model.position(i)
            places = [begin] if begin is not None else []
            color = _fade(drone_color(i), LIVE_SCENE.route_opacity)
            found.append(
                SceneShape(
                    f"route of drone {i}",
                    ShapeKind.LINE_STRIP,
                    np.array([*places, *route], dtype=float),
                    LIVE_SCENE.route_thickness,
                    color,
                )
            )
        return found

    def _task_shapes(self) -> list[SceneShape]:
        """Return a ball at each place of a task, on the ground, and a line between two of them."""
        tasks = (self._board.tasks or [])[-LIVE_SCENE.most_tasks :]
        return [shape for task in tasks for shape in self._shapes_of_task(task)]

    def _shapes_of_task(self, task: dict[str, Any]) -> list[SceneShape]:
        ground = self._model.config.flight.ground
        spots = [task["pickup"]]
        if task.get("delivery"):
            spots.append(task["delivery"])
        places = np.array([[x, y, ground] for x, y, *_ in spots])
        color = TASK_COLORS.get(str(task.get("fate")), OPEN_TASK_COLOR)
        balls = SceneShape(
            f"task {task['id']}",
            ShapeKind.SPHERE,
            places,
            LIVE_SCENE.task_diameter,
            color,
        )
        way = SceneShape(
            f"way of task {task['id']}",
            ShapeKind.LINE_STRIP,
            places,
            LIVE_SCENE.trail_thickness,
            color,
        )
        return [balls, way] if len(spots) > 1 else [balls]


def _fade(color: Color, opacity: float) -> Color:
    """Return a colour with another opacity."""
    return (*color[:3], opacity)
