"""The only table of what a recording holds: a ROS 2 message for each type of value.

For each type it has the values in the order of the message's fields, and the function that makes
the value of them again. Standard messages are used where they fit, so that Foxglove, PlotJuggler
and rosbags show them as they are. In a message with a header, header.stamp is when the value was
born and header.frame_id is "world".
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache, lru_cache
from json import dumps, loads
from typing import Any, NamedTuple, get_args

import numpy as np

from crazychoir.bus.codec import decode
from crazychoir.bus.json_view import to_plain_values
from crazychoir.bus.topics import Topic
from crazychoir.recording.mcap.cdr import Layout, Leaf, leaves, schema
from crazychoir.recording.mcap.definitions import MESSAGE_DEFINITIONS
from crazychoir.recording.mcap.odometry import odometry_numbers, state_of
from crazychoir.runtime.clock import NS_PER_SECOND
from crazychoir.team.message_kind import (
    EPOCH_SHIFT,
    KIND_MASK,
    MessageKind,
    split_contents,
)
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
    Vec,
    Vel,
    Velocity,
)

WAY_COLUMNS = 25
"""Numbers in a row of a plan's way."""
KIND_NAMES = {kind.value: kind.name.lower().replace("_", " ") for kind in MessageKind}
"""Names of the kinds of round messages."""


class Exchanged(NamedTuple):
    """One message of a round as it arrived."""

    to: int
    """The drone at which it arrived."""
    round: int
    """Number of the round."""
    flags: int
    """Epoch and kind."""
    channel: str
    """Name of the channel."""
    payload: bytes
    """Its bytes, of the codec."""


@dataclass(frozen=True)
class RecordedForm:
    """The written form of the values of one type."""

    name: str
    """Name of the ROS message."""
    values: Callable[[Any], Sequence[Any]]
    """Returns the values of the fields after the header's stamp, without constants."""
    value: Callable[[Sequence[Any]], Any] | None = None
    """Makes the value of these again; None if it is never replayed."""

    @property
    def type(self) -> str:
        """Its name in the notation of ROS 2."""
        return self.name.replace("/", "/msg/")

    @property
    def schema(self) -> str:
        """The text of its definition."""
        return schema(self.name, MESSAGE_DEFINITIONS)

    @property
    def leaves(self) -> list[Leaf]:
        """Its fields."""
        return list(leaves(self.name, MESSAGE_DEFINITIONS))

    @property
    def stamped(self) -> bool:
        """True if it begins with a header."""
        return self.leaves[0].path == "header.stamp.sec"

    def layout(self, drone: int) -> Layout:
        """Return the layout of its bytes for a drone."""
        return _layout(self, drone)


@cache
def _layout(message: RecordedForm, drone: int) -> Layout:
    constants = {
        "header.frame_id": "world",
        "child_frame_id": f"drone{drone}",
        "pose.covariance": None,
        "twist.covariance": None,
    }
    return Layout(message.leaves, constants)


Pack = Callable[[Any, int], bytes]
"""Returns the message for a value and the time of its birth, ns."""


def make_packer(message: RecordedForm, drone: int) -> Pack:
    """Return the function that makes a message of a value of this drone and the time of its birth."""
    pack = message.layout(drone).pack
    values = message.values
    if not message.stamped:
        return lambda value, born_ns: pack(values(value))
    return lambda value, born_ns: pack(
        (*divmod(born_ns, NS_PER_SECOND), *values(value))
    )


def in_json(value: Any) -> str:
    """Return a value of any kind as JSON."""
    return dumps(to_plain_values(value), default=str)


def round_fields(message: Exchanged) -> tuple[Any, ...]:
    """Return the fields of crazychoir_msgs/Round."""
    to, k, flags, channel, payload = message
    kind = flags & KIND_MASK
    if kind == MessageKind.DOUBLE:
        payload, _ = split_contents(payload)
    return (
        to,
        k,
        flags >> EPOCH_SHIFT,
        KIND_NAMES.get(kind, f"kind {kind}"),
        channel,
        _content(payload),
    )


@lru_cache(maxsize=64)  # one payload goes to all neighbours
def _content(payload: bytes) -> str:
    return in_json(decode(payload)) if payload else ""


def _vec(x: Sequence[Any]) -> Vec:
    return np.array(x, dtype=float)


def _value_from_json(x: Sequence[Any]) -> Any:
    raw = loads(x[0])
    return _plan_from_json(raw) if isinstance(raw, dict) and "awaits" in raw else raw


def _plan_from_json(raw: Mapping[str, Any]) -> Plan:
    way, offer = (_vec(raw[name]).reshape(-1, WAY_COLUMNS) for name in ("way", "offer"))
    agreed = {int(i): number for i, number in raw["agreed"].items()}
    return Plan(
        way, raw["since"], offer, raw["due"], raw["number"], agreed, _vec(raw["awaits"])
    )


def _array(name: str, kind: Callable[[Vec], Any]) -> RecordedForm:
    """Return the message of a type that is one array."""
    return RecordedForm(
        name, lambda value: value.flat.tolist(), lambda x: kind(_vec(x))
    )


def _record(name: str, kind: Callable[..., Any]) -> RecordedForm:
    """Return the message of a type with the same fields as the message."""
    return RecordedForm(
        name,
        lambda value: [getattr(value, n) for n in value.__struct_fields__],
        lambda x: kind(*x),
    )


FORM_BY_VALUE_TYPE: dict[Any, RecordedForm] = {
    Pose: _array("geometry_msgs/PoseStamped", Pose),
    State: RecordedForm("nav_msgs/Odometry", odometry_numbers, state_of),
    Acceleration: RecordedForm(
        "crazychoir_msgs/Acceleration",
        lambda wanted: (*wanted.a.tolist(), wanted.yaw),
        lambda x: Acceleration(_vec(x[:3]), x[3]),
    ),
    FullState: _array("crazychoir_msgs/FullState", FullState),
    Goto: RecordedForm(
        "crazychoir_msgs/Goto",
        lambda wanted: (*map(float, wanted.p), wanted.yaw, wanted.duration),
        lambda x: Goto(_vec(x[:3]), x[3], x[4]),
    ),
    FPQR: _array("crazychoir_msgs/FPQR", FPQR),
    FRPY: _array("crazychoir_msgs/FRPY", FRPY),
    Vel: _array("crazychoir_msgs/Vel", Vel),
    Velocity: RecordedForm(
        "crazychoir_msgs/Velocity",
        lambda wanted: (*wanted.v.tolist(), wanted.yaw),
        lambda x: Velocity(_vec(x[:3]), x[3]),
    ),
    Acc: _array("crazychoir_msgs/Acc", Acc),
    Drive: _array("crazychoir_msgs/Drive", Drive),
    XYZ: RecordedForm(
        "crazychoir_msgs/XYZ",
        lambda command: (command.verb, *command.flat.tolist()),
        lambda x: XYZ(x[0], _vec(x[1:])),
    ),
    LinkStatus: _record("crazychoir_msgs/LinkStatus", LinkStatus),
    Body: _record("crazychoir_msgs/Body", Body),
    Status: _record("crazychoir_msgs/Status", Status),
    str: RecordedForm("std_msgs/String", lambda line: (line,), lambda x: x[0]),
    Plan: RecordedForm(
        "crazychoir_msgs/Value", lambda plan: (in_json(plan),), _value_from_json
    ),
    dict: RecordedForm(
        "crazychoir_msgs/Value", lambda value: (in_json(value),), _value_from_json
    ),
    Exchanged: RecordedForm("crazychoir_msgs/Round", round_fields),
}
"""Messages by the type of a value; any other value is written like a dictionary."""


def usual_type(topic: Topic) -> Any:
    """Return the type of messages that are recorded under the topic's name alone.

    It is the only type of the topic, or the first of several.
    """
    return (get_args(topic.type) or (topic.type,))[0]
