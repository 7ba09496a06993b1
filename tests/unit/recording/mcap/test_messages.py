"""Every type of the table, field by field, as the decoders of others read it."""

import json
import math
from typing import get_args

import msgspec
import numpy as np
import pytest
from ros2_decoders import decoded

from crazychoir.bus.codec import encode
from crazychoir.bus.topics import OBSERVABLE_TOPICS, TOPIC_BY_NAME
from crazychoir.recording.mcap.definitions import MESSAGE_DEFINITIONS
from crazychoir.recording.mcap.messages import (
    FORM_BY_VALUE_TYPE,
    Exchanged,
    make_packer,
    usual_type,
)
from crazychoir.team.message_kind import EPOCH_SHIFT, MessageKind, join_contents
from crazychoir.types import (
    FPQR,
    FRPY,
    XYZ,
    Acceleration,
    Body,
    Command,
    FullState,
    Goto,
    Pose,
    Reference,
    State,
    Status,
    Vel,
)

BORN = 12_345_678_901
HEADER = {"stamp": {"sec": 12, "nanosec": 345_678_901}, "frame_id": "world"}


def sent(value, kind=None):
    """What others find, of drone 3."""
    message = FORM_BY_VALUE_TYPE[kind or type(value)]
    return decoded(message.type, message.schema, make_packer(message, 3)(value, BORN))


def xyz(v):
    return dict(zip("xyz", map(float, v), strict=False))


def numbers(n):
    return np.random.default_rng(n).normal(size=n)


def posed(p, q):
    return {"position": xyz(p), "orientation": xyz(q) | {"w": q[3]}}


def test_what_is_observed_asked_and_commanded_is_in_the_table():
    assert {usual_type(TOPIC_BY_NAME[name]) for name in OBSERVABLE_TOPICS} <= set(
        FORM_BY_VALUE_TYPE
    )
    assert {*get_args(Reference), *get_args(Command), Pose, State, Status} <= set(
        FORM_BY_VALUE_TYPE
    )


def test_pose():
    pose = Pose(numbers(7), 0.5)
    assert sent(pose) == {
        "header": HEADER,
        "pose": posed(pose.p.tolist(), pose.q.tolist()),
    }


def test_state_with_velocities_in_the_body_as_odometry_has_them():
    q = numbers(4) / np.linalg.norm(numbers(4))
    state = State(np.concatenate([[1, 2, 3], [4, 5, 6], q, [7, 8, 9]]))
    found = sent(state)
    linear = found["twist"]["twist"].pop("linear")
    assert found == {
        "header": HEADER,
        "child_frame_id": "drone3",
        "pose": {"pose": posed(state.p.tolist(), q.tolist()), "covariance": [0.0] * 36},
        "twist": {"twist": {"angular": xyz(state.w)}, "covariance": [0.0] * 36},
    }
    x, y, z, w = q
    r = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )
    assert list(linear.values()) == pytest.approx(r.T @ [4, 5, 6], abs=1e-14)


def test_references():
    a = Acceleration(numbers(3), 0.25)
    assert sent(a) == {"header": HEADER, "a": xyz(a.a), "yaw": 0.25}
    full = FullState(numbers(14))
    parts = {name: xyz(full.flat[3 * k : 3 * k + 3]) for k, name in enumerate("pvaj")}
    assert sent(full) == {
        "header": HEADER,
        **parts,
        "yaw": full.flat[12],
        "yaw_rate": full.flat[13],
    }
    goto = Goto(numbers(3), 1.0, 2.5)
    assert sent(goto) == {
        "header": HEADER,
        "p": xyz(goto.p),
        "yaw": 1.0,
        "duration": 2.5,
    }
    assert sent(Goto([1, 2, 3]))["p"] == xyz((1, 2, 3))


def test_command():
    command = FPQR(numbers(4))
    assert sent(command) == {
        "header": HEADER,
        "thrust": command.flat[0],
        "rates": xyz(command.flat[1:]),
    }


def test_commands_to_more_on_board():
    flat = numbers(4)
    named = dict(zip(("thrust", "roll", "pitch", "yaw_rate"), flat, strict=True))
    assert sent(FRPY(flat)) == {"header": HEADER, **named}
    assert sent(Vel(flat)) == {
        "header": HEADER,
        "v": xyz(flat[:3]),
        "yaw_rate": flat[3],
    }
    flat = numbers(5)
    place = {"p": xyz(flat[:3]), "yaw": flat[3], "duration": flat[4]}
    for verb in ("land", "go_to", ""):
        assert sent(XYZ(verb, flat)) == {"header": HEADER, "verb": verb, **place}


@pytest.mark.parametrize("suspect", [[], [5], [5, 6]])
def test_status(suspect):
    status = Status(
        "hovering",
        "größe",
        1 << 40,
        2.5,
        2.25,
        1,
        2,
        3,
        4,
        suspect,
        [7],
        "p0",
        "host",
        "note",
    )
    status = msgspec.structs.replace(
        status, hosts=["b", "größe"], offsets=[1e3, -0.25], offset_errors=[1e-4, 2e-3]
    )
    found = sent(status)
    assert found.pop("header") == HEADER
    assert list(found) == list(Status.__struct_fields__)
    assert found == {name: getattr(status, name) for name in Status.__struct_fields__}
    assert math.isnan(sent(Status(""))["cost"])


@pytest.mark.parametrize("harm", ["", "größe"])
def test_body(harm):
    assert sent(Body(harm, True)) == {
        "header": HEADER,
        "harm": harm,
        "flying": True,
        "cut": False,
    }


def test_log_line():
    assert sent("drone 3: größe") == {"data": "drone 3: größe"}
    assert sent("") == {"data": ""}


def test_any_value_as_json():
    value = {
        "place": np.arange(3.0),
        1: (True, None),
        "far": math.inf,
        (1, 2): np.float64(0.5),
    }
    found = json.loads(sent({**value, "s": State.at((1, 2, 3))})["json"])
    assert found["place"] == [0.0, 1.0, 2.0]
    assert (found["1"], found["far"], found["(1, 2)"]) == ([True, None], None, 0.5)
    assert found["s"]["flat"][:3] == [1.0, 2.0, 3.0]


def test_message_of_a_round():
    message = Exchanged(
        4,
        7,
        2 << EPOCH_SHIFT | MessageKind.REPEAT,
        "sum",
        encode({"x": np.arange(2.0)}),
    )
    expected = {
        "to": 4,
        "round": 7,
        "epoch": 2,
        "kind": "repeat",
        "channel": "sum",
        "json": '{"x": [0.0, 1.0]}',
    }
    assert sent(message) == {"header": HEADER, **expected}
    assert sent(message._replace(payload=b"", flags=MessageKind.GONE))["json"] == ""
    assert sent(message._replace(flags=MessageKind.GONE))["kind"] == "gone"
    assert sent(message._replace(flags=15))["kind"] == "kind 15"
    two_rounds = join_contents(message.payload, encode({"x": np.arange(3.0)}))
    double = message._replace(flags=MessageKind.DOUBLE, payload=two_rounds)
    assert sent(double)["kind"] == "double"
    assert sent(double)["json"] == expected["json"]


def test_definitions_are_those_of_ros_where_they_bear_its_name():
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    for store in (Stores.ROS2_HUMBLE, Stores.ROS2_JAZZY):
        known = get_typestore(store).fielddefs
        for name, text in MESSAGE_DEFINITIONS.items():
            ros = name.replace("/", "/msg/")
            if not name.startswith("crazychoir"):
                assert get_types_from_msg(text, ros)[ros][1] == known[ros][1], name
