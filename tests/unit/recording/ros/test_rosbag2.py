"""A recording as a bag of ROS 2: read by rosbags with the definitions of ROS 2 itself, not with those in the file."""

import json
import resource
from collections import Counter

import numpy as np
import pytest
from mcap.reader import make_reader
from ros2_decoders import by_mcap_ros2, fields
from rosbags.rosbag2 import Reader
from rosbags.typesys import Stores, get_typestore

from crazychoir.errors import ConfigError
from crazychoir.recording.mcap.file import RecordingEntry, RecordingFile, Series
from crazychoir.recording.mcap.messages import FORM_BY_VALUE_TYPE, make_packer
from crazychoir.recording.ros import rosbag2
from crazychoir.recording.ros.rosbag2 import convert
from crazychoir.types import FPQR, FullState, Pose, State, Status

TENTH = 100_000_000
TURNED = np.array([0.0, 0.0, np.sqrt(0.5), np.sqrt(0.5)])
SAID = [  # drone, topic, value
    (3, "pose", Pose(np.arange(7.0))),
    (3, "state", State(np.array([1, 2, 3, 4, 5, 6, *TURNED, 7, 8, 9]))),
    (3, "truth", State(np.array([1.5, 2, 3, 4, 5, 6, *TURNED, 7, 8, 9]))),
    (3, "reference", FullState.at((1, 2, 3), yaw=np.pi / 2)),
    (3, "command", FPQR(np.arange(4.0))),
    (3, "status", Status("mission")),
    (3, "log", "a line"),
    (12, "state", State.at((9, 8, 7))),
]


@pytest.fixture
def recording(tmp_path):
    path = tmp_path / "a.mcap"
    file, entries = RecordingFile(path, {"version": "1"}, "{}", False), []
    for k, (drone, topic, value) in enumerate(SAID, 1):
        message = FORM_BY_VALUE_TYPE[type(value)]
        data = make_packer(message, drone)(value, k * TENTH)
        entries.append(
            RecordingEntry(
                Series(drone, topic, message), k * TENTH + 5, k * TENTH, data
            )
        )
    file.write(entries)
    file.close()
    return path


def read(folder):
    """(topic, type, ns, fields) of all messages."""
    store = get_typestore(Stores.ROS2_JAZZY)
    with Reader(folder) as reader:
        found = [
            (c.topic, c.msgtype, t, fields(store.deserialize_cdr(data, c.msgtype)))
            for c, t, data in reader.messages()
        ]
        assert reader.message_count == len(found)
        assert (reader.start_time, reader.end_time) == (found[0][2], found[-1][2] + 1)
        assert {c.topic: c.msgcount for c in reader.connections} == Counter(
            topic for topic, *_ in found
        )
    return found


def test_a_bag_is_read_by_what_ros_2_defines(recording, tmp_path):
    convert(recording, tmp_path / "bag")
    found = read(tmp_path / "bag")
    assert [(topic, t) for topic, _, t, _ in found if topic != "/tf"] == [
        (f"/drone{drone}/{topic}", k * TENTH + 5)
        for k, (drone, topic, _) in enumerate(SAID, 1)
    ]
    by_topic = {topic: (kind, told) for topic, kind, _, told in found}
    assert by_topic["/drone3/pose"][1]["pose"]["position"] == {
        "x": 0.0,
        "y": 1.0,
        "z": 2.0,
    }
    kind, reference = by_topic["/drone3/reference"]
    assert (kind, reference["header"]["frame_id"]) == (
        "geometry_msgs/msg/PoseStamped",
        "world",
    )
    assert reference["header"]["stamp"] == {"sec": 0, "nanosec": 4 * TENTH}
    assert reference["pose"]["position"] == {"x": 1.0, "y": 2.0, "z": 3.0}
    assert list(reference["pose"]["orientation"].values()) == pytest.approx(TURNED)
    kind, status = by_topic["/drone3/status"]
    assert kind == "std_msgs/msg/String"
    told = json.loads(status["data"])
    assert (told["phase"], told["cost"]) == ("mission", None), (
        "what is not finite is null"
    )
    assert json.loads(by_topic["/drone3/command"][1]["data"])["rates.y"] == 2.0
    assert by_topic["/drone3/log"] == ("std_msgs/msg/String", {"data": "a line"}), (
        "as it was"
    )
    kind, state = by_topic["/drone3/state"]
    assert (kind, state["child_frame_id"]) == ("nav_msgs/msg/Odometry", "drone3")
    assert state["twist"]["twist"]["angular"] == {"x": 7.0, "y": 8.0, "z": 9.0}


def test_each_message_keeps_the_time_when_it_was_born(recording, tmp_path):
    bag = convert(recording, tmp_path / "new" / "folder" / "bag")
    with bag.path.open("rb") as file:
        times = [
            (m.log_time, m.publish_time) for *_, m in make_reader(file).iter_messages()
        ]
    assert {came - born for came, born in times} == {5}
    assert (len(times), times[-1]) == (
        bag.count,
        (len(SAID) * TENTH + 5, len(SAID) * TENTH),
    )


def test_transforms_say_where_drones_were_in_truth_or_by_their_estimate(
    recording, tmp_path
):
    convert(recording, tmp_path / "bag")
    moves = [
        told["transforms"]
        for topic, _, _, told in read(tmp_path / "bag")
        if topic == "/tf"
    ]
    assert [len(one) for one in moves] == [1, 1]
    (truth,), (estimate,) = moves
    assert (truth["child_frame_id"], truth["header"]["frame_id"]) == ("drone3", "world")
    assert truth["header"]["stamp"] == {"sec": 0, "nanosec": 3 * TENTH}
    assert truth["transform"]["translation"] == {"x": 1.5, "y": 2.0, "z": 3.0}
    assert list(truth["transform"]["rotation"].values()) == pytest.approx(TURNED)
    assert (estimate["child_frame_id"], estimate["transform"]["translation"]["x"]) == (
        "drone12",
        9.0,
    )


def test_the_file_describes_itself(recording, tmp_path, monkeypatch):
    monkeypatch.setattr(rosbag2, "LARGEST_CHUNK", 500)
    bag = convert(recording, tmp_path / "bag")
    assert [(topic, kind, told) for topic, kind, _, told in by_mcap_ros2(bag.path)] == [
        (topic, kind, told) for topic, kind, _, told in read(tmp_path / "bag")
    ]


def test_a_bag_is_never_written_over(recording, tmp_path):
    (tmp_path / "bag").mkdir()
    with pytest.raises(ConfigError, match=r"--rosbag2.*File exists.*remove that one"):
        convert(recording, tmp_path / "bag")


@pytest.mark.parametrize("room", [0, 3000, 6000])
def test_a_full_disk_is_said_and_leaves_no_folder(
    recording, tmp_path, monkeypatch, room
):
    """No file may have more bytes than that: not the first chunk, not the second one, or not the index."""
    monkeypatch.setattr(rosbag2, "LARGEST_CHUNK", 1500)
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (room, before[1]))
    try:
        with pytest.raises(
            ConfigError, match=r"--rosbag2 = .*bag: File too large; .*another disk"
        ):
            convert(recording, tmp_path / "bag")
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert not (tmp_path / "bag").exists()
    assert convert(recording, tmp_path / "bag").path.stat().st_size > room
