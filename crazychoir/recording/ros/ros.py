"""Messages of a flight as standard messages of ROS 2, in CDR.

A standard message stays as it is; a reference becomes a PoseStamped; any other message becomes a
std_msgs/String with its fields as JSON. In addition, the position of a drone becomes a transform
world -> drone3 on /tf: its true position, or its own estimate if the truth was not recorded.
"""

import math
from dataclasses import dataclass
from functools import cache

from crazychoir.bus.topics import DRONE_TOPICS
from crazychoir.recording.mcap.cdr import Definitions, Layout, Leaf, leaves, schema
from crazychoir.recording.mcap.definitions import MESSAGE_DEFINITIONS
from crazychoir.recording.mcap.messages import FORM_BY_VALUE_TYPE, in_json
from crazychoir.recording.mcap.sequence import RecordedMessage
from crazychoir.types import FullState, State

ROS_DEFINITIONS: Definitions = {
    **MESSAGE_DEFINITIONS,
    "geometry_msgs/Transform": "geometry_msgs/Vector3 translation\ngeometry_msgs/Quaternion rotation",
    "geometry_msgs/TransformStamped": """\
std_msgs/Header header
string child_frame_id
geometry_msgs/Transform transform""",
    "geometry_msgs/TwistStamped": "std_msgs/Header header\ngeometry_msgs/Twist twist",
    "tf2_msgs/TFMessage": "geometry_msgs/TransformStamped[] transforms",
}


@dataclass(frozen=True, slots=True)
class RosNames:
    """Names of the packages, types and topics of ROS 2."""

    standard_packages: tuple[str, ...] = ("std_msgs/", "geometry_msgs/", "nav_msgs/")
    """Prefixes of the types that every ROS 2 knows."""
    pose_type: str = "geometry_msgs/PoseStamped"
    """Type of a pose."""
    text_type: str = "std_msgs/String"
    """Type of a text."""
    transform_type: str = "tf2_msgs/TFMessage"
    """Type of the messages on the topic of transforms."""
    transform_topic: str = "/tf"
    """Topic of transforms."""


ROS_NAMES = RosNames()


REFERENCE_TYPE = FORM_BY_VALUE_TYPE[FullState].type
STATE_TYPE = FORM_BY_VALUE_TYPE[State].type
Numbers = tuple[float, ...]


@dataclass(frozen=True)
class RosMessage:
    """A message for ROS 2."""

    topic: str
    """Its topic."""
    name: str
    """Its type as in MESSAGE_DEFINITIONS."""
    data: bytes
    """Its bytes."""

    @property
    def type(self) -> str:
        """Its type in the notation of ROS 2."""
        return self.name.replace("/", "/msg/")

    @property
    def schema(self) -> str:
        """The definition of its type."""
        return schema(self.name, ROS_DEFINITIONS)


def to_ros_messages(
    message: RecordedMessage, truths: frozenset[int]
) -> list[RosMessage]:
    """Return the messages for ROS 2 that a recorded message becomes.

    truths: drones with a recorded truth
    """
    source = message.source
    name = source.type.replace("/msg/", "/")
    if name.startswith(ROS_NAMES.standard_packages):
        said = [RosMessage(source.name, name, message.data)]
    elif source.type == REFERENCE_TYPE:
        said = [
            RosMessage(source.name, ROS_NAMES.pose_type, pack_reference_pose(message))
        ]
    else:
        said = [
            RosMessage(
                source.name, ROS_NAMES.text_type, _text(in_json(message.values()))
            )
        ]
    moves = (
        DRONE_TOPICS.truth.name if source.drone in truths else DRONE_TOPICS.state.name
    )
    if source.topic == moves and source.type == STATE_TYPE:
        said.append(
            RosMessage(
                ROS_NAMES.transform_topic,
                ROS_NAMES.transform_type,
                pack_transform(source.drone, message.data),
            )
        )
    return said


def pack_reference_pose(reference: RecordedMessage) -> bytes:
    """Return a geometry_msgs/PoseStamped for a reference: its position, level, with its yaw."""
    x = _stamped_numbers(
        reference, FORM_BY_VALUE_TYPE[FullState].layout(reference.source.drone)
    )
    return _layout(ROS_NAMES.pose_type, "").pack(
        (*x[:5], 0.0, 0.0, math.sin(0.5 * x[14]), math.cos(0.5 * x[14]))
    )


def pack_transform(drone: int, odometry: bytes) -> bytes:
    """Return a tf2_msgs/TFMessage for the message of an Odometry: world -> drone."""
    x = FORM_BY_VALUE_TYPE[State].layout(drone).numbers(odometry)
    return _layout("geometry_msgs/TransformStamped", f"drone{drone}", 1).pack(
        (1, *x[:9])
    )


def _stamped_numbers(message: RecordedMessage, layout: Layout) -> Numbers:
    """Return the seconds and nanoseconds of its stamp, and its other numbers."""
    return layout.numbers(message.data)


def _text(text: str) -> bytes:
    return _layout(ROS_NAMES.text_type, "").pack((text,))


@cache
def _layout(name: str, child: str, count: int | None = None) -> Layout:
    """Return the layout of a message in the world's frame.

    child: the child frame
    count: None for the message alone; a number for a sequence with its count, one message here
    """
    constants = {"header.frame_id": "world", "child_frame_id": child}
    fields = list(leaves(name, ROS_DEFINITIONS))
    return Layout(
        fields if count is None else [Leaf("count", "uint32"), *fields], constants
    )
