"""Transforms and a scene in a recording, as three readers find them; and what they cost."""

import numpy as np
import pytest
from mcap.reader import NonSeekingReader
from pamoja.ros2 import CdrReader
from ros2_decoders import by_mcap_ros2, by_rosbags

from crazychoir.config.swarm_config import SwarmConfig
from crazychoir.recording.mcap.file import RecordingEntry, RecordingFile, Series
from crazychoir.recording.mcap.messages import FORM_BY_VALUE_TYPE, make_packer
from crazychoir.recording.mcap.sequence import read_messages
from crazychoir.recording.ros.views import FlightViews
from crazychoir.types import State, Status

MS = 1_000_000
CONFIG = SwarmConfig.of(
    {"name": "two", "drones": [{"id": i, "home": [0.1 * i, 0, 0]} for i in (3, 8)]}
)


class Flight:
    """A recording of what drones say: times in ms."""

    def __init__(self, path, views=True):
        shown = FlightViews(CONFIG) if views else None
        self.file = RecordingFile(path, {"version": "1"}, "{}", False, views=shown)
        self.series, self.entries = {}, []

    def say(self, drone, topic, at, value, late=0):
        form = FORM_BY_VALUE_TYPE[type(value)]
        series = self.series.setdefault((drone, topic), Series(drone, topic, form))
        born_ns = (at - late) * MS
        data = make_packer(form, drone)(value, born_ns)
        self.entries.append(RecordingEntry(series, at * MS, born_ns, data))

    def end(self, batches=1):
        for part in np.array_split(np.arange(len(self.entries)), batches):
            self.file.write([self.entries[k] for k in part])
        self.file.close()
        return self.file


@pytest.fixture
def path(tmp_path):
    return tmp_path / "flight.mcap"


def transforms(path):
    """(ms, frame, x) of each transform."""
    return [
        (time // MS, one["child_frame_id"], one["transform"]["translation"]["x"])
        for topic, _, time, found in by_rosbags(path)
        if topic == "/tf"
        for one in found["transforms"]
    ]


def at(x):
    return State.at((x, 0.0, 1.0))


def test_transforms_follow_the_truth_while_there_is_one_else_the_estimate(path):
    flight = Flight(path)
    for ms in range(0, 2000, 10):
        flight.say(3, "state", ms, at(1.0))
        if ms % 50 == 0 and not 500 < ms < 1500:
            flight.say(3, "truth", ms, at(2.0))
    flight.end(batches=7)
    found = transforms(path)
    assert {frame for _, frame, _ in found} == {"drone3"}
    by_estimate = [ms for ms, _, x in found if x == 1.0 and ms > 0]
    assert 1000 <= min(by_estimate) <= 1050
    assert max(by_estimate) <= 1500
    times = [ms for ms, *_ in found]
    assert np.diff(times).min() >= 45
    assert len(times) == pytest.approx(0.5 * 20 + 0.5 * 20 + 0.5 * 20, abs=2)


def test_three_readers_find_the_same_transforms_and_one_scene(path):
    flight = Flight(path)
    turned = np.array([1, 2, 3, 0, 0, 0, 0.0, 0.0, 0.6, 0.8, 0, 0, 0], dtype=float)
    flight.say(8, "truth", 7, State(turned), late=2)
    flight.say(3, "truth", 9, at(5.0))
    flight.end()
    one = [row for row in by_mcap_ros2(path) if row[0] in ("/tf", "/scene")]
    assert one == [row for row in by_rosbags(path) if row[0] in ("/tf", "/scene")]
    scene, first, _ = one
    assert (scene[0], scene[1]) == ("/scene", "visualization_msgs/msg/MarkerArray")
    frames = {marker["header"]["frame_id"] for marker in scene[3]["markers"]}
    assert frames == {"world", "drone3", "drone8"}
    (moved,) = first[3]["transforms"]
    assert moved["header"] == {
        "stamp": {"sec": 0, "nanosec": 5 * MS},
        "frame_id": "world",
    }
    assert moved["child_frame_id"] == "drone8"
    assert list(moved["transform"]["translation"].values()) == [1.0, 2.0, 3.0]
    assert list(moved["transform"]["rotation"].values()) == [0.0, 0.0, 0.6, 0.8]
    with path.open("rb") as file:
        messages = NonSeekingReader(file).iter_messages(topics=["/tf"])
        data = [message.data for *_, message in messages]
    by_hand = CdrReader(data[0])
    assert [by_hand.read_u32() for _ in range(3)] == [1, 0, 5 * MS]
    words = [by_hand.read_u32() for _ in range(6)]
    assert (words[0], words[3]) == (len("world") + 1, len("drone8") + 1)
    numbers = [by_hand.read_f64() for _ in range(7)]
    assert numbers == [1.0, 2.0, 3.0, 0.0, 0.0, 0.6, 0.8]
    assert len(data) == 2


def test_views_count_as_no_messages_and_are_skipped_by_our_own_readers(path):
    flight = Flight(path)
    flight.say(3, "status", 1, Status("flying"))
    flight.say(3, "truth", 2, at(1.0))
    file = flight.end()
    assert file.written == 2
    names = [message.source.name for message in read_messages(path)]
    assert names == ["/drone3/status", "/drone3/truth"]
    assert len(by_rosbags(path)) == 4


def test_a_transform_takes_less_than_half_the_bytes_of_a_state(tmp_path):
    sizes = []
    for views in (False, True):
        flight = Flight(tmp_path / f"{views}.mcap", views)
        draw = np.random.default_rng(1)
        for ms in range(0, 5000, 10):
            for i in (3, 8):
                state = State(draw.normal(size=13))
                flight.say(i, "state", ms, state)
                if ms % 50 == 0:
                    flight.say(i, "truth", ms, State(draw.normal(size=13)))
        flight.end(batches=20)
        sizes.append(flight.file.path.stat().st_size)
    per_state = sizes[0] / len(flight.entries)
    per_transform = (sizes[1] - sizes[0]) / len(transforms(flight.file.path))
    assert 0.0 < per_transform < 0.5 * per_state
