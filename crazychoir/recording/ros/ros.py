"""Messages of a flight as standard messages of ROS 2, in CDR.

A standard message stays as it is; a reference becomes a PoseStamped; any other message becomes a
std_msgs/String with its fields as JSON. In addition, the position of a drone becomes a transform
world -> drone3 on /tf: its true position, or its own estimate if the truth was not recorded.
"""

import math
from dataclasses import dataclass
from functools import cache

from crazychoir.bus.topics import STATE, TRUTH
from crazychoir.recording.mcap.cdr import Definitions, Layout, Leaf, leaves, schema
from crazychoir.recording.mcap.definitions import DEFINITIONS
from crazychoir.recording.mcap.messages import MESSAGES, in_json
from crazychoir.recording.mcap.sequence import Told
from crazychoir.types import FullState, State

ROS: Definitions = {
    **DEFINITIONS,
    "geometry_msgs/Transform": "geometry_msgs/Vector3 translation\ngeometry_msgs/Quaternion rotation",
    "geometry_msgs/TransformStamped": """\
std_msgs/Header header
string child_frame_id
geometry_msgs/Transform transform""",
    "tf2_msgs/TFMessage": "geometry_msgs/TransformStamped[] transforms",
}
STANDARD = ("std_msgs/", "geometry_msgs/", "nav_msgs/")
REFERENCE = MESSAGES[FullState].type
STATE_TYPE = MESSAGES[State].type
POSE = "geometry_msgs/PoseStamped"
TEXT = "std_msgs/String"
TF = "tf2_msgs/TFMessage"
TF_TOPIC = "/tf"
Numbers = tuple[float, ...]


@dataclass(frozen=True)
class Said:
    """A message for ROS 2."""

    topic: str
    """Its topic."""
    name: str
    """Its type as in DEFINITIONS."""
    data: bytes
    """Its bytes."""

    @property
    def type(self) -> str:
        """Its type in the notation of ROS 2."""
        return self.name.replace("/", "/msg/")

    @property
    def schema(self) -> str:
        """The definition of its type."""
        return schema(self.name, ROS)


def for_ros(message: Told, truths: frozenset[int]) -> list[Said]:
    """Return the messages for ROS 2 that a recorded message becomes.

    truths: drones with a recorded truth
    """
    source = message.source
    name = source.type.replace("/msg/", "/")
    if name.startswith(STANDARD):
        said = [Said(source.name, name, message.data)]
    elif source.type == REFERENCE:
        said = [Said(source.name, POSE, pose(message))]
    else:
        said = [Said(source.name, TEXT, _text(in_json(message.values())))]
    moves = TRUTH.name if source.drone in truths else STATE.name
    if source.topic == moves and source.type == STATE_TYPE:
        said.append(Said(TF_TOPIC, TF, transform(message)))
    return said


def pose(reference: Told) -> bytes:
    """Return a geometry_msgs/PoseStamped for a reference: its position, level, with its yaw."""
    x = _numbers(reference, MESSAGES[FullState].layout(reference.source.drone))
    return _layout(POSE, "").pack(
        (*x[:5], 0.0, 0.0, math.sin(0.5 * x[14]), math.cos(0.5 * x[14]))
    )


def transform(odometry: Told) -> bytes:
    """Return a tf2_msgs/TFMessage for an Odometry: world -> drone."""
    x = _numbers(odometry, MESSAGES[State].layout(odometry.source.drone))
    return _layout(
        "geometry_msgs/TransformStamped", f"drone{odometry.source.drone}", 1
    ).pack((1, *x[:9]))


def _numbers(message: Told, layout: Layout) -> Numbers:
    """Return the seconds and nanoseconds of its stamp, and its other numbers."""
    return layout.numbers(message.data)


def _text(text: str) -> bytes:
    return _layout(TEXT, "").pack((text,))


@cache
def _layout(name: str, child: str, count: int | None = None) -> Layout:
    """Return the layout of a message in the world's frame.

    child: the child frame
    count: None for the message alone; a number for a sequence with its count, one message here
    """
    constants = {"header.frame_id": "world", "child_frame_id": child}
    fields = list(leaves(name, ROS))
    return Layout(
        fields if count is None else [Leaf("count", "uint32"), *fields], constants
    )
