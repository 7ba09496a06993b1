"""The bytes of what RViz shows, read by rosbags with the definitions of ROS 2; keys, tokens, attachments as written."""

import struct

import numpy as np
import pytest
from pamoja import ros2
from ros2_decoders import fields
from rosbags.typesys import Stores, get_typestore
from zenoh_ros2_sdk.attachment import Attachment
from zenoh_ros2_sdk.entity import EndpointEntity, EntityKind, NodeEntity
from zenoh_ros2_sdk.keyexpr import (
    endpoint_liveliness_keyexpr,
    node_liveliness_keyexpr,
)
from zenoh_ros2_sdk.qos import QosProfile
from zenoh_ros2_sdk.utils import (
    compute_service_type_hash,
    get_type_hash,
    ros2_to_dds_type,
)

from crazychoir.recording.ros import rviz
from crazychoir.recording.ros.rmw_zenoh import (
    TYPE_HASHES,
    Endpoint,
    EndpointKind,
    node_token,
    reply_attachment,
)
from crazychoir.types import State

NS = 12_345_000_000_678
STAMP = {"sec": 12345, "nanosec": 678}
STORE = get_typestore(Stores.ROS2_JAZZY)
TURNED = [0.0, 0.0, float(np.sqrt(0.5)), float(np.sqrt(0.5))]
PLACES = {
    12: (State(np.array([1, 2, 3, 0, 0, 0, *TURNED, 0, 0, 0])), NS),
    3: (State.at((4.0, 5.0, 6.0)), NS + 9),
}


def read(kind, data):
    """What another decoder finds; and its own bytes of it are the same."""
    message = STORE.deserialize_cdr(data, kind)
    assert bytes(STORE.serialize_cdr(message, kind)) == data
    return fields(message)


def test_a_pose():
    found = read("geometry_msgs/msg/PoseStamped", rviz.pack_pose(*PLACES[12]))
    assert found["header"] == {"stamp": STAMP, "frame_id": "world"}
    assert list(found["pose"]["position"].values()) == [1.0, 2.0, 3.0]
    assert list(found["pose"]["orientation"].values()) == TURNED


@pytest.mark.parametrize("n", [0, 1, 3])
def test_a_path(n):
    places = np.arange(3.0 * n).reshape(n, 3)
    found = read("nav_msgs/msg/Path", rviz.pack_path(list(places), NS))
    assert found["header"] == {"stamp": STAMP, "frame_id": "world"}
    assert [
        list(one["pose"]["position"].values()) for one in found["poses"]
    ] == places.tolist()
    assert [
        list(one["pose"]["orientation"].values()) for one in found["poses"]
    ] == n * [[0.0, 0.0, 0.0, 1.0]]
    assert [one["header"] for one in found["poses"]] == n * [found["header"]]


def test_transforms():
    found = read("tf2_msgs/msg/TFMessage", rviz.pack_transforms(PLACES))["transforms"]
    assert [one["child_frame_id"] for one in found] == ["drone3", "drone12"]
    assert [one["header"] for one in found] == [
        {"stamp": {**STAMP, "nanosec": 687}, "frame_id": "world"},
        {"stamp": STAMP, "frame_id": "world"},
    ]
    assert list(found[1]["transform"]["translation"].values()) == [1.0, 2.0, 3.0]
    assert list(found[1]["transform"]["rotation"].values()) == TURNED


def test_markers():
    found = read(
        "visualization_msgs/msg/MarkerArray", rviz.pack_markers(PLACES, gone=[5])
    )["markers"]
    assert [
        (one["ns"], one["id"], one["type"], one["action"], one["text"]) for one in found
    ] == [
        ("drones", 3, 2, 0, ""),
        ("names", 3, 9, 0, "3"),
        ("drones", 12, 2, 0, ""),
        ("names", 12, 9, 0, "12"),
        ("drones", 5, 2, 2, ""),
        ("names", 5, 9, 2, ""),
    ]
    assert [one["header"]["stamp"]["nanosec"] for one in found[:4]] == [
        687,
        687,
        678,
        678,
    ]
    assert {one["header"]["frame_id"] for one in found} == {"world"}
    assert [list(one["scale"].values()) for one in found[:2]] == [3 * [0.1], 3 * [0.12]]
    assert [one["frame_locked"] for one in found[:4]] == 4 * [0]
    assert found[0]["pose"]["position"] == {"x": 4.0, "y": 5.0, "z": 6.0}
    assert list(found[0]["pose"]["orientation"].values()) == [0.0, 0.0, 0.0, 1.0]
    assert list(found[0]["color"].values()) == pytest.approx([0.0, 0.447, 0.698, 1.0])
    assert found[3]["pose"]["position"]["z"] == pytest.approx(3.1)


@pytest.mark.parametrize("name", TYPE_HASHES)
def test_two_other_programs_compute_the_same_hashes(name):
    digest = ros2.type_hash_digest(f"RIHS01_{TYPE_HASHES[name]}")
    assert digest.hex() == TYPE_HASHES[name]
    if name == "std_srvs/srv/Trigger":
        request = "uint8 structure_needs_at_least_one_member"
        found = compute_service_type_hash(
            name, request, "bool success\nstring message", {}
        )
    else:
        found = STORE.hash_rihs01(name)
        first, *others = STORE.generate_msgdef(name, ros_version=2)[0].split(
            80 * "=" + "\n"
        )
        nested = (text.removeprefix("MSG: ").split("\n", 1) for text in others)
        definitions = {other: text for other, text in nested}
        definitions = {
            other.replace("/", "/msg/") if "/msg/" not in other else other: text
            for other, text in definitions.items()
        }
        assert get_type_hash(name, first, definitions) == found
    assert found == f"RIHS01_{TYPE_HASHES[name]}"


POSES = Endpoint(
    0, "aabb", "crazychoir", 7, "/drone3/pose", "geometry_msgs/msg/PoseStamped"
)


def test_keys_and_tokens():
    kind = f"geometry_msgs::msg::dds_::PoseStamped_/RIHS01_{TYPE_HASHES['geometry_msgs/msg/PoseStamped']}"
    assert POSES.key == f"0/drone3/pose/{kind}"
    assert (
        POSES.token
        == f"@ros2_lv/0/aabb/0/7/MP/%/%/crazychoir/%drone3%pose/{kind}/::,10:,:,:,,"
    )
    assert (
        node_token(5, "aabb", "crazychoir") == "@ros2_lv/5/aabb/0/0/NN/%/%/crazychoir"
    )


def test_an_attachment():
    xxhash = pytest.importorskip(
        "xxhash", reason="keys of rmw_zenoh need the extra `ros2`"
    )
    data = POSES.attachment(3, NS)
    assert len(data) == 33
    assert struct.unpack("<qqB", data[:17]) == (3, NS, 16)
    digest = xxhash.xxh3_128_digest(POSES.token.encode())
    assert data[17:] == digest[:7:-1] + digest[7::-1], (
        "the lower half first, each little-endian"
    )


@pytest.mark.parametrize(
    ("kind", "topic", "type_name"),
    [
        (EndpointKind.PUBLISHER, "/drone3/pose", "geometry_msgs/msg/PoseStamped"),
        (
            EndpointKind.SUBSCRIPTION,
            "/drone3/goal_pose",
            "geometry_msgs/msg/PoseStamped",
        ),
        (EndpointKind.SERVICE, "/crazychoir/land", "std_srvs/srv/Trigger"),
    ],
)
def test_two_other_programs_write_the_same_keys_and_tokens(kind, topic, type_name):
    endpoint = Endpoint(7, "aabb", "crazychoir", 5, topic, type_name, kind)
    rihs = f"RIHS01_{TYPE_HASHES[type_name]}"
    assert endpoint.key == ros2.entity_key(7, topic, type_name, rihs)
    node = NodeEntity(7, "aabb", 0, "crazychoir")
    theirs = EndpointEntity(
        node,
        5,
        EntityKind(kind.value),
        topic,
        ros2_to_dds_type(type_name),
        rihs,
        QosProfile().encode(),
    )
    assert endpoint.token == endpoint_liveliness_keyexpr(theirs)
    assert ros2.percent_mangle(topic) in endpoint.token
    assert node_token(7, "aabb", "crazychoir") == node_liveliness_keyexpr(node)


def test_an_answer_has_the_number_and_the_client_of_its_request():
    request = Attachment(41, NS, bytes(range(16))).to_bytes()
    answer = Attachment.from_bytes(reply_attachment(request, NS + 5))
    assert (answer.sequence_id, answer.timestamp_ns) == (41, NS + 5)
    assert answer.gid == bytes(range(16))
    with pytest.raises(struct.error):
        reply_attachment(b"short", NS)
