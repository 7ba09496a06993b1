"""The bridge to rmw_zenoh, as a router of ours hears it: tokens, keys, attachments, messages."""

import struct
import time

import numpy as np
import pytest
import zenoh
from ports import free_ports
from ros2_decoders import fields
from rosbags.typesys import Stores, get_typestore

from crazychoir.bridges.ros_bridge import RosBridge
from crazychoir.bus.network.zenoh_session import OutsideSession
from crazychoir.types import State

pytestmark = pytest.mark.system
NS = 1_700_000_000_000_000_123
SECONDS = 30.0


def until(condition):
    ends = time.monotonic() + SECONDS
    while not condition():
        assert time.monotonic() < ends, "not within so many seconds"
        time.sleep(0.02)


@pytest.fixture
def router():
    """A router at an endpoint, with all that it hears: samples, and keys of tokens."""
    config, endpoint = zenoh.Config(), f"tcp/127.0.0.1:{free_ports([0])}"
    for key, value in (
        ("mode", '"router"'),
        ("listen/endpoints", f'["{endpoint}"]'),
        ("scouting/multicast/enabled", "false"),
    ):
        config.insert_json5(key, value)
    samples, tokens = [], []
    with zenoh.open(config) as session:
        one = session.declare_subscriber("0/**", samples.append)
        lives = session.liveliness()
        other = lives.declare_subscriber(
            "@ros2_lv/**", lambda sample: tokens.append(str(sample.key_expr))
        )
        yield endpoint, samples, tokens
        one.undeclare()
        other.undeclare()


@pytest.mark.real_time
def test_what_a_router_of_ros_hears(router):
    pytest.importorskip("xxhash", reason="keys of rmw_zenoh need the extra `ros2`")
    endpoint, samples, tokens = router
    store = get_typestore(Stores.ROS2_JAZZY)
    with OutsideSession(endpoint) as outside:
        bridge = RosBridge(outside, 0, [3, 5])
        until(lambda: len(tokens) == 11)
        assert all(f"/{outside.id}/" in token for token in tokens)
        assert sum("/NN/" in token for token in tokens) == 1
        bridge.publish({}, NS)
        for _ in range(2):
            bridge.publish({3: (State.at((1.0, 2.0, 3.0)), NS - 1)}, NS)
        until(lambda: len(samples) == 9)
    heard = [
        (str(s.key_expr).split("/"), s.payload.to_bytes(), s.attachment.to_bytes())
        for s in samples
    ]
    topics = ["/".join(key[1:-2]) for key, *_ in heard]
    assert sorted(topics) == sorted(
        2 * ["drone3/pose", "drone3/odom", "tf", "drones"] + ["drone3/path"]
    )
    for key, data, attachment in heard:
        package, kind = key[-2].removesuffix("_").split("::msg::dds_::")
        assert key[-1] == store.hash_rihs01(f"{package}/msg/{kind}")
        found = fields(store.deserialize_cdr(data, f"{package}/msg/{kind}"))
        assert "header" in found or "transforms" in found or "markers" in found
        number, born_ns, length = struct.unpack("<qqB", attachment[:17])
        assert (number in (1, 2), born_ns, length, len(attachment)) == (
            True,
            NS,
            16,
            33,
        )
    pose = next(data for key, data, _ in heard if "pose" in key)
    found = fields(store.deserialize_cdr(pose, "geometry_msgs/msg/PoseStamped"))
    assert list(found["pose"]["position"].values()) == np.arange(1.0, 4.0).tolist()
    assert found["header"]["stamp"]["nanosec"] == NS % 1_000_000_000 - 1, (
        "when it was measured"
    )
