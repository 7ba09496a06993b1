import pytest

from crazychoir.bus.port import PORT_ADDRESSES
from crazychoir.bus.topics import DRONE_TOPICS
from crazychoir.config.digest import compute_digest
from crazychoir.config.swarm_config import SwarmConfig
from crazychoir.errors import ConfigError


def swarm(*drones, **tables):
    rows = [
        {
            "id": i,
            "home": [float(i), 0.0, 0.0],
            "uri": f"udp://127.0.0.1:{19850 + i}",
            **drone,
        }
        for i, drone in enumerate(drones)
    ]
    return {"name": "lab", "drones": rows, **tables}


@pytest.mark.parametrize(
    "drones", [({"body": "a"}, {"body": "a"}), ({"body": "cf1"}, {})]
)
def test_two_drones_with_one_body_are_refused(drones):
    with pytest.raises(
        ConfigError, match=r"drones\[1\].body = \"(a|cf1)\": drones\[0\] has this body"
    ):
        SwarmConfig.of(swarm(*drones))


OFTEN = {"log_rate": 50.0}


def test_drones_that_no_camera_sees_may_have_any_body():
    config = SwarmConfig.of(
        swarm(
            {"body": "cf1"},
            {"pose": "onboard"},
            {"uri": "sim://", "body": "cf1"},
            radio=OFTEN,
        )
    )
    assert config.topology.seen == (0,)
    assert (
        config.topology.source(DRONE_TOPICS.pose, 0)
        == config.topology.source(DRONE_TOPICS.truth, 0)
        == PORT_ADDRESSES.camera_offset
    )
    assert config.topology.source(DRONE_TOPICS.body, 0) == PORT_ADDRESSES.body_offset
    assert (
        config.topology.source(DRONE_TOPICS.pose, 1) == PORT_ADDRESSES.body_offset + 1
    )
    assert config.topology.source(DRONE_TOPICS.pose, 2) == 2


def test_a_replay_without_a_file_is_refused():
    with pytest.raises(
        ConfigError, match=r"mocap.file: found nothing; allowed: a recording"
    ):
        SwarmConfig.of(swarm({}, mocap={"source": "replay"}))


def test_a_recording_is_relative_to_the_swarm_file_and_its_folder_nobodys_business(
    tmp_path,
):
    config = SwarmConfig.of(swarm({}, mocap={"source": "replay", "file": "a.csv"}))
    (tmp_path / "s.json").write_text(config.dumps())
    loaded = SwarmConfig.load(tmp_path / "s.json")
    assert loaded.mocap.file == str(tmp_path / "a.csv")
    assert compute_digest(loaded) == compute_digest(config)
