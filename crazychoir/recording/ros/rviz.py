"""Messages for RViz about a swarm: poses, paths, transforms, and a ball and a name a drone."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from crazychoir.recording.mcap.cdr import Definitions, Layout, Leaf, leaves
from crazychoir.recording.ros.ros import ROS_DEFINITIONS
from crazychoir.runtime.clock import NS_PER_SECOND
from crazychoir.types import State, Vec

MARKER_DEFINITIONS: Definitions = {
    **ROS_DEFINITIONS,
    "builtin_interfaces/Duration": "int32 sec\nuint32 nanosec",
    "std_msgs/ColorRGBA": "float32 r\nfloat32 g\nfloat32 b\nfloat32 a",
    "sensor_msgs/CompressedImage": "std_msgs/Header header\nstring format\nuint8[] data",
    "visualization_msgs/UVCoordinate": "float32 u\nfloat32 v",
    "visualization_msgs/MeshFile": "string filename\nuint8[] data",
    "visualization_msgs/Marker": """\
std_msgs/Header header
string ns
int32 id
int32 type
int32 action
geometry_msgs/Pose pose
geometry_msgs/Vector3 scale
std_msgs/ColorRGBA color
builtin_interfaces/Duration lifetime
bool frame_locked
geometry_msgs/Point[] points
std_msgs/ColorRGBA[] colors
string texture_resource
sensor_msgs/CompressedImage texture
visualization_msgs/UVCoordinate[] uv_coordinates
string text
string mesh_resource
visualization_msgs/MeshFile mesh_file
bool mesh_use_embedded_materials""",
    "visualization_msgs/MarkerArray": "visualization_msgs/Marker[] markers",
}
"""Markers, and all messages in them, as in ROS 2 Jazzy."""


@dataclass(frozen=True, slots=True)
class RvizSettings:
    """How RViz shows the drones: its codes of markers, their sizes, and the frame of all messages."""

    sphere_type: int = 2
    """Type of a marker that is a sphere."""
    text_marker_type: int = 9
    """Type of a marker that is a text."""
    add_action: int = 0
    """Action that adds a marker or changes it."""
    delete_action: int = 2
    """Action that deletes a marker."""
    ball_diameter: float = 0.1
    """m: diameter of the ball at a drone."""
    letter_height: float = 0.12
    """m: height of the letters of a drone's name above its ball."""
    frame: str = "world"
    """Frame of the coordinates."""


RVIZ_SETTINGS = RvizSettings()


@dataclass(frozen=True, slots=True)
class MarkerGroup:
    """Markers of one kind, at most one a drone."""

    namespace: str
    """Name of the group in RViz."""
    shape: int
    """Type of its markers, a code of RViz."""


BALL_MARKERS = MarkerGroup("drones", RVIZ_SETTINGS.sphere_type)
"""The balls at the drones."""
NAME_MARKERS = MarkerGroup("names", RVIZ_SETTINGS.text_marker_type)
"""The numbers above the balls."""

Places = Mapping[int, tuple[State, int]]
"""State of each drone by id, and the time of its birth in ns since 1970."""


def pack_pose(state: State, born_ns: int) -> bytes:
    """Return a geometry_msgs/PoseStamped."""
    return _pack_messages(
        "geometry_msgs/PoseStamped",
        [(*_header(born_ns), *state.p.tolist(), *state.q.tolist())],
    )


def pack_path(places: Sequence[Vec], born_ns: int) -> bytes:
    """Return a nav_msgs/Path of places (3,) m, the oldest first."""
    head = list(leaves("std_msgs/Header", ROS_DEFINITIONS))
    poses = len(places) * list(leaves("geometry_msgs/PoseStamped", ROS_DEFINITIONS))
    values = [(*_header(born_ns), *p.tolist(), 0.0, 0.0, 0.0, 1.0) for p in places]
    flat = [*_header(born_ns), len(places), *(x for row in values for x in row)]
    return Layout([*head, Leaf("count", "uint32"), *poses], {}).pack(flat)


def pack_transforms(places: Places) -> bytes:
    """Return a tf2_msgs/TFMessage: world -> drone3 for each drone."""
    rows = [
        (*_header(ns), f"drone{i}", *x.p.tolist(), *x.q.tolist())
        for i, (x, ns) in sorted(places.items())
    ]
    return _pack_messages("geometry_msgs/TransformStamped", rows, counted=True)


def pack_markers(places: Places, gone: Iterable[int] = ()) -> bytes:
    """Return a visualization_msgs/MarkerArray: a ball at each drone, and its number above it.

    gone: drones that have left; their markers are deleted
    """
    rows = []
    for i, (state, ns) in sorted(places.items()):
        rows.append(
            _marker(
                i,
                BALL_MARKERS,
                state.p,
                RVIZ_SETTINGS.ball_diameter,
                "",
                ns,
            )
        )
        rows.append(
            _marker(
                i,
                NAME_MARKERS,
                state.p + np.array([0.0, 0.0, RVIZ_SETTINGS.ball_diameter]),
                RVIZ_SETTINGS.letter_height,
                str(i),
                ns,
            )
        )
    for i in gone:
        for group in (BALL_MARKERS, NAME_MARKERS):
            rows.append(
                _marker(
                    i,
                    group,
                    np.zeros(3),
                    RVIZ_SETTINGS.ball_diameter,
                    "",
                    0,
                    RVIZ_SETTINGS.delete_action,
                )
            )
    return _pack_messages("visualization_msgs/Marker", rows, counted=True)


def _marker(
    i: int,
    group: MarkerGroup,
    p: Vec,
    size: float,
    text: str,
    born_ns: int,
    action: int = RVIZ_SETTINGS.add_action,
) -> tuple[object, ...]:
    place = (*p.tolist(), 0.0, 0.0, 0.0, 1.0)
    looks = (size, size, size, 0.0, 0.447, 0.698, 1.0, 1, 0, False)
    nothing: tuple[object, ...] = ([], [], "", 0, 0, "", "", [], [])
    return (
        *_header(born_ns),
        group.namespace,
        i,
        group.shape,
        action,
        *place,
        *looks,
        *nothing,
        text,
        "",
        "",
        [],
        False,
    )


def _header(born_ns: int) -> tuple[int, int, str]:
    return (*divmod(born_ns, NS_PER_SECOND), RVIZ_SETTINGS.frame)


def _pack_messages(
    name: str, rows: Sequence[Sequence[object]], counted: bool = False
) -> bytes:
    """Return messages of this type one after the other; counted: True to write them as a sequence."""
    fields = len(rows) * list(leaves(name, MARKER_DEFINITIONS))
    values = [x for row in rows for x in row]
    if counted:
        return Layout([Leaf("count", "uint32"), *fields], {}).pack([len(rows), *values])
    return Layout(fields, {}).pack(values)
