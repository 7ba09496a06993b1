"""What must hold for drones that a radio reaches: addresses, dongles, hosts, and what a dongle carries."""

import pytest

from crazychoir.bus.port import PORT_ADDRESSES
from crazychoir.bus.topics import DRONE_TOPICS
from crazychoir.config.addresses import PROCESS_NUMBERS, Addresses
from crazychoir.config.swarm_config import SwarmConfig
from crazychoir.errors import ConfigError


def swarm(*uris: str, head: str = "", keys: str = "") -> SwarmConfig:
    rows = [
        f'[[drones]]\nid = {i}\nhome = [{i}, 0, 0]\nuri = "{uri}"\n{keys}\n'
        for i, uri in enumerate(uris)
    ]
    return SwarmConfig.loads(f'name = "lab"\n{head}\n' + "\n".join(rows), "lab.toml")


def udp(n: int, dongles: int = 1) -> SwarmConfig:
    rows = [
        f'[[drones]]\nid = {i}\nhome = [{i % 4}, {i // 4}, 0]\nuri = "udp://127.0.0.1:{19850 + i}"\n'
        f"dongle = {i % dongles}\n"
        for i in range(n)
    ]
    return SwarmConfig.loads('name = "lab"\n' + "".join(rows), "lab.toml")


def test_dongles_come_from_the_key_or_the_uri() -> None:
    config = swarm("radio://2/80/2M/E7E7E7E700", "udp://10.0.0.1:19850", "sim://")
    assert config.topology.dongles == {0: (1,), 2: (0,)}
    assert (
        config.topology.reached,
        config.topology.seen,
        config.topology.owned,
        config.topology.elsewhere,
    ) == (
        (0, 1),
        (0, 1),
        (),
        (0, 1),
    )


def test_owners_listen_below_the_drones() -> None:
    ports = {
        process: int(at.rpartition(":")[2])
        for process, at in Addresses(udp(4, 3)).endpoints().items()
    }
    assert ports == {
        PROCESS_NUMBERS.first_dongle - 2: 7455,
        PROCESS_NUMBERS.first_dongle - 1: 7456,
        PROCESS_NUMBERS.first_dongle: 7457,
        PROCESS_NUMBERS.motion_capture: 7458,
        0: 7460,
        1: 7461,
        2: 7462,
        3: 7463,
    }
    assert list(ports) == sorted(ports), "each process connects to those before it"


def test_each_topic_has_its_source_address() -> None:
    config = swarm("udp://h:1", "sim://")
    assert [
        config.topology.source(topic, 0)
        for topic in (
            DRONE_TOPICS.pose,
            DRONE_TOPICS.truth,
            DRONE_TOPICS.link,
            DRONE_TOPICS.state,
        )
    ] == [
        PORT_ADDRESSES.camera_offset,
        PORT_ADDRESSES.camera_offset,
        PORT_ADDRESSES.body_offset,
        0,
    ]
    assert config.topology.source(DRONE_TOPICS.pose, 1) == 1
    own = swarm("udp://h:1", head="[radio]\nlog_rate = 50", keys='pose = "onboard"')
    assert (own.topology.source(DRONE_TOPICS.pose, 0), own.topology.seen) == (
        PORT_ADDRESSES.body_offset,
        (),
    )
    assert (config.topology.unseen, own.topology.unseen) == ((), (0,))


@pytest.mark.parametrize(
    ("uris", "head", "keys", "text"),
    [
        (
            ["udp://127.0.0.1"],
            "",
            "",
            'drones[0].uri: found "udp://127.0.0.1"; allowed: udp://HOST:PORT',
        ),
        (["udp://127.0.0.1:0"], "", "", "udp://HOST:PORT"),
        (["radio://0/126/2M/E7E7E7E7E7"], "", "", "a channel of 0 to 125"),
        (["radio://0/80/3M/E7E7E7E7E7"], "", "", "250K, 1M or 2M"),
        (["radio://0/80/2M/E7"], "", "", "an address of 10 hexadecimal digits"),
        (
            ["udp://a:1", "udp://a:1"],
            "",
            "",
            'drones[1].uri = "udp://a:1": drones[0] has this address',
        ),
        (
            ["radio://0/80/2M/E7E7E7E7E7", "radio://0/80/2M/e7e7e7e7e7"],
            "",
            "",
            "drones[0] has this address",
        ),
        (["radio://0/80/2M/E7E7E7E7E7"], "", "dongle = 1", "its uri says dongle 0"),
        (
            ["udp://a:1"],
            "[[radio.dongles]]\ndongle = 0\nhost = 'x'",
            "",
            "there is no such host",
        ),
        (
            ["udp://a:1"],
            "[hosts]\nx = '10.0.0.1'",
            "host = 'x'",
            "Add [[radio.dongles]] with dongle and host",
        ),
        (
            ["udp://a:1"],
            "",
            'pose = "onboard"',
            "radio.log_rate = 10.0: drones[0] sends its own pose",
        ),
        (
            ["udp://a:1"],
            "base_port = 1025",
            "",
            "owners of worlds and radios listen down to base_port - 3",
        ),
    ],
)
def test_what_is_refused(uris: list[str], head: str, keys: str, text: str) -> None:
    with pytest.raises(ConfigError) as caught:
        swarm(*uris, head=head, keys=keys)
    assert text in str(caught.value)


def test_two_drones_of_a_channel_may_not_end_alike_if_their_poses_are_broadcast() -> (
    None
):
    uris = "radio://0/80/2M/E7E7E7E703", "radio://0/80/2M/E7E7E7E803"
    with pytest.raises(ConfigError) as caught:
        swarm(*uris)
    assert (
        "drones[0] has the last byte 03, too: one would take the other's pose"
        in str(caught.value)
    )
    assert "set broadcast = false in [radio]" in str(caught.value)
    assert swarm(*uris, head="[radio]\nbroadcast = false").topology.reached == (0, 1)
    other = swarm(uris[0], "radio://0/82/2M/E7E7E7E803")
    assert other.topology.reached == (0, 1), "another channel"


SEEN_URIS = (
    "radio://0/80/2M/E7E7E7E703",
    "radio://0/80/2M/E7E7E7E704",
)


def with_own_pose(uri: str, *seen: str) -> SwarmConfig:
    """Return a swarm of drones seen by cameras, and a first one with its own pose."""
    rows = [
        f'[[drones]]\nid = {i}\nhome = [{i}, 0, 0]\nuri = "{other}"\n'
        for i, other in enumerate(seen)
    ]
    own = f'[[drones]]\nid = 9\nhome = [3, 0, 0]\nuri = "{uri}"\npose = "onboard"\n'
    head = 'name = "lab"\n[radio]\nlog_rate = 50.0\n'
    return SwarmConfig.loads(head + own + "".join(rows), "lab.toml")


@pytest.mark.parametrize("dongle", [0, 1])
def test_a_drone_with_its_own_pose_may_not_end_like_one_with_a_broadcast_pose(
    dongle: int,
) -> None:
    with pytest.raises(ConfigError) as caught:
        with_own_pose(f"radio://{dongle}/80/2M/E7E7E7E803", *SEEN_URIS)
    assert "drones[0] has the last byte 03, too" in str(caught.value)
    other = with_own_pose(f"radio://{dongle}/80/2M/E7E7E7E805", *SEEN_URIS)
    assert other.topology.seen == (0, 1), "another last byte"
    alone = with_own_pose(f"radio://{dongle}/80/2M/E7E7E7E803", SEEN_URIS[0])
    assert alone.topology.seen == (0,), "a single pose is not broadcast"


def test_a_drone_with_a_radio_is_sent_angles_unless_the_file_says_otherwise() -> None:
    config = swarm("udp://127.0.0.1:19850", "sim://")
    assert [config.control_of(i).sender for i in config.ids] == ["frpy", "fpqr"]
    said = config.replace(control={"sender": "fpqr"})
    assert [said.control_of(i).sender for i in said.ids] == ["fpqr", "fpqr"]


@pytest.mark.parametrize(
    ("line", "said"),
    [
        (
            '"posCtlPid.xKp" = "two"',
            'x.toml: radio.parameters.posCtlPid.xKp: found "two"; allowed: a number.',
        ),
        (
            "posCtlPid.xKp = 2.0",
            'x.toml: radio.parameters: found "posCtlPid"; allowed: GROUP.NAME, as posCtlPid.xKp.',
        ),
    ],
)
def test_a_parameter_of_the_firmware_has_a_group_and_is_a_number(
    line: str, said: str
) -> None:
    text = (
        f'name = "x"\n[radio.parameters]\n{line}\n[[drones]]\nid = 0\nhome = [0, 0, 0]'
    )
    with pytest.raises(ConfigError) as caught:
        SwarmConfig.loads(text, "x.toml")
    assert str(caught.value).startswith(said)


def test_poses_of_virtual_drones_come_at_a_port_of_their_own() -> None:
    text = 'name = "x"\n[mocap]\nport = 19850\n[[drones]]\nid = 0\nhome = [0, 0, 0]\nuri = "udp://127.0.0.1:19850"'
    with pytest.raises(
        ConfigError, match=r"x.toml: mocap.port = 19850: drones\[0\] has this port"
    ):
        SwarmConfig.loads(text, "x.toml")
