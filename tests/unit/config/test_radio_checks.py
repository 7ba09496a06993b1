"""What must hold for drones that a radio reaches: addresses, dongles, hosts, and what a dongle carries."""

import pytest

from crazychoir.bus.port import PORT_ADDRESSES
from crazychoir.bus.topics import DRONE_TOPICS
from crazychoir.config.addresses import PROCESS_NUMBERS, Addresses
from crazychoir.config.swarm_config import SwarmConfig
from crazychoir.errors import ConfigError
from crazychoir.radio.budget import compute_setpoint_rates


def swarm(*uris: str, head: str = "", keys: str = "") -> SwarmConfig:
    rows = [
        f'[[drones]]\nid = {i}\nhome = [{i}, 0, 0]\nuri = "{uri}"\n{keys}\n'
        for i, uri in enumerate(uris)
    ]
    return SwarmConfig.loads(f'name = "lab"\n{head}\n' + "\n".join(rows), "lab.toml")


def udp(n: int, dongles: int = 1, **control: object) -> SwarmConfig:
    rows = [
        f'[[drones]]\nid = {i}\nhome = [{i % 4}, {i // 4}, 0]\nuri = "udp://127.0.0.1:{19850 + i}"\n'
        f"dongle = {i % dongles}\n"
        for i in range(n)
    ]
    radio = control.pop("radio", {})
    tables = {"control": control, "radio": radio}
    text = "".join(
        f"[{name}]\n" + "".join(f"{k} = {v!r}\n" for k, v in t.items())
        for name, t in tables.items()
    )
    return SwarmConfig.loads('name = "lab"\n' + text + "".join(rows), "lab.toml")


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


def test_four_drones_at_100_hz_are_too_much_for_one_dongle() -> None:
    with pytest.raises(ConfigError) as caught:
        compute_setpoint_rates(udp(4, sender="fpqr", radio={"command_rate": 100}))
    assert str(caught.value) == (
        "dongle 0 = drones 0, 1, 2, 3 (fpqr) need 488 packets a second: 4 x 100 set-points, 4 x 22 poses, echoes and "
        "requests; it carries 250, 31 set-points a second and drone. Use more dongles, send frpy or vel or "
        "fullstate (40 Hz at most), or measure its capacity."
    )


@pytest.mark.parametrize(
    ("n", "rate", "says"),
    [
        (
            4,
            13.0,
            "4 x 50 set-points, 4 x 22 poses, echoes and requests; it carries 250, 31 set-points a second and "
            "drone. Use more dongles, send frpy or vel or fullstate (40 Hz at most), or measure its capacity.",
        ),
        (
            3,
            0.0,
            "it carries 250, 49 set-points a second and drone. Use more dongles, set command_rate = 50 to 61 ",
        ),
        (
            3,
            70.0,
            "Use more dongles, set command_rate = 50 to 61 ([radio]), or measure its capacity.",
        ),
        (
            3,
            13.0,
            "radio.command_rate: found 13.0; allowed: 50 to 61 Hz, for what is sent by dongle 0 (fpqr). Leave ",
        ),
        (
            6,
            13.0,
            "13 set-points a second and drone. Use more dongles, send vel (19 Hz at most), or measure its cap",
        ),
    ],
)
def test_what_is_said_to_be_carried_is(n: int, rate: float, says: str) -> None:
    with pytest.raises(ConfigError) as caught:
        compute_setpoint_rates(udp(n, sender="fpqr", radio={"command_rate": rate}))
    assert says in str(caught.value)
    for told in (50.0, 61.0) if n == 3 else ():
        assert compute_setpoint_rates(
            udp(n, sender="fpqr", radio={"command_rate": told})
        ) == {0: told}


def test_logs_count_for_drones_with_an_on_board_pose() -> None:
    uris = [f"udp://127.0.0.1:{19850 + i}" for i in range(4)]
    config = swarm(*uris, head="[radio]\nlog_rate = 25", keys='pose = "onboard"')
    with pytest.raises(
        ConfigError,
        match="4 x 30 set-points, 4 x 37 logs, echoes and requests; it carries 250",
    ):
        compute_setpoint_rates(config)


def test_what_dongles_leave() -> None:
    assert compute_setpoint_rates(udp(2, sender="fpqr")) == {0: 84.0}
    assert compute_setpoint_rates(
        udp(2, sender="fpqr", radio={"command_rate": 100.0})
    ) == {0: 100.0}, "asked for, and just carried"
    assert compute_setpoint_rates(udp(4, sender="frpy")) == {0: 31.0}
    assert compute_setpoint_rates(udp(6, 3, sender="frpy")) == {
        0: 84.0,
        1: 84.0,
        2: 84.0,
    }
    assert compute_setpoint_rates(
        udp(1, sender="fpqr", radio={"pose_rate": 100.0})
    ) == {0: 100.0}, "one alone never changes channels"
    with pytest.raises(ConfigError, match="5 x 50 set-points"):
        compute_setpoint_rates(udp(5, sender="fpqr"))


def test_plans_count_as_they_are_sent() -> None:
    assert compute_setpoint_rates(udp(5, sender="xyz")) == {0: 0.0}
    with pytest.raises(
        ConfigError,
        match=r"5 x 37 poses, .* 5 x 10 plans; .* 212\.5 with room .* a lower pose_rate",
    ):
        compute_setpoint_rates(udp(5, sender="xyz", radio={"pose_rate": 25.0}))


def test_what_drones_say_counts_as_well() -> None:
    with pytest.raises(ConfigError) as caught:
        compute_setpoint_rates(udp(7, sender="xyz"))
    assert str(caught.value) == (
        "dongle 0 = drones 0, 1, 2, 3, 4, 5, 6 (xyz) say 294 packets a second: 140 logs, 7 x 12 echoes and answers, "
        "7 x 10 to plans; it carries 250, 212.5 with room to spare. Use more dongles, or measure its capacity."
    )
    with pytest.raises(ConfigError, match="6 x 10 to plans; it carries 250"):
        compute_setpoint_rates(udp(6, sender="xyz"))
    assert compute_setpoint_rates(udp(7, sender="xyz", radio={"capacity": 350.0})) == {
        0: 0.0
    }
    with pytest.raises(
        ConfigError,
        match=r"say 224 .*: 200 logs, 2 x 12 echoes and answers; .* a lower log_rate",
    ):
        compute_setpoint_rates(udp(2, sender="vel", radio={"log_rate": 100.0}))


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
