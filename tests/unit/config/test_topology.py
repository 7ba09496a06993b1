"""Which process has the body of each drone and sends its pose."""

import re
from pathlib import Path

from squares import square

from crazychoir.bus.port import PORT_ADDRESSES
from crazychoir.bus.topics import DRONE_TOPICS
from crazychoir.config.swarm_config import (
    SwarmConfig,
)
from crazychoir.radio.budget import compute_setpoint_rates

ROOT = Path(__file__).parents[3]


def test_only_lightweight_drones_without_an_owner_are_in_their_agents() -> None:
    assert square().topology.owned == ()
    assert square(first='uri = "sim://motors"').topology.owned == (0,)
    assert square("world.owned = true").topology.owned == (0, 1, 2, 3)
    assert [
        square().topology.source(topic, 2)
        for topic in (
            DRONE_TOPICS.pose,
            DRONE_TOPICS.truth,
            DRONE_TOPICS.body,
            DRONE_TOPICS.state,
        )
    ] == [
        2,
        2,
        2,
        2,
    ]
    owned = square("world.owned = true")
    body = PORT_ADDRESSES.body_offset + 2
    assert [
        owned.topology.source(topic, 2)
        for topic in (
            DRONE_TOPICS.pose,
            DRONE_TOPICS.truth,
            DRONE_TOPICS.body,
            DRONE_TOPICS.state,
        )
    ] == [
        body,
        body,
        body,
        2,
    ]


def test_dongles_carry_the_six_of_the_laboratory_if_their_uris_say_so() -> None:
    text = (ROOT / "deploy" / "lab6.toml").read_text()
    config = SwarmConfig.loads(
        re.sub(r"id = (\d)", r'id = \1\nuri = "udp://127.0.0.1:1985\1"', text),
        "lab6.toml",
    )
    assert compute_setpoint_rates(config) == {0: 100.0, 1: 100.0, 2: 100.0}


def test_a_changed_swarm_has_its_own_topology() -> None:
    config = square()
    assert config.topology.owned == ()
    changed = config.replace(world={"owned": True})
    assert changed.topology.elsewhere == (0, 1, 2, 3)
    assert config.topology is config.topology
    assert config == square(), "the topology is no part of the swarm file"
    assert SwarmConfig.loads(changed.dumps()) == changed
