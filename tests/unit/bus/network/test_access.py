from pathlib import Path

import pytest

from crazychoir.bus.frames import Envelope
from crazychoir.bus.network import endpoints
from crazychoir.bus.network.access import NetworkAccess
from crazychoir.bus.network.authority import add_host, make_authority
from crazychoir.bus.network.hello import Hello
from crazychoir.bus.network.hello_review import Introduction
from crazychoir.bus.network.peers import Peers
from crazychoir.bus.port import PORT_ADDRESSES, Bus
from crazychoir.bus.topics import DRONE_TOPICS, MESSAGE_TOPICS
from crazychoir.config.access import access_of
from crazychoir.config.addresses import Addresses
from crazychoir.config.digest import compute_digest
from crazychoir.config.swarm_config import SwarmConfig
from crazychoir.errors import ConfigError
from crazychoir.runtime.clock import Clock

RAW = {
    "name": "lab",
    "hosts": {"laptop": "192.168.1.10", "desktop": "192.168.1.11"},
    "security": {"operators": ["console", "laptop"]},
    "world": {"host": "laptop"},
    "drones": [
        {"id": 0, "home": [0, 0, 0], "host": "laptop", "uri": "sim://motors"},
        {"id": 1, "home": [1, 0, 0], "host": "desktop", "uri": "sim://motors"},
    ],
}


class Still(Clock):
    def now_ns(self):
        return 0


def said(topic, *to):
    """A message of drone 1."""
    return Envelope(topic.number, 1, to, 1, 0, 0.0, "1", b"")


@pytest.fixture
def config(tmp_path):
    make_authority(tmp_path / "keys")
    for name in ("laptop", "desktop", "console"):
        add_host(tmp_path / "keys", name)
    security = {**RAW["security"], "keys": str(tmp_path / "keys")}
    return SwarmConfig.of({**RAW, "security": security})


def test_a_host_holds_the_drones_bodies_and_eyes_that_the_swarm_file_gives_it(config):
    access = access_of(config, "laptop")
    assert access.may_hold("laptop", 0)
    assert access.may_hold("desktop", 1)
    assert access.may_hold("laptop", PORT_ADDRESSES.body_offset + 1), "its world"
    for host, address in (
        ("laptop", 1),
        ("desktop", 0),
        ("desktop", PORT_ADDRESSES.body_offset + 1),
        ("laptop", PORT_ADDRESSES.camera_offset),
        ("laptop", 7),
    ):
        assert not access.may_hold(host, address)
    assert access.may_hold("desktop", PORT_ADDRESSES.first_observer + 5), (
        "every host may observe"
    )


def test_only_operators_command(config):
    access = access_of(config, "desktop")
    asks = [
        access.may_say(name, said(MESSAGE_TOPICS.request))
        for name in ("console", "laptop", "desktop")
    ]
    assert asks == [True, True, False]
    assert not access.may_say("desktop", said(MESSAGE_TOPICS.emergency_stop))
    assert access.may_say("desktop", said(DRONE_TOPICS.state))


def test_a_drone_asks_its_own_body_on_another_host_and_no_other(config):
    access = access_of(config, "laptop")
    assert access.may_say(
        "desktop", said(MESSAGE_TOPICS.request, PORT_ADDRESSES.body_offset + 1)
    ), "to arm it"
    for topic, to in (
        (MESSAGE_TOPICS.request, (PORT_ADDRESSES.body_offset,)),
        (MESSAGE_TOPICS.request, (PORT_ADDRESSES.body_offset + 1, 0)),
        (MESSAGE_TOPICS.request, ()),
        (MESSAGE_TOPICS.emergency_stop, (PORT_ADDRESSES.body_offset + 1,)),
    ):
        assert not access.may_say("desktop", said(topic, *to))


def test_a_host_cannot_take_another_hosts_process_name_nor_all_the_room(config):
    access = access_of(config, "laptop")
    bus = Bus(Still(), process="0-1", host="laptop")
    own = Introduction("lab", 1, "1")
    peers = Peers(bus, own, access, lambda drones, there: None, lambda refused: None)
    for host, process in (
        ("desktop", "0-1"),
        ("desktop", "world-1"),
        ("desktop", "observer-console.1"),
        ("desktop", "observer-1"),
        ("desktop", "1"),
        ("desktop", "1-*"),
        ("desktop", "1-\n"),
        ("tower", "1-1"),
        ("console", "1-1"),
    ):
        assert peers.came(host, process, "token") is None, process
    assert peers.came("console", "observer-console.1", "token")
    assert peers.came("desktop", "1-1", "token")
    assert (
        sum(peers.came("desktop", f"1-{k}", "token") is not None for k in range(1000))
        < 64
    )
    assert peers.came("laptop", "world-1", "token"), "there is room for the others"


def test_a_claim_to_what_another_host_holds_is_refused(config):
    access = access_of(config, "laptop")
    bus = Bus(Still(), process="0-1", host="laptop")
    own = Introduction("lab", 1, "1")
    peers = Peers(bus, own, access, lambda drones, there: None, lambda refused: None)
    peer = peers.came("desktop", "1-1", "token")
    for drones, observers in (
        ([0], []),
        ([1, 0], []),
        ([1], [PORT_ADDRESSES.body_offset + 1]),
        ([7], []),
        ([], [PORT_ADDRESSES.camera_offset + 1]),
    ):
        claims = Hello("1-1", "desktop", 2, "1", 1.0, drones, observers, [], False)
        peers.greeted(peer, claims.payload(), 0.0)
        assert peers.directory == {}
    peers.greeted(
        peer,
        Hello("1-1", "desktop", 2, "1", 1.0, [1], [], [], False).payload(),
        0.0,
    )
    assert peers.directory == {1: peer}


def test_drones_of_one_process_may_be_flown_by_more(config):
    drones = [
        {"id": i, "home": [i, 0, 0], "host": "laptop" if i < 2 else "desktop"}
        for i in range(4)
    ]
    access = access_of(
        config.replace(drones=drones, processes=[[0, 1], [2, 3]]), "laptop"
    )
    assert [
        access.may_be("laptop", name) for name in ("0-1", "1-1", "2-1", "world-1")
    ] == [True, True, False, True]


def test_what_cameras_see_is_said_by_their_host_alone(config):
    drones = [
        {"id": 0, "home": [0, 0, 0], "host": "desktop", "uri": "udp://127.0.0.1:19850"}
    ]
    radio = {"dongles": [{"dongle": 0, "host": "desktop"}]}
    reached = config.replace(
        drones=drones, radio=radio, world={}, mocap={"host": "laptop"}
    )
    access = access_of(reached, "laptop")
    assert [
        access.may_hold(host, PORT_ADDRESSES.camera_offset)
        for host in ("laptop", "desktop")
    ] == [
        True,
        False,
    ]
    assert [
        access.may_hold(host, PORT_ADDRESSES.body_offset)
        for host in ("laptop", "desktop")
    ] == [
        False,
        True,
    ]


def test_nothing_but_mutual_tls_is_spoken_where_there_are_keys(config):
    settings = access_of(config, "laptop").settings()
    assert settings["transport/link/protocols"] == ["tls", "quic"]
    assert settings["transport/link/tls"]["enable_mtls"] is True


def test_what_a_process_claims_in_turns_is_said_once(config, caplog):
    access = access_of(config, "laptop")
    bus = Bus(Still(), process="0-1", host="laptop")
    own = Introduction("lab", 1, "1")
    peers = Peers(bus, own, access, lambda drones, there: None, lambda refused: None)
    peer = peers.came("desktop", "1-1", "token")
    for k in range(20):
        hello = Hello(
            "1-1",
            "desktop",
            2,
            f"other {k}",
            1.0,
            [] if k % 3 else [0, 7][k % 2 :],
            [],
            [],
            False,
        )
        peers.greeted(peer, hello.payload(), 0.0)
    assert caplog.text.count("it is refused") == 1
    assert peers.directory == {}


def test_a_swarm_of_several_hosts_is_closed_unless_it_says_that_it_is_not(config):
    assert Addresses(config).endpoint(1) == "tls/192.168.1.11:7461"
    plain = config.replace(security={"insecure": True})
    assert (Addresses(plain).endpoint(1), access_of(plain, "laptop")) == (
        "tcp/192.168.1.11:7461",
        None,
    )
    local = {
        **RAW,
        "hosts": {"laptop": "127.0.0.1", "desktop": "localhost"},
        "security": {},
    }
    assert not SwarmConfig.of(local).secured, (
        "no other host reaches this machine's own addresses"
    )
    assert SwarmConfig.of(
        {**local, "security": {"insecure": False, "operators": ["laptop"]}}
    ).secured
    with pytest.raises(
        ConfigError,
        match=r"security.operators: found nothing.* operators = \[\"laptop\"\]",
    ):
        SwarmConfig.of({**RAW, "security": {}})
    drones = [{"id": 0, "home": [0, 0, 0]}]
    with pytest.raises(ConfigError, match=r"a swarm with \[hosts\]"):
        SwarmConfig.of(
            {
                "name": "lab",
                "drones": drones,
                "security": {"insecure": False, "operators": ["a"]},
            }
        )


def test_an_open_endpoint_beyond_this_machine_needs_insecure_in_the_swarm_file():
    local = SwarmConfig.of({"name": "lab", "drones": [{"id": 0, "home": [0, 0, 0]}]})
    near = ("tcp/127.0.0.1:7460", "tcp/[::1]:7460", "tcp/localhost:7460")
    assert access_of(local, "here", *near) is None
    for far in ("tcp/0.0.0.0:7460", "tcp/192.168.1.2:7460", "tcp/127.lab.org:7460"):
        with pytest.raises(
            ConfigError, match=r"endpoint = tcp/.*insecure = true in \[security\]"
        ):
            access_of(local, "here", near[0], far)
        assert (
            access_of(local.replace(security={"insecure": True}), "here", far) is None
        )


def test_keys_are_found_beside_the_swarm_file_and_are_no_part_of_what_hosts_agree_on(
    config, tmp_path
):
    path = tmp_path / "deep" / "swarm.json"
    path.parent.mkdir()
    path.write_text(
        config.replace(security={**RAW["security"], "keys": "../keys"}).dumps()
    )
    found = SwarmConfig.load(path)
    assert access_of(found, "desktop").folder == tmp_path / "keys" / "desktop"
    assert compute_digest(found) == compute_digest(config)
    with pytest.raises(ConfigError, match="crazychoir keys add tower"):
        access_of(found, "tower")


def test_zenoh_holds_each_host_to_its_own_keys():
    access = NetworkAccess(
        "s",
        "a",
        Path("k"),
        {"a": ("0", "world"), "b": ("2",)},
        {0: "a", 2: "b"},
        ("a",),
    )
    control = access.settings()["access_control"]
    assert (control["enabled"], control["default_permission"]) == (True, "deny")
    rules = {rule["id"]: rule for rule in control["rules"]}
    assert rules["b says"]["key_exprs"] == ["choir/s/f/*/b/*/*", "choir/s/drone/2/**"]
    heard = ["choir/s/f/0-$*/**", "choir/s/f/world-$*/**", "choir/s/f/observer-a.$*/**"]
    assert rules["a hears"]["key_exprs"][:3] == heard
    assert rules["b is there"]["key_exprs"] == ["choir/s/live/b/**"]
    assert {
        policy["subjects"][0]: policy["rules"] for policy in control["policies"]
    } == {
        name: [
            "out",
            f"{name} says",
            f"{name} hears",
            f"{name} is there",
            f"{name} looks",
        ]
        for name in ("a", "b")
    }


def test_a_router_is_believed_and_holds_the_others_to_their_names():
    access = NetworkAccess(
        "s", "a", Path("k"), {"a": ("0",), "r": ()}, {0: "a"}, ("a",), "r"
    )
    control = access.settings()["access_control"]
    rules = {rule["id"]: rule for rule in control["rules"]}
    assert rules["r passes on"]["key_exprs"] == ["choir/s/**"]
    assert "r says" not in rules
    assert {
        policy["subjects"][0]: policy["rules"] for policy in control["policies"]
    } == {
        "a": ["out", "a says", "a hears", "a is there", "a looks"],
        "r": ["out", "r passes on"],
    }


def test_without_a_router_to_connect_to_it_is_said_what_to_start():
    error = endpoints.opening_error(
        ["tls/10.0.0.9:7460"], [], "tls/10.0.0.9:7460: Cannot assign requested address"
    )
    assert "The address of this host in [hosts] is not its own" in str(error)
    error = endpoints.opening_error(
        [], ["tls/10.0.0.9:7441"], "Connection refused (os error 111)"
    )
    assert "Start it first: crazychoir router" in str(error)
    settings = endpoints.zenoh_settings([], ["tcp/10.0.0.9:7441"], 1.0, "client")
    assert (settings["mode"], settings["listen/endpoints"]) == ("client", [])
