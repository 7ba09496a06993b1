"""Peers, HELLO, endpoints and public copies, without a network."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from crazychoir.bus.clock_offset import ClockOffset
from crazychoir.bus.codec import encode
from crazychoir.bus.network import endpoints
from crazychoir.bus.network.access import NetworkAccess
from crazychoir.bus.network.hello import HELLO_RULES, Hello
from crazychoir.bus.network.hello_review import Introduction
from crazychoir.bus.network.local_address import LocalIdentity
from crazychoir.bus.network.peers import PEER_LIMITS, Peer, Peers
from crazychoir.bus.network.public_topics import fields_as_json
from crazychoir.bus.port import PORT_ADDRESSES, Bus, Interest
from crazychoir.bus.topics import DRONE_TOPICS
from crazychoir.errors import CodecError, ConfigError, Refused
from crazychoir.runtime.clock import Clock
from crazychoir.types import FPQR, FullState, State, Status


def hello(process: str = "b", drones: tuple[int, ...] = (1,), **changes: Any) -> Hello:
    fields = {
        "host": "there",
        "incarnation": 2,
        "version": "1",
        "uptime": 1.0,
        "observers": [],
    }
    fields |= {"interests": [], "hears_receiver": True, "stopped": False}
    return Hello(process=process, drones=list(drones), **{**fields, **changes})


class Still(Clock):
    """Stands still until it is set."""

    ns = 0

    def now_ns(self) -> int:
        return self.ns


class Here:
    """Process a with drone 0, and what it was told."""

    def __init__(
        self, uptime: float = 0.0, agreed: dict[str, str] | None = None
    ) -> None:
        self.clock = Still()
        self.bus = Bus(self.clock, process="a", host="here")
        self.bus.port(0)
        self.tokens: list[tuple[list[int], bool]] = []
        self.refused: list[Refused] = []
        self.peers = Peers(
            self.bus,
            Introduction("s", 1, "1", agreed or {}),
            None,
            lambda ids, there: self.tokens.append((ids, there)),
            self.refused.append,
        )
        self.clock.ns = round(uptime * 1e9)

    def hear(self, said: Hello, age: float = 0.0) -> bool:
        peer = (
            self.peers.came("there", said.process, "token")
            or self.peers.by_name[said.process]
        )
        return self.peers.greeted(peer, said.payload(), age)


WORLD = hello(
    "world",
    (),
    observers=[PORT_ADDRESSES.body_offset],
    agreed={"drones": "ab", "plant": "cd"},
)


@pytest.mark.parametrize("uptime", [0.5, 60.0])
def test_an_owner_with_another_swarm_file_is_not_entered_in_the_directory(
    uptime, caplog
) -> None:
    here = Here(uptime, {"drones": "ab", "plant": "ef"})
    here.hear(WORLD)
    what = "process world on host there has another swarm file than this process, with another plant"
    if uptime < 1.0:
        assert [str(refused) for refused in here.refused] == [
            f"swarm s: refused: {what}. Copy one file to every host, and start both again."
        ]
    else:
        assert (here.refused, what in caplog.text) == ([], True), (
            "the process that started later ends; this one only logs it"
        )
    assert here.peers.directory == {}


@pytest.mark.parametrize(
    "said",
    [
        WORLD,
        hello("b", (1,), agreed={"drones": "another", "plant": "ef"}),
        hello("observer", (), observers=[PORT_ADDRESSES.first_observer]),
    ],
)
def test_a_matching_owner_any_agent_and_an_observer_are_accepted(said) -> None:
    here = Here(0.5, {"drones": "ab", "plant": "cd"})
    here.hear(said)
    assert here.refused == []
    assert set(here.peers.directory) == set(said.addresses)


@pytest.fixture
def here() -> Here:
    return Here()


def test_a_peer_is_known_from_token_to_token(here: Here) -> None:
    assert here.hear(hello(hears_receiver=False)) is True, "it does not know us"
    assert here.hear(hello()) is False
    assert here.peers.directory[1].process == "b"
    assert here.peers.went("elsewhere", "b", "token") is None, (
        "the token of another host"
    )
    assert here.peers.went("there", "b", "token") is not None
    assert (here.peers.directory, here.peers.by_name) == ({}, {})
    assert here.tokens == [([1], True), ([1], False)]


def test_a_hello_that_comes_after_a_newer_one_is_left_out(here: Here) -> None:
    here.hear(hello(drones=(2, 3), uptime=2.0))
    assert here.hear(hello(drones=(2,), uptime=1.5)) is False
    assert set(here.peers.directory) == {2, 3}
    assert here.hear(hello(drones=(2, 3), uptime=2.0, hears_receiver=False)), (
        "it gets ours, in case that it has lost us"
    )
    assert here.peers.mutual(here.peers.by_name["b"])
    here.hear(hello(drones=(2,), uptime=0.1, incarnation=3))
    assert set(here.peers.directory) == {2}, "it has started again"


def test_a_peer_is_there_while_one_of_its_tokens_is(here: Here) -> None:
    here.hear(hello())
    assert here.peers.came("there", "b", "another") is None
    assert here.peers.came("elsewhere", "b", "a third, of another host") is None
    assert here.peers.went("there", "b", "token") is None
    assert here.peers.directory[1].process == "b"
    assert here.peers.went("there", "b", "another") is not None
    assert here.tokens == [([1], True), ([1], False)]


def measure(here: Here, process: str, ahead: int, way: int) -> None:
    """A clock is asked for, which is `ahead` ns; the answer comes after 2 `way`."""
    sent = here.clock.ns
    answer = ClockOffset().hear(
        here.peers.by_name[process].offset.ask(sent),
        sent + ahead + way,
        sent + ahead + way,
    )
    here.clock.ns += 2 * way
    here.peers.by_name[process].offset.hear(answer, here.clock.ns, here.clock.ns)


def test_the_process_with_the_shortest_way_tells_the_clock_of_its_host(
    here: Here,
) -> None:
    for name, host in (
        ("b", "there"),
        ("c", "there"),
        ("d", "afar"),
        ("e", "here"),
        ("f", "afar"),
    ):
        peer = here.peers.came(host, name, name)
        here.peers.greeted(
            peer,
            hello(name, (), host=host, hears_receiver=name != "f").payload(),
            0.0,
        )
    assert [peer.process for peer in here.peers.on_other_hosts] == ["b", "c", "d"], (
        "e is of our host, f knows us not"
    )
    assert here.peers.offsets() == {}
    for name, ahead, way in (("b", 1100, 200), ("c", 1000, 100), ("d", 5000, 300)):
        measure(here, name, ahead, way)
    found = here.peers.offsets()
    assert list(found) == ["afar", "there"]
    assert found["afar"] == pytest.approx((5e-6, 3e-7), abs=1e-12)
    assert found["there"] == pytest.approx((1e-6, 1e-7), abs=1e-10)


def test_a_process_that_is_started_anew_has_another_clock(here: Here) -> None:
    here.hear(hello())
    measure(here, "b", 1000, 100)
    here.hear(hello(uptime=1.5))
    assert here.peers.offsets() != {}
    here.hear(hello(incarnation=3))
    assert here.peers.offsets() == {}
    measure(here, "b", 1000, 100)
    here.peers.went("there", "b", "token")
    here.hear(hello())
    assert here.peers.offsets() == {}


def test_a_hello_under_another_processes_name_is_refused(here: Here) -> None:
    peer = here.peers.came("there", "b", "token")
    with pytest.raises(CodecError, match="sent by b on there"):
        here.peers.greeted(peer, hello("c").payload(), 0.0)
    assert peer.hello is None


@pytest.mark.parametrize(
    "wrong",
    [
        {"drones": (PORT_ADDRESSES.first_observer,)},
        {"observers": [3]},
        {
            "observers": list(
                range(PORT_ADDRESSES.first_observer, PORT_ADDRESSES.first_observer + 17)
            )
        },
    ],
)
def test_a_hello_claims_no_drones_among_observers_nor_more_than_look_on(
    here: Here, wrong: Any
) -> None:
    with pytest.raises(CodecError, match="HELLO"):
        here.hear(hello(**wrong))
    assert here.peers.directory == {}


def test_a_process_cannot_take_the_address_of_an_operator(here: Here) -> None:
    """b says that it is there for longer, and at the console's address; the console is heard, and reads on."""
    processes, looks = (
        {"here": ("a",), "desk": (), "there": ("b",)},
        PORT_ADDRESSES.first_observer + 5,
    )
    here.peers.access = NetworkAccess(
        "s", "here", Path("k"), processes, {0: "here", 1: "there"}, ("desk",)
    )
    wants = [Interest("status", 0, looks)]
    console = here.peers.came("desk", "observer-desk.1", "token")
    said = hello("observer-desk.1", (), host="desk", observers=[looks], interests=wants)
    here.peers.greeted(console, said.payload(), 0.0)
    liar = here.peers.came("there", "b-1", "token")
    for observers, interests in (
        ([looks], [Interest("state", 0, looks)]),
        ([looks], []),
        ([], []),
    ):
        claims = hello("b-1", observers=observers, interests=interests, uptime=1e8)
        here.peers.greeted(liar, claims.payload(), 0.0)
        assert here.peers.directory[looks] is console
    readers = here.bus.ports[0]._readers
    assert (
        readers[DRONE_TOPICS.status.number].every,
        DRONE_TOPICS.state.number in readers,
    ) == ([looks], False)


def test_hello_of_a_process_on_another_host_is_refused(here: Here) -> None:
    peer = here.peers.came("there", "b", "token")
    with pytest.raises(CodecError, match="b on elsewhere, sent by b on there"):
        here.peers.greeted(peer, hello("b", host="elsewhere").payload(), 0.0)
    assert peer.hello is None


def test_we_repeat_the_same_bytes_until_something_changes(here: Here) -> None:
    payload = here.peers.hello_to(None)
    age = here.peers.hello_age()
    here.clock.ns += 2_000_000_000
    assert here.peers.hello_to(None) is payload
    assert here.peers.hello_age() - age == pytest.approx(2.0)
    here.bus.port(7)
    changed = Hello.of(here.peers.hello_to(None))
    assert (changed.drones, changed.uptime) == ([0, 7], 2.0)
    assert here.peers.hello_age() == 0.0


def test_a_hello_tells_its_receiver_what_we_have_of_it(here: Here) -> None:
    def told(peer: Peer | None) -> tuple[bool, bool]:
        said = Hello.of(here.peers.hello_to(peer))
        return said.hears_receiver, said.lacks_token

    peer = here.peers.came("there", "b", "token")
    assert told(None) == (False, True)
    assert told(peer) == (False, False)
    here.peers.greeted(peer, hello().payload(), 0.0)
    assert told(peer) == (True, False)


def test_a_repeated_hello_is_answered_until_the_peer_has_ours(here: Here) -> None:
    unknowing = hello(hears_receiver=False)
    here.hear(unknowing)
    assert here.hear(unknowing) is True
    here.hear(hello())
    assert here.hear(hello()) is False


def test_the_later_of_two_gives_way(here: Here) -> None:
    here.hear(hello(drones=(0,), uptime=1.0), age=0.5)
    (refused,) = here.refused
    assert str(refused) == (
        "swarm s: refused: process b on host there flies drone(s) 0 too and has done so for 1.5 s. "
        "Give this agent another --id, or stop that one."
    )
    here.hear(hello(drones=(0,), uptime=2.0))
    assert len(here.refused) == 1, "once is enough"
    senior = Here(uptime=5.0)
    senior.hear(hello(drones=(0,), uptime=1.0))
    assert (senior.refused, senior.peers.directory) == ([], {})


@pytest.mark.parametrize(
    "said",
    [hello(drones=(0,), uptime=1e8), WORLD],
    ids=["our drone", "another swarm file"],
)
def test_a_process_that_has_run_for_a_while_is_not_ended_by_a_conflict(
    said, caplog
) -> None:
    """The other host may be back after a broken cable, or claim that it was first. This process may fly drones."""
    here = Here(PEER_LIMITS.new_process_time, {"drones": "ab", "plant": "ef"})
    here.hear(said, age=1e8)
    assert (here.refused, here.peers.directory) == ([], {})
    assert "it is refused" in caplog.text
    young = Here(PEER_LIMITS.new_process_time - 0.1, {"drones": "ab", "plant": "ef"})
    young.hear(said, age=1e8)
    assert len(young.refused) == 1


def test_a_refused_peer_that_corrects_its_hello_is_accepted(here: Here) -> None:
    here.hear(hello(drones=(0,), uptime=0.0), age=-0.5)
    assert here.peers.by_name["b"].refusal
    here.hear(hello(drones=(1,), uptime=1.0))
    assert here.peers.by_name["b"].refusal == ""


def test_the_later_of_two_owners_of_a_world_gives_way(here: Here) -> None:
    here.bus.close(0)
    for j in (PORT_ADDRESSES.body_offset + 3, 10_001):
        here.bus.port(j)
    here.hear(hello(drones=(), observers=[10_001], uptime=1.0))
    assert here.refused == [], "observers may come in any number"
    here.hear(
        hello(
            drones=(),
            observers=[PORT_ADDRESSES.body_offset + 3, PORT_ADDRESSES.body_offset + 4],
            uptime=1.0,
        )
    )
    (refused,) = here.refused
    assert "process b on host there owns the world of drone(s) 3 too" in str(refused)
    assert "Stop one of them." in str(refused)


def test_the_later_of_two_that_see_the_same_drones_gives_way(here: Here) -> None:
    here.bus.close(0)
    here.bus.port(PORT_ADDRESSES.camera_offset + 3)
    here.hear(
        hello(
            drones=(),
            observers=[
                PORT_ADDRESSES.body_offset + 3,
                PORT_ADDRESSES.camera_offset + 4,
            ],
            uptime=1.0,
        )
    )
    assert here.refused == [], "the owner of a world, or of a radio, is another one"
    here.hear(
        hello(
            drones=(),
            observers=[
                PORT_ADDRESSES.camera_offset + 3,
                PORT_ADDRESSES.camera_offset + 4,
            ],
            uptime=1.0,
        )
    )
    (refused,) = here.refused
    assert "process b on host there owns the motion capture of drone(s) 3 too" in str(
        refused
    )


@given(
    st.floats(0.0, HELLO_RULES.start_tie / 2),
    st.floats(0.0, HELLO_RULES.start_tie / 2),
    st.floats(0.0, 0.9 * HELLO_RULES.start_tie),
)
def test_at_least_one_of_two_agents_gives_way_when_both_start_together(
    ours: float, theirs: float, apart: float
) -> None:
    """The way of a HELLO takes `ours` or `theirs` s; b starts `apart` s after a."""
    b_yields = hello("a").precedes("b", apart - ours)
    a_yields = hello("b").precedes("a", -apart - theirs)
    assert b_yields or a_yields
    assert not a_yields, "a is the lesser name and was first"


def test_a_third_party_believes_the_elder(here: Here) -> None:
    here.hear(hello("young", (5,), uptime=1.0))
    here.hear(hello("old", (5, 6), uptime=9.0))
    assert [here.peers.directory[i].process for i in (5, 6)] == ["old", "old"]
    here.peers.went("there", "old", "token")
    assert here.peers.directory[5].process == "young"


def test_interests_count_once_both_have_heard(here: Here) -> None:
    sent: list[tuple[int, ...]] = []
    here.bus.forwarder = type(
        "F",
        (),
        {"forward": lambda self, message, to, age: sent.append(tuple(to))},
    )()
    here.bus.ports[0].publish(DRONE_TOPICS.status, Status("landed"))
    wish = [Interest("status", 0, 10_001)]
    here.hear(
        hello(drones=(), observers=[10_001], interests=wish, hears_receiver=False)
    )
    assert sent == []
    here.hear(hello(drones=(), observers=[10_001], interests=wish))
    here.hear(hello(drones=(), observers=[10_001], interests=wish, uptime=3.0))
    assert sent == [(10_001,)], "the latched value, once"
    here.peers.went("there", "b", "token")
    here.bus.ports[0].publish(DRONE_TOPICS.status, Status("flying"))
    assert sent == [(10_001,)]


def test_only_sensible_interests_are_wanted() -> None:
    rates = (0.0, 10.0, -1.0, float("nan"), float("inf"), 5e-324)
    wishes = [Interest("state", 0, 10_001, rate) for rate in rates] + [
        Interest("state", 0, 3)
    ]
    assert [
        one.rate for one in hello(observers=[10_001], interests=wishes).wants()
    ] == [0.0, 10.0]


def test_an_emergency_stop_spreads_to_newcomers(here: Here) -> None:
    here.hear(hello(stopped=True))
    assert here.bus.stopped is True


def test_peers_are_bounded(here: Here) -> None:
    made = [
        here.peers.came("there", f"p{k}", "token")
        for k in range(PEER_LIMITS.max_peers + 5)
    ]
    assert sum(isinstance(peer, Peer) for peer in made) == PEER_LIMITS.max_peers


@given(
    st.binary(max_size=200)
    | st.builds(encode, st.dictionaries(st.text(), st.integers(-9, 9) | st.text()))
)
def test_nonsense_is_no_hello(payload: bytes) -> None:
    with pytest.raises(CodecError):
        Hello.of(payload)


@pytest.mark.parametrize(
    "wrong",
    [
        "bogus",
        "tcp/127.0.0.1",
        "tcp/127.0.0.1:99999",
        "foo/127.0.0.1:7",
        "tcp/a b:7",
        "tcp/::1:7",
        "",
    ],
)
def test_malformed_endpoints_are_named(wrong: str) -> None:
    with pytest.raises(ConfigError) as caught:
        endpoints.zenoh_settings(["tcp/127.0.0.1:7460"], [wrong], 1.0)
    assert str(caught.value) == (
        f"connect endpoint: found {wrong}; allowed: tcp/<address>:<port>, as tcp/192.168.1.10:7460, port 0 to 65535; "
        "also udp, tls, quic, ws. Look at base_port and [hosts] in the swarm file."
    )


def test_the_lease_is_for_other_hosts() -> None:
    lease = "transport/link/tx/lease"
    near, far = ["tcp/127.0.0.1:7460"], ["tcp/[::1]:7461", "tls/lab.local:7462?rel=1"]
    assert endpoints.zenoh_settings(near, far[:1], 1.0)[lease] == 30_000
    assert endpoints.zenoh_settings(near, far, 1.0)[lease] == 1_000


def test_names_must_fit_into_keys() -> None:
    endpoints.check_name("swarm", "lab-3.x_Y")
    with pytest.raises(
        ConfigError, match=r"name of the swarm: found a/\*; allowed: 1 to 100 of"
    ):
        endpoints.check_name("swarm", "a/*")


def test_public_copies_are_plain_json() -> None:
    value = json.loads(fields_as_json(State.at([1.0, 2.0, float("nan")])))
    assert value == {
        "p": [1, 2, None],
        "v": [0, 0, 0],
        "q": [0, 0, 0, 1],
        "w": [0, 0, 0],
        "age": 0,
        "a": [0, 0, 0],
    }
    assert json.loads(fields_as_json(Status("flying", note="ü")))["note"] == "ü"
    assert json.loads(fields_as_json(FullState.at([1, 2, 3], yaw=0.5)))["yaw"] == 0.5
    command = json.loads(fields_as_json(FPQR(np.array([0.3, 1, 2, 3]))))
    assert command == {"thrust": 0.3, "flat": [0.3, 1, 2, 3]}, (
        "whole, where not all its parts have names"
    )


def test_a_drone_that_was_started_again_is_not_gone_with_its_former_process(here):
    here.hear(hello("old", drones=(1, 2), uptime=100.0))
    here.hear(hello("new", drones=(1,), incarnation=3, uptime=0.1))
    here.tokens.clear()
    here.peers.went("there", "old", "token")
    assert here.tokens == [([2], False)]
    assert here.peers.directory[1].process == "new"


@pytest.mark.parametrize(
    ("host", "incarnation", "refusal", "may_connect"),
    [
        ("here", 2, "", True),
        ("there", 2, "", False),
        ("here", 3, "", False),
        ("here", 2, "another swarm file", False),
    ],
)
def test_only_known_processes_of_the_host_may_connect(
    here, host, incarnation, refusal, may_connect
):
    peer = here.peers.came("here", "b", "token")
    here.peers.greeted(peer, hello(host="here").payload(), 0.0)
    peer.host = host
    peer.refusal = refusal
    identity = LocalIdentity("s", "b", incarnation)
    assert here.peers.may_connect(identity) is may_connect
    assert not here.peers.may_connect(LocalIdentity("s", "c", incarnation))
