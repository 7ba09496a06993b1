"""Messages for RViz about a swarm: poses, paths, transforms, and a ball and a name a drone."""

from collections.abc import Iterable, Mapping, Sequence

import numpy as np

from crazychoir.recording.mcap.cdr import Definitions, Layout, Leaf, leaves
from crazychoir.recording.ros.ros import ROS
from crazychoir.runtime.clock import SECOND
from crazychoir.types import State, Vec

FORMS: Definitions = {
    **ROS,
    "visualization_msgs/Marker": """\
std_msgs/Header header
string ns
int32 id
int32 type
int32 action
geometry_msgs/Pose pose
geometry_msgs/Vector3 scale
float32[4] color
int32 lifetime_sec
uint32 lifetime_nanosec
bool frame_locked
uint8[] points
uint8[] colors
string texture_resource
builtin_interfaces/Time texture_stamp
string texture_frame
string texture_format
uint8[] texture_data
uint8[] uv_coordinates
string text
string mesh_resource
string mesh_filename
uint8[] mesh_data
bool mesh_use_embedded_materials""",
}
"""Definitions of the messages by the layout of their bytes.

Sequences of messages that stay empty are declared as bytes.
"""
SPHERE = 2  # type of a marker
TEXT = 9  # type of a marker
ADD = 0  # action of a marker
DELETE = 2  # action of a marker
BALL = 0.1  # m: diameter of a ball
LETTERS = 0.12  # m: height of the name above it
FRAME = "world"
Places = Mapping[int, tuple[State, int]]
"""State of each drone by id, and the time of its birth in ns since 1970."""


def pose(state: State, born_ns: int) -> bytes:
    """Return a geometry_msgs/PoseStamped."""
    return _packed(
        "geometry_msgs/PoseStamped",
        [(*_header(born_ns), *state.p.tolist(), *state.q.tolist())],
    )


def path(places: Sequence[Vec], born_ns: int) -> bytes:
    """Return a nav_msgs/Path of places (3,) m, the oldest first."""
    head = list(leaves("std_msgs/Header", ROS))
    poses = len(places) * list(leaves("geometry_msgs/PoseStamped", ROS))
    values = [(*_header(born_ns), *p.tolist(), 0.0, 0.0, 0.0, 1.0) for p in places]
    flat = [*_header(born_ns), len(places), *(x for row in values for x in row)]
    return Layout([*head, Leaf("count", "uint32"), *poses], {}).pack(flat)


def transforms(places: Places) -> bytes:
    """Return a tf2_msgs/TFMessage: world -> drone3 for each drone."""
    rows = [
        (*_header(ns), f"drone{i}", *x.p.tolist(), *x.q.tolist())
        for i, (x, ns) in sorted(places.items())
    ]
    return _packed("geometry_msgs/TransformStamped", rows, counted=True)


def markers(places: Places, gone: Iterable[int] = ()) -> bytes:
    """Return a visualization_msgs/MarkerArray: a ball at each drone, and its number above it.

    gone: drones that have left; their markers are deleted
    """
    rows = []
    for i, (state, ns) in sorted(places.items()):
        rows.append(_marker(i, "drones", SPHERE, state.p, BALL, "", ns))
        rows.append(
            _marker(
                i,
                "names",
                TEXT,
                state.p + np.array([0.0, 0.0, BALL]),
                LETTERS,
                str(i),
                ns,
            )
        )
    for i in gone:
        for space, kind in (("drones", SPHERE), ("names", TEXT)):
            rows.append(_marker(i, space, kind, np.zeros(3), BALL, "", 0, DELETE))
    return _packed("visualization_msgs/Marker", rows, counted=True)


def _marker(
    i: int,
    space: str,
    kind: int,
    p: Vec,
    size: float,
    text: str,
    born_ns: int,
    action: int = ADD,
) -> tuple[object, ...]:
    place = (*p.tolist(), 0.0, 0.0, 0.0, 1.0)
    looks = (size, size, size, (0.0, 0.447, 0.698, 1.0), 1, 0, False)
    nothing: tuple[object, ...] = ([], [], "", 0, 0, "", "", [], [])
    return (
        *_header(born_ns),
        space,
        i,
        kind,
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
    return (*divmod(born_ns, SECOND), FRAME)


def _packed(
    name: str, rows: Sequence[Sequence[object]], counted: bool = False
) -> bytes:
    """Return messages of this type one after the other; counted: True to write them as a sequence."""
    fields = len(rows) * list(leaves(name, FORMS))
    values = [x for row in rows for x in row]
    if counted:
        return Layout([Leaf("count", "uint32"), *fields], {}).pack([len(rows), *values])
    return Layout(fields, {}).pack(values)
