"""Every value that is recorded comes back as it was; a recording of another version is refused."""

import msgspec
import numpy as np
import pytest

from crazychoir.bus.json_view import to_plain_values
from crazychoir.errors import ConfigError
from crazychoir.recording.mcap.decode import MESSAGE_BY_ROS_TYPE, MessageDecoder
from crazychoir.recording.mcap.file import RecordingEntry, RecordingFile, Series
from crazychoir.recording.mcap.messages import (
    FORM_BY_VALUE_TYPE,
    Exchanged,
    make_packer,
)
from crazychoir.recording.mcap.sequence import read_messages
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

Q = np.array([0.1, -0.3, 0.5, 0.8]) / np.linalg.norm([0.1, -0.3, 0.5, 0.8])
SAID = [
    Pose(np.arange(7.0)),
    State(np.array([1, 2, 3, 0.4, 0.5, 0.6, *Q, 7, 8, 9])),
    Acceleration(np.arange(3.0), 0.5),
    FullState(np.arange(14.0)),
    Goto(np.arange(3.0), 0.5, 2.0),
    FPQR(np.arange(4.0)),
    FRPY(np.arange(4.0)),
    Vel(np.arange(4.0)),
    Velocity(np.arange(3.0), 0.5),
    Acc(np.arange(3.0)),
    Drive(np.arange(2.0)),
    XYZ("go_to", np.arange(5.0)),
    LinkStatus("up", 0.1, 0.2, 0.9, -40.0, 3.9, 3, True, ["a", "b"], "r", 1, 2, "x"),
    Body("crashed", True),
    Status(
        "mission",
        "at 1/2 stops",
        3,
        4.5,
        4.2,
        1,
        2,
        3,
        4,
        [1],
        [2, 3],
        "p",
        "h",
        "note",
    ),
    Status("mission", hosts=["b"], offsets=[1000.5], offset_errors=[0.001]),
    Status("mission", link_faults=["full 12", "broken 1"]),
    "a line",
    {"success": True, "place": [1.0, 2.0]},
    Plan(np.ones((1, 25)), 0.5, np.zeros((0, 25)), 0.0, 3, {0: 2}, np.zeros(0)),
]


def recorded(path, values):
    file, entries = RecordingFile(path, {"version": "1"}, "{}", False), []
    for k, value in enumerate(values):
        message = FORM_BY_VALUE_TYPE[type(value)]
        entries.append(
            RecordingEntry(
                Series(12, f"topic{k}", message),
                k,
                k,
                make_packer(message, 12)(value, k),
            )
        )
    file.write(entries)
    file.close()
    return path


def test_what_was_said_comes_back(tmp_path):
    path = recorded(tmp_path / "a.mcap", SAID)
    values = MessageDecoder(path)
    found = [values.of(message) for message in read_messages(path)]
    assert [type(value) for value in found] == [type(value) for value in SAID]
    for value, was in zip(found, SAID, strict=True):
        assert rounded(value) == rounded(was)
    assert {type(value) for value in SAID} == {*FORM_BY_VALUE_TYPE} - {Exchanged}


def rounded(value):
    if isinstance(value, State):
        return value.flat.round(12).tolist()
    return to_plain_values(
        msgspec.structs.asdict(value) if isinstance(value, msgspec.Struct) else value
    )


def test_another_version_is_refused(tmp_path, monkeypatch):
    path = recorded(tmp_path / "a.mcap", SAID[:1])
    monkeypatch.setattr("crazychoir.recording.mcap.decode.MESSAGE_BY_ROS_TYPE", {})
    with pytest.raises(
        ConfigError,
        match=r"another geometry_msgs/msg/PoseStamped for /drone12/topic0.*version",
    ):
        MessageDecoder(path).of(next(iter(read_messages(path))))


def test_other_fields_under_the_same_name_are_refused(tmp_path, monkeypatch):
    path = recorded(tmp_path / "a.mcap", SAID[:2])
    monkeypatch.setitem(
        MESSAGE_BY_ROS_TYPE,
        FORM_BY_VALUE_TYPE[Pose].type,
        FORM_BY_VALUE_TYPE[State],
    )
    values, (pose, state) = MessageDecoder(path), read_messages(path)
    with pytest.raises(
        ConfigError, match="another geometry_msgs/msg/PoseStamped for /drone12/topic0"
    ):
        values.of(pose)
    assert rounded(values.of(state)) == rounded(SAID[1]), "what is as it was is read"


def test_a_round_message_cannot_be_decoded_to_a_value(tmp_path):
    path = recorded(tmp_path / "a.mcap", [Exchanged(1, 2, 0, "sum", b"")])
    with pytest.raises(ConfigError, match="another crazychoir_msgs/msg/Round"):
        MessageDecoder(path).of(next(iter(read_messages(path))))


def test_each_drone_has_values_of_its_own(tmp_path):
    """A field of another length lies elsewhere in the bytes: what is known of one series is not taken for another."""
    path = tmp_path / "a.mcap"
    file, message = (
        RecordingFile(path, {"version": "1"}, "{}", False),
        FORM_BY_VALUE_TYPE[State],
    )
    for drone in (3, 12345, 3):
        series = Series(drone, "state", message)
        file.write(
            [
                RecordingEntry(
                    series,
                    1,
                    1,
                    make_packer(message, drone)(State.at((drone, 2, 1)), 1),
                )
            ]
        )
    file.close()
    values = MessageDecoder(path)
    assert [values.of(message).p.tolist() for message in read_messages(path)] == [
        [drone, 2, 1] for drone in (3, 12345, 3)
    ]
