"""What RViz is told when a drone falls silent and comes back: real places with their age, and no others."""

import asyncio
import struct
from types import SimpleNamespace

import pytest
from ros2_decoders import fields
from rosbags.typesys import Stores, get_typestore

from crazychoir.bridges.ros_bridge import ROS_BRIDGE, RosBridge, serve
from crazychoir.bus.port import PORT_ADDRESSES, Bus
from crazychoir.bus.topics import DRONE_TOPICS
from crazychoir.config.swarm_config import default_swarm
from crazychoir.launch.observer import Window
from crazychoir.recording.ros.rmw_zenoh import RMW_ZENOH, Endpoint
from crazychoir.runtime.clock import run_virtual
from crazychoir.types import State

AGE = 0.02
STORE = get_typestore(Stores.ROS2_JAZZY)


@pytest.fixture(autouse=True)
def without_digests(monkeypatch):
    """Replace the digest that names a publisher: not every machine has the library for it."""
    monkeypatch.setattr(Endpoint, "gid", bytes(RMW_ZENOH.gid_size))


class Outside:
    """A session with ROS that keeps what is said: (s, topic, fields)."""

    id = "aabb"

    def __init__(self):
        self.tokens, self.said = [], []

    def token(self, key):
        self.tokens.append(key)

    def put(self, key, data, attachment):
        parts = key.split("/")
        package, kind = parts[-2].removesuffix("_").split("::msg::dds_::")
        (said_ns,) = struct.unpack("<q", attachment[8:16])
        found = fields(STORE.deserialize_cdr(data, f"{package}/msg/{kind}"))
        self.said.append((said_ns / 1e9, "/".join(parts[1:-2]), found))

    def of(self, topic):
        return [(t, found) for t, name, found in self.said if name == topic]


def told(silent=lambda i, t: False, rate=10.0, seconds=3.0, leave=10.0):
    """Return what ROS is told, and when it ended. After t s drone i is at (t, i, 0), and says so unless silent."""

    async def main(clock):
        bus, outside = Bus(clock), Outside()
        for address in (PORT_ADDRESSES.first_observer + 1, 0, 1):
            bus.port(address)
        window = Window(
            clock, default_swarm(2), SimpleNamespace(bus=bus, directory={0: "", 1: ""})
        )
        clock.call_at(round(leave * 1e9), window.link.directory.clear)
        serving = asyncio.create_task(
            serve(window, RosBridge(outside, 0, [0, 1]), [0, 1], rate, seconds)
        )
        async for _ in clock.ticks(DRONE_TOPICS.state.rate):
            if serving.done():
                await serving
                return outside, clock.now()
            for i in (0, 1):
                if not silent(i, clock.now()):
                    bus.ports[i].publish(
                        DRONE_TOPICS.state, State.at((clock.now() - AGE, i, 0.0)), AGE
                    )

    return run_virtual(main)


def stamp(found):
    return found["header"]["stamp"]["sec"] + 1e-9 * found["header"]["stamp"]["nanosec"]


def test_a_place_is_said_with_the_time_when_it_was_measured():
    outside, ended = told()
    assert ended == pytest.approx(3.0, abs=0.1)
    for i in (0, 1):
        poses = outside.of(f"drone{i}/pose")
        assert len(poses) == pytest.approx(30, abs=2)
        for t, pose in poses:
            assert stamp(pose) == pytest.approx(pose["pose"]["position"]["x"], abs=1e-6)
            assert AGE - 1e-6 <= t - stamp(pose) <= AGE + 0.11
        paths = [path for _, path in outside.of(f"drone{i}/path")]
        assert [len(path["poses"]) for path in paths] == [
            1 + ROS_BRIDGE.poses_per_path * k for k in range(len(paths))
        ]
        assert len(paths) in (3, 4)
    for t, found in outside.of("tf"):
        assert [one["child_frame_id"] for one in found["transforms"]] == [
            "drone0",
            "drone1",
        ]
        assert all(
            AGE - 1e-6 <= t - stamp(one) <= AGE + 0.11 for one in found["transforms"]
        )


def test_a_drone_that_falls_silent_is_taken_away_once_and_comes_back():
    outside, _ = told(lambda i, t: i == 1 and 1.0 < t < 2.0)
    late = 1.0 - AGE + DRONE_TOPICS.state.max_age
    assert [t for t, _ in outside.of("drone1/pose") if late < t < 2.0] == []
    assert [t for t, _ in outside.of("drone1/pose") if t > 2.2], "it is back"
    silent = [found for t, found in outside.of("tf") if late < t < 2.0]
    assert {
        one["child_frame_id"] for found in silent for one in found["transforms"]
    } == {"drone0"}
    marks = [(t, one) for t, found in outside.of("drones") for one in found["markers"]]
    taken = [(t, one["ns"], one["id"]) for t, one in marks if one["action"] == 2]
    assert [(name, i) for _, name, i in taken] == [("drones", 1), ("names", 1)]
    assert taken[0][0] == pytest.approx(late, abs=0.11)
    assert {one["id"] for t, one in marks if late + 0.11 < t < 2.0} == {0}
    assert {one["id"] for t, one in marks if t > 2.2} == {0, 1}


def test_when_all_are_silent_they_are_taken_away_and_no_more_is_said():
    outside, _ = told(lambda i, t: t > 1.0)
    marks = [one for _, found in outside.of("drones") for one in found["markers"]]
    assert outside.said[-1][0] < 1.0 + DRONE_TOPICS.state.max_age + 0.11
    assert sorted((one["ns"], one["id"]) for one in marks if one["action"] == 2) == [
        ("drones", 0),
        ("drones", 1),
        ("names", 0),
        ("names", 1),
    ]
    assert all(found["transforms"] for _, found in outside.of("tf")), (
        "none that is empty"
    )


def test_a_slow_picture_is_whole():
    outside, _ = told(rate=1.0, seconds=5.0)
    marks = [found["markers"] for t, found in outside.of("drones") if t > 0.5]
    assert len(marks) >= 4
    assert {len(one) for one in marks} == {4}


def test_it_ends_when_all_have_gone():
    assert told(leave=1.0, seconds=100.0)[1] == pytest.approx(1.0, abs=0.2)
