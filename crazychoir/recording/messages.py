"""The one table of what a recording holds: for each of our types a ROS 2 message, and its values in the order of its
fields. Standard messages where one fits, so that Foxglove, PlotJuggler and rosbags show them as they are.

A message with a header: header.stamp is when the value was born, header.frame_id "world".
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache, lru_cache
from json import dumps
from typing import Any, NamedTuple, get_args

from crazychoir.bus.codec import decode
from crazychoir.bus.plain import plain
from crazychoir.bus.topics import Topic
from crazychoir.recording.cdr import Layout, Leaf, leaves, schema
from crazychoir.runtime.clock import SECOND
from crazychoir.swarm.rounds import AHEAD, CREDIT, DATA, FIN, FIN_TOO, KIND_BITS, KINDS, REPEAT, WANT
from crazychoir.types import (
    FPQR,
    FRPY,
    XYZ,
    Acc,
    Acceleration,
    Body,
    Drive,
    FullState,
    Goto,
    LinkStatus,
    Plan,
    Pose,
    State,
    Status,
    Vel,
    Velocity,
)

DEFINITIONS = {
    "builtin_interfaces/Time": "int32 sec\nuint32 nanosec",
    "std_msgs/Header": "builtin_interfaces/Time stamp\nstring frame_id",
    "std_msgs/String": "string data",
    "geometry_msgs/Point": "float64 x\nfloat64 y\nfloat64 z",
    "geometry_msgs/Vector3": "float64 x\nfloat64 y\nfloat64 z",
    "geometry_msgs/Quaternion": "float64 x\nfloat64 y\nfloat64 z\nfloat64 w",
    "geometry_msgs/Pose": "geometry_msgs/Point position\ngeometry_msgs/Quaternion orientation",
    "geometry_msgs/PoseStamped": "std_msgs/Header header\ngeometry_msgs/Pose pose",
    "geometry_msgs/PoseWithCovariance": "geometry_msgs/Pose pose\nfloat64[36] covariance",
    "geometry_msgs/Twist": "geometry_msgs/Vector3 linear\ngeometry_msgs/Vector3 angular",
    "geometry_msgs/TwistWithCovariance": "geometry_msgs/Twist twist\nfloat64[36] covariance",
    "nav_msgs/Odometry": """\
std_msgs/Header header
string child_frame_id
geometry_msgs/PoseWithCovariance pose
geometry_msgs/TwistWithCovariance twist""",
    "crazychoir_msgs/Acceleration": """\
std_msgs/Header header
geometry_msgs/Vector3 a  # m/s2, world
float64 yaw  # rad""",
    "crazychoir_msgs/FullState": """\
std_msgs/Header header
geometry_msgs/Point p  # m, world
geometry_msgs/Vector3 v  # m/s
geometry_msgs/Vector3 a  # m/s2
geometry_msgs/Vector3 j  # m/s3
float64 yaw  # rad
float64 yaw_rate  # rad/s""",
    "crazychoir_msgs/Goto": """\
std_msgs/Header header
geometry_msgs/Point p  # m, world
float64 yaw  # rad
float64 duration  # s, 0: as fast as the limits allow""",
    "crazychoir_msgs/FPQR": """\
std_msgs/Header header
float64 thrust  # N, along the body's z
geometry_msgs/Vector3 rates  # p, q, r rad/s, body""",
    "crazychoir_msgs/FRPY": """\
std_msgs/Header header
float64 thrust  # N, along the body's z
float64 roll  # rad
float64 pitch  # rad, positive: nose down
float64 yaw_rate  # rad/s""",
    "crazychoir_msgs/Vel": """\
std_msgs/Header header
geometry_msgs/Vector3 v  # m/s, world
float64 yaw_rate  # rad/s""",
    "crazychoir_msgs/Velocity": """\
std_msgs/Header header
geometry_msgs/Vector3 v  # m/s, world
float64 yaw  # rad""",
    "crazychoir_msgs/Acc": """\
std_msgs/Header header
geometry_msgs/Vector3 a  # m/s2, world""",
    "crazychoir_msgs/Drive": """\
std_msgs/Header header
float64 v  # m/s, along the heading
float64 w  # rad/s""",
    "crazychoir_msgs/XYZ": """\
std_msgs/Header header
string verb
geometry_msgs/Point p  # m, world
float64 yaw  # rad
float64 duration  # s""",
    "crazychoir_msgs/Body": """\
std_msgs/Header header
string harm  # what has broken it
bool flying  # in the air, flown there by commands""",
    "crazychoir_msgs/LinkStatus": """\
std_msgs/Header header
string state  # connecting, up, degraded, lost, absent or refused
float64 silence  # s
float64 latency  # s
float64 answered  # share of packets
float64 rssi  # dBm
float64 battery  # V
int64 supervisor  # bits of the firmware's
bool flying
string[] problems  # why it may not take off
string release  # of the firmware
int64 refused  # plans
int64 reconnected
string astray  # how its body moves otherwise than it does""",
    "crazychoir_msgs/Status": """\
std_msgs/Header header
string phase
string task
int64 round
float64 cost  # NaN before there is a plan
int64 sent
int64 lost
int64 resent
int64 dropped
int64[] suspect
int64[] gone
string process
string host
string note""",
    "crazychoir_msgs/Value": """\
std_msgs/Header header
string json  # null for what is not finite""",
    "crazychoir_msgs/Round": """\
std_msgs/Header header
int64 to  # the drone that it arrived at
int64 round
int64 epoch  # of the team
string kind
string channel
string json  # what was exchanged; empty where the kind has no content""",
}
"""Texts of the standard messages as ROS 2 Humble to Jazzy have them, without comments; and our own."""


KIND_NAMES = {
    DATA: "data", REPEAT: "repeat", AHEAD: "ahead", WANT: "want", CREDIT: "credit", FIN: "fin", FIN_TOO: "fin too",
}  # fmt: skip
"""What a message of a round says."""


class Exchanged(NamedTuple):
    """One message of a round as it arrived at drone `to`; flags: epoch and kind;  payload: of the codec."""

    to: int
    round: int
    flags: int
    channel: str
    payload: bytes


@dataclass(frozen=True)
class Message:
    """How a type is written: the ROS message, and its values after the header's stamp, without constants."""

    name: str
    values: Callable[[Any], Sequence[Any]]

    @property
    def type(self) -> str:
        """As ROS 2 names it."""
        return self.name.replace("/", "/msg/")

    @property
    def schema(self) -> str:
        """Its text."""
        return schema(self.name, DEFINITIONS)

    @property
    def leaves(self) -> list[Leaf]:
        """Its fields."""
        return list(leaves(self.name, DEFINITIONS))

    @property
    def stamped(self) -> bool:
        """Whether it begins with a header."""
        return self.leaves[0].path == "header.stamp.sec"

    def layout(self, drone: int) -> Layout:
        """Its bytes, of this drone."""
        return _layout(self, drone)


@cache
def _layout(message: Message, drone: int) -> Layout:
    constants = {
        "header.frame_id": "world", "child_frame_id": f"drone{drone}",
        "pose.covariance": None, "twist.covariance": None,
    }  # fmt: skip
    return Layout(message.leaves, constants)


Pack = Callable[[Any, int], bytes]


def packer(message: Message, drone: int) -> Pack:
    """The function that makes a message of a value of this drone that was born at that time, in ns."""
    pack, values = message.layout(drone).pack, message.values
    if not message.stamped:
        return lambda value, born_ns: pack(values(value))
    return lambda value, born_ns: pack((*divmod(born_ns, SECOND), *values(value)))


def odometry(state: State) -> list[float]:
    """p, q, v_b, w: nav_msgs/Odometry wants velocities in the frame of the body.

        v_b = R(q)^T v = v - q_w t + u x t,  t = 2 u x v,  u = (q_x, q_y, q_z)

    v_b: (3,) m/s, body;  v: (3,) m/s, world. Plain numbers: a compiled law takes longer to be called.
    """
    x, y, z, vx, vy, vz, a, b, c, d, p, q, r = state.flat.tolist()
    tx, ty, tz = 2.0 * (b * vz - c * vy), 2.0 * (c * vx - a * vz), 2.0 * (a * vy - b * vx)
    forward = vx - d * tx + b * tz - c * ty
    left = vy - d * ty + c * tx - a * tz
    up = vz - d * tz + a * ty - b * tx
    return [x, y, z, a, b, c, d, forward, left, up, p, q, r]


def in_json(value: Any) -> str:
    """A value of any kind, as a text."""
    return dumps(plain(value), default=str)


def exchanged(message: Exchanged) -> tuple[Any, ...]:
    """The fields of crazychoir_msgs/Round."""
    to, k, flags, channel, payload = message
    return to, k, flags >> KIND_BITS, KIND_NAMES.get(flags & KINDS, "unknown"), channel, _content(payload)


@lru_cache(maxsize=64)  # one payload goes to all neighbours
def _content(payload: bytes) -> str:
    return in_json(decode(payload)) if payload else ""


MESSAGES: dict[Any, Message] = {
    Pose: Message("geometry_msgs/PoseStamped", lambda pose: pose.flat.tolist()),
    State: Message("nav_msgs/Odometry", odometry),
    Acceleration: Message("crazychoir_msgs/Acceleration", lambda wanted: (*wanted.a.tolist(), wanted.yaw)),
    FullState: Message("crazychoir_msgs/FullState", lambda wanted: wanted.flat.tolist()),
    Goto: Message("crazychoir_msgs/Goto", lambda wanted: (*map(float, wanted.p), wanted.yaw, wanted.duration)),
    FPQR: Message("crazychoir_msgs/FPQR", lambda command: command.flat.tolist()),
    FRPY: Message("crazychoir_msgs/FRPY", lambda command: command.flat.tolist()),
    Vel: Message("crazychoir_msgs/Vel", lambda command: command.flat.tolist()),
    Velocity: Message("crazychoir_msgs/Velocity", lambda wanted: (*wanted.v.tolist(), wanted.yaw)),
    Acc: Message("crazychoir_msgs/Acc", lambda command: command.flat.tolist()),
    Drive: Message("crazychoir_msgs/Drive", lambda command: command.flat.tolist()),
    XYZ: Message("crazychoir_msgs/XYZ", lambda command: (command.verb, *command.flat.tolist())),
    LinkStatus: Message("crazychoir_msgs/LinkStatus", lambda link: [getattr(link, n) for n in link.__struct_fields__]),
    Body: Message("crazychoir_msgs/Body", lambda body: (body.harm, body.flying)),
    Status: Message("crazychoir_msgs/Status", lambda status: [getattr(status, n) for n in status.__struct_fields__]),
    str: Message("std_msgs/String", lambda line: (line,)),
    Plan: Message("crazychoir_msgs/Value", lambda plan: (in_json(plan),)),
    dict: Message("crazychoir_msgs/Value", lambda value: (in_json(value),)),
    Exchanged: Message("crazychoir_msgs/Round", exchanged),
}
"""By the type of a value; any other value is written as a dictionary is."""


def usual(topic: Topic) -> Any:
    """The type whose messages have the topic's name alone: its only one, or the first of several."""
    return (get_args(topic.type) or (topic.type,))[0]
