"""What a 3D view of a swarm shows, as simple shapes, and the same as visualization_msgs/MarkerArray.

The shapes of a drone stand in its own frame, such as `drone3`. So they move with the transforms of
that frame, and need not be sent again.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from enum import IntEnum

import numpy as np

from crazychoir.config.swarm_config import SwarmConfig
from crazychoir.recording.mcap.cdr import Layout, Leaf, leaves
from crazychoir.recording.ros.rviz import MARKER_DEFINITIONS, RVIZ_SETTINGS
from crazychoir.runtime.clock import NS_PER_SECOND
from crazychoir.types import Mat

Color = tuple[float, float, float, float]
"""Red, green, blue and opacity, each from 0 to 1."""
WORLD_FRAME = "world"
DRONE_COLORS: tuple[Color, ...] = (
    (0.0, 0.447, 0.698, 1.0),
    (0.902, 0.624, 0.0, 1.0),
    (0.0, 0.62, 0.451, 1.0),
    (0.8, 0.475, 0.655, 1.0),
    (0.337, 0.706, 0.914, 1.0),
    (0.835, 0.369, 0.0, 1.0),
)
"""Colours of the drones in turn, which colour-blind readers can tell apart (Okabe and Ito, 2008)."""
FENCE_COLOR: Color = (0.5, 0.5, 0.5, 0.8)


@dataclass(frozen=True, slots=True)
class DroneShape:
    """The shape of a drone in a 3D view, larger than a Crazyflie so that it is seen from afar."""

    half_arm: float = 0.06
    """m: distance of a motor from the centre, along x and along y."""
    thickness: float = 0.015
    """m: thickness of the arms."""
    ball_diameter: float = 0.05
    """m: diameter of the ball at the centre."""
    letter_height: float = 0.12
    """m: height of the letters of its number."""
    fence_thickness: float = 0.01
    """m: thickness of the edges of the fence."""


DRONE_SHAPE = DroneShape()


class ShapeKind(IntEnum):
    """Kinds of shapes; the numbers are the types of visualization_msgs/Marker."""

    SPHERE = 2
    """A ball at each point."""
    LINE_STRIP = 4
    """A line through all points."""
    LINE_LIST = 5
    """A line between each two points."""
    TEXT = 9
    """A text at its only point that faces the viewer."""


LINE_KINDS = (ShapeKind.LINE_STRIP, ShapeKind.LINE_LIST)
"""Kinds of shapes that are lines."""


@dataclass(frozen=True, slots=True, eq=False)
class SceneShape:
    """One shape of a scene."""

    name: str
    """Its name, different from all others of the scene."""
    kind: ShapeKind
    """What its points mean."""
    points: Mat
    """(n, 3) m, in its frame."""
    size: float
    """m: thickness of lines, diameter of balls, height of letters."""
    color: Color
    """Its colour."""
    frame: str = WORLD_FRAME
    """The frame that it stands in, and moves with."""
    text: str = ""
    """The text of a text."""


def drone_frame(i: int) -> str:
    """Return the name of the frame of drone i."""
    return f"drone{i}"


def drone_color(i: int) -> Color:
    """Return the colour of drone i."""
    return DRONE_COLORS[i % len(DRONE_COLORS)]


def fence_shape(config: SwarmConfig) -> SceneShape:
    """Return the twelve edges of the fence."""
    low = np.array(config.fence.min)
    high = np.array(config.fence.max)
    ends = []
    for axis in range(3):
        others = [k for k in range(3) if k != axis]
        for one in (low, high):
            for other in (low, high):
                end = low.copy()
                end[others[0]] = one[others[0]]
                end[others[1]] = other[others[1]]
                ends.append(end)
                end = end.copy()
                end[axis] = high[axis]
                ends.append(end)
    return SceneShape(
        "fence",
        ShapeKind.LINE_LIST,
        np.array(ends),
        DRONE_SHAPE.fence_thickness,
        FENCE_COLOR,
    )


def drone_shapes(i: int) -> list[SceneShape]:
    """Return the arms, the centre and the number of drone i, in its frame."""
    a = DRONE_SHAPE.half_arm
    arms = np.array([[a, a, 0.0], [-a, -a, 0.0], [a, -a, 0.0], [-a, a, 0.0]])
    color = drone_color(i)
    frame = drone_frame(i)
    nose = np.array([[0.0, 0.0, 0.0], [1.5 * a, 0.0, 0.0]])
    above = np.array([[0.0, 0.0, DRONE_SHAPE.letter_height]])
    return [
        SceneShape(
            f"{frame} arms",
            ShapeKind.LINE_LIST,
            np.concatenate([arms, nose]),
            DRONE_SHAPE.thickness,
            color,
            frame,
        ),
        SceneShape(
            f"{frame} centre",
            ShapeKind.SPHERE,
            np.zeros((1, 3)),
            DRONE_SHAPE.ball_diameter,
            color,
            frame,
        ),
        SceneShape(
            f"{frame} number",
            ShapeKind.TEXT,
            above,
            DRONE_SHAPE.letter_height,
            color,
            frame,
            str(i),
        ),
    ]


def still_shapes(config: SwarmConfig) -> list[SceneShape]:
    """Return the shapes that never change: the fence, and each drone in its frame."""
    return [
        fence_shape(config),
        *(shape for i in config.ids for shape in drone_shapes(i)),
    ]


SCENE_TYPE = "visualization_msgs/MarkerArray"
"""Type of a scene in a recording."""


def pack_scene(shapes: Iterable[SceneShape], born_ns: int) -> bytes:
    """Return the shapes as a visualization_msgs/MarkerArray.

    born_ns: time of the message, ns
    """
    markers = [(shape, points) for shape in shapes for points in _split(shape)]
    fields = [Leaf("count", "uint32")]
    values: list[object] = [len(markers)]
    for number, (shape, points) in enumerate(markers):
        fields += _marker_fields(len(points) if shape.kind in LINE_KINDS else 0)
        values += _marker_values(shape, points, born_ns, number)
    return Layout(fields, {}).pack(values)


def _split(shape: SceneShape) -> list[Mat]:
    """Return the points of each marker of a shape: all points of a line, else each alone."""
    if shape.kind in LINE_KINDS:
        return [shape.points]
    return [point[None] for point in shape.points]


def _marker_fields(points: int) -> list[Leaf]:
    """Return the fields of a marker with this number of points."""
    fields = list[Leaf]()
    for leaf in leaves("visualization_msgs/Marker", MARKER_DEFINITIONS):
        if leaf.path == "points":
            fields.append(Leaf("points count", "uint32"))
            fields += points * list(leaves("geometry_msgs/Point", MARKER_DEFINITIONS))
        else:
            fields.append(leaf)
    return fields


def _marker_values(
    shape: SceneShape, points: Mat, born_ns: int, number: int
) -> list[object]:
    """Return the values of a marker in the order of its fields."""
    lined = shape.kind in LINE_KINDS
    place = (0.0, 0.0, 0.0) if lined else points[0].tolist()
    size = (shape.size, 0.0, 0.0) if lined else 3 * (shape.size,)
    drawn = points if lined else points[:0]
    nothing: list[object] = [[], "", 0, 0, "", "", b"", []]
    return [
        *divmod(born_ns, NS_PER_SECOND),
        shape.frame,
        shape.name,
        number,
        int(shape.kind),
        RVIZ_SETTINGS.add_action,
        *place,
        *(0.0, 0.0, 0.0, 1.0),
        *size,
        *shape.color,
        *(0, 0),
        True,
        len(drawn),
        *drawn.ravel().tolist(),
        *nothing,
        shape.text,
        *("", "", b""),
        False,
    ]
