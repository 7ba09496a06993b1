"""What of a flight ROS 2 programs know as it is: messages of its standard packages, in CDR.

What is already a standard message stays as it is; a reference is a PoseStamped; any other is a std_msgs/String with the
fields as JSON; and where a drone was, in truth, else by its own estimate, is a transform on /tf: world -> drone3.
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
REFERENCE, STATE_TYPE = MESSAGES[FullState].type, MESSAGES[State].type
POSE, TEXT, TF = "geometry_msgs/PoseStamped", "std_msgs/String", "tf2_msgs/TFMessage"
TF_TOPIC = "/tf"
Numbers = tuple[float, ...]


@dataclass(frozen=True)
class Said:
    """A message for ROS 2: its topic, its type as in DEFINITIONS, its bytes."""

    topic: str
    name: str
    data: bytes

    @property
    def type(self) -> str:
        """As ROS 2 names it."""
        return self.name.replace("/", "/msg/")

    @property
    def schema(self) -> str:
        """Its definition."""
        return schema(self.name, ROS)


def for_ros(message: Told, truths: frozenset[int]) -> list[Said]:
    """What a recorded message is for ROS 2; truths: drones whose truth was recorded."""
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
    """geometry_msgs/PoseStamped of a reference: its place, level, with its yaw."""
    x = _numbers(reference, MESSAGES[FullState].layout(reference.source.drone))
    return _layout(POSE, "").pack(
        (*x[:5], 0.0, 0.0, math.sin(0.5 * x[14]), math.cos(0.5 * x[14]))
    )


def transform(odometry: Told) -> bytes:
    """tf2_msgs/TFMessage of an Odometry: world -> drone."""
    x = _numbers(odometry, MESSAGES[State].layout(odometry.source.drone))
    return _layout(
        "geometry_msgs/TransformStamped", f"drone{odometry.source.drone}", 1
    ).pack((1, *x[:9]))


def _numbers(message: Told, layout: Layout) -> Numbers:
    """Seconds and nanoseconds of its stamp, and the rest."""
    return layout.numbers(message.data)


def _text(text: str) -> bytes:
    return _layout(TEXT, "").pack((text,))


@cache
def _layout(name: str, child: str, count: int | None = None) -> Layout:
    """Of a message in the world's frame; count: of a sequence of so many of them, one here."""
    constants = {"header.frame_id": "world", "child_frame_id": child}
    fields = list(leaves(name, ROS))
    return Layout(
        fields if count is None else [Leaf("count", "uint32"), *fields], constants
    )
