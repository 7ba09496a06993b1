"""The scene of a swarm, read by rosbags with the definitions of ROS 2, and by the schema in a recording."""

import numpy as np
import pytest
from ros2_decoders import decoded, fields
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from crazychoir.config.swarm_config import SwarmConfig
from crazychoir.recording.mcap.cdr import schema
from crazychoir.recording.ros.rviz import MARKER_DEFINITIONS
from crazychoir.recording.ros.scene import (
    SCENE_TYPE,
    SceneShape,
    ShapeKind,
    fence_shape,
    pack_scene,
    still_shapes,
)

KIND = SCENE_TYPE.replace("/", "/msg/")
NS = 12_000_000_345
CONFIG = SwarmConfig.of(
    {
        "name": "two",
        "drones": [{"id": 3, "home": [0, 0, 0]}, {"id": 8, "home": [1, 0, 0]}],
        "fence": {"min": [-1.0, -2.0, 0.0], "max": [3.0, 4.0, 2.0]},
    }
)


def read(data):
    """What rosbags finds by the definitions of ROS 2 Jazzy; and its own bytes of it are the same."""
    store = get_typestore(Stores.ROS2_JAZZY)
    message = store.deserialize_cdr(data, KIND)
    assert bytes(store.serialize_cdr(message, KIND)) == data
    return fields(message)["markers"]


def test_shapes_are_markers_that_move_with_their_frame():
    line = np.arange(9.0).reshape(3, 3)
    shapes = [
        SceneShape("way", ShapeKind.LINE_STRIP, line, 0.02, (1.0, 0.5, 0.0, 1.0)),
        SceneShape("two", ShapeKind.SPHERE, line[:2], 0.1, (0, 0, 1, 1), "drone3"),
        SceneShape("name", ShapeKind.TEXT, line[:1], 0.2, (0, 0, 1, 1), text="3"),
    ]
    way, one, other, name = read(pack_scene(shapes, NS))
    assert [list(p.values()) for p in way["points"]] == line.tolist()
    assert (way["ns"], way["type"], way["scale"]["x"]) == ("way", 4, 0.02)
    assert list(way["color"].values()) == [1.0, 0.5, 0.0, 1.0]
    assert list(other["pose"]["position"].values()) == [3.0, 4.0, 5.0]
    assert one["header"]["frame_id"] == "drone3"
    assert one["header"]["stamp"] == {"sec": 12, "nanosec": 345}
    assert (name["type"], name["text"], name["scale"]["z"]) == (9, "3", 0.2)
    assert len({(m["ns"], m["id"]) for m in (way, one, other, name)}) == 4
    assert all(m["frame_locked"] and m["action"] == 0 for m in (way, one, other, name))


def test_an_empty_scene_is_read():
    assert read(pack_scene([], NS)) == []


def test_the_fence_has_the_twelve_edges_of_its_box():
    edges = fence_shape(CONFIG).points.reshape(12, 2, 3)
    assert len({tuple(map(tuple, edge)) for edge in edges}) == 12
    sides = np.abs(edges[:, 1] - edges[:, 0])
    assert sorted(sides.sum(axis=1)) == sorted(4 * [4.0] + 4 * [6.0] + 4 * [2.0])
    assert np.count_nonzero(sides, axis=1).tolist() == 12 * [1]
    assert edges.min(axis=(0, 1)).tolist() == [-1.0, -2.0, 0.0]
    assert edges.max(axis=(0, 1)).tolist() == [3.0, 4.0, 2.0]


def test_a_still_scene_shows_each_drone_in_its_own_frame():
    markers = read(pack_scene(still_shapes(CONFIG), 0))
    frames = {marker["header"]["frame_id"] for marker in markers}
    assert frames == {"world", "drone3", "drone8"}
    assert [marker["text"] for marker in markers if marker["text"]] == ["3", "8"]


def test_the_schema_in_a_recording_is_read_by_two_decoders_and_has_the_hash_of_ros():
    text = schema(SCENE_TYPE, MARKER_DEFINITIONS)
    found = decoded(KIND, text, pack_scene(still_shapes(CONFIG), NS))
    assert len(found["markers"]) == 7
    types = get_types_from_msg(text, KIND)
    store = get_typestore(Stores.EMPTY)
    store.register(types)
    jazzy = get_typestore(Stores.ROS2_JAZZY)
    for kind in types:
        assert store.hash_rihs01(kind) == jazzy.hash_rihs01(kind), kind


@pytest.mark.parametrize("kind", [ShapeKind.LINE_LIST, ShapeKind.LINE_STRIP])
def test_a_line_of_thousands_of_points_is_read(kind):
    points = np.random.default_rng(1).normal(size=(3000, 3))
    data = pack_scene([SceneShape("a", kind, points, 0.01, (1, 1, 1, 1))], NS)
    assert len(read(data)[0]["points"]) == 3000
