"""What a link does with what comes, without a network."""

import asyncio
from pathlib import Path

import pytest
import zenoh

from crazychoir.bus.codec import decode, encode
from crazychoir.bus.frames import FRAME_FORMAT, Envelope, Frame, encode_frame
from crazychoir.bus.network.access import NetworkAccess
from crazychoir.bus.network.arrival_queue import FRAME_READING
from crazychoir.bus.network.flood_limit import FLOOD_LIMITS
from crazychoir.bus.network.hello import Hello
from crazychoir.bus.network.local_sockets import LocalAddress
from crazychoir.bus.network.zenoh_link import ZenohLink
from crazychoir.bus.port import Bus
from crazychoir.bus.topics import DRONE_TOPICS
from crazychoir.runtime.clock import Clock

OF_B = "choir/s/f/0-1/b/1-1/control"


class Held(Clock):
    """Goes on when it is told."""

    ns = 0

    def now_ns(self) -> int:
        return self.ns


async def link_of_a(access=None):
    """Return the link of process 0-1 of host a with drone 0; process 1-1 of b with drone 1 sends frames at OF_B."""
    bus = Bus(Held(), process="0-1", host="a")
    bus.port(0)
    link = ZenohLink(bus, "s", listen=[], connect=[], incarnation=1, version="1")
    link.table.access = access
    peer = link.table.came("b", "1-1", "token")
    said = Hello("1-1", "b", 2, "1", 1.0, [1], [], [], ["0-1"], False)
    link.table.greeted(peer, said.payload(), 0.0)
    return link


def frame(*messages):
    return encode_frame(Frame("1-1", 2, DRONE_TOPICS.state.klass, list(messages)))


async def test_a_message_is_delivered_once_to_a_repeated_receiver():
    link = await link_of_a()
    heard = []
    link.bus.ports[0].handlers[DRONE_TOPICS.log.number] = lambda *message: heard.append(
        message
    )
    link._frame(
        OF_B,
        frame(
            Envelope(
                DRONE_TOPICS.log.number, 1, (0,) * 1000, 1, 0, 0.0, "", encode("x")
            )
        ),
        0,
    )
    assert len(heard) == 1


async def test_key_token_frame_and_message_must_name_one_sender():
    """Access control only checks which keys a host uses."""
    link = await link_of_a()
    heard, counters = [], link.counters
    link.bus.ports[0].handlers[DRONE_TOPICS.log.number] = lambda *message: heard.append(
        message
    )
    said = Envelope(DRONE_TOPICS.log.number, 1, (0,), 1, 0, 0.0, "", encode("x"))
    link._frame(
        "choir/s/f/0-1/c/1-1/control", frame(said), 0
    )  # host c uses the name of a process of host b
    link._frame(
        "choir/s/f/0-1/b/1-2/control", frame(said), 0
    )  # process 1-2 has no token
    link._frame(
        OF_B, encode_frame(Frame("1-2", 2, DRONE_TOPICS.state.klass, [said])), 0
    )
    link.table.came("c", "2-1", "token")
    other = Hello("2-1", "c", 2, "1", 1.0, [2], [], [], ["0-1"], False)
    link.table.greeted(link.peers["2-1"], other.payload(), 0.0)
    link._frame(
        OF_B,
        frame(Envelope(DRONE_TOPICS.log.number, 2, (0,), 1, 0, 0.0, "", encode("x"))),
        0,
    )  # host b sends for drone 2 of host c
    assert (heard, counters.strangers) == ([], 4)
    link._frame(OF_B, frame(said), 0)
    assert len(heard) == 1


async def test_a_stranger_with_another_s_name_is_not_answered():
    access = NetworkAccess(
        "s", "a", Path("k"), {"a": ("0",), "b": ("1",)}, {0: "a", 1: "b"}, ("a",)
    )
    link = await link_of_a(access)
    for process in ("0-2", "observer-a.1", "1-2"):
        link._frame(
            f"choir/s/f/0-1/b/{process}/control",
            encode_frame(Frame(process, 2, DRONE_TOPICS.state.klass, [])),
            0,
        )
    assert link._estranged.due(gone_too=True) == ["1-2"]


class Sample:
    """A sample in the form that Zenoh gives it."""

    kind = zenoh.SampleKind.PUT

    def __init__(self, key, payload=b""):
        self.key_expr, self.payload = key, zenoh.ZBytes(payload)


@pytest.mark.parametrize(
    ("size", "most"),
    [
        (1, FLOOD_LIMITS.burst_size),
        (8 << 20, FLOOD_LIMITS.burst_size * FLOOD_LIMITS.frame_part / (8 << 20)),
    ],
)
async def test_a_flood_of_frames_is_cut_off_by_their_number_and_by_their_size(
    size, most
):
    link, payload = await link_of_a(), bytes(size)
    for _ in range(2 * int(most)):
        link._received(Sample(OF_B, payload))
    assert len(link._arrivals._waiting) <= most
    assert link.counters.flooded >= most - 1
    link._arrivals._waiting.clear()


async def test_a_flood_of_tokens_is_cut_off_and_leaves_the_queue_to_the_others(caplog):
    link = await link_of_a()
    for k in range(3 * FRAME_READING.backlog):
        link._token(Sample(f"choir/s/live/b/1-{k}"))
    link._received(Sample("choir/s/f/0-1/c/2-1/control"))
    assert link.counters.overflowed == 0
    assert link.counters.flooded > FRAME_READING.backlog
    assert link._arrivals._waiting[-1][1] == "choir/s/f/0-1/c/2-1/control"
    await asyncio.sleep(0)
    assert caplog.text.count("host b floods us") == 1
    link._arrivals._waiting.clear()


# Frames through a socket ----------------------------------------------------------------------------------------------


def log_line(text="x"):
    topic = DRONE_TOPICS.log.number
    return frame(Envelope(topic, 1, (0,), 0, 0, 0.5, "", encode(text)))


def listen_to_logs(link):
    """Return a list that gets the (value, age) of each log line of drone 1."""
    heard = []
    link.bus.ports[0].handlers[DRONE_TOPICS.log.number] = (
        lambda source, payload, number, channel, flags, age: heard.append(
            (decode(payload), age)
        )
    )
    return heard


async def test_a_message_ages_in_the_socket():
    link = await link_of_a()
    heard = listen_to_logs(link)
    link.bus.clock.ns = 5_000_000_000
    link._local_frame("1-1", log_line(), 3_000_000_000)
    link._local_frame("1-1", log_line("from the future"), 9_000_000_000)
    assert heard == [("x", 2.5), ("from the future", 0.5)]


async def test_what_is_no_frame_of_the_process_of_a_socket_is_counted():
    link = await link_of_a()
    heard = listen_to_logs(link)
    counters = link.counters
    link._local_frame("2-1", log_line(), 0)
    link._local_frame("1-1", encode_frame(Frame("2-1", 2, 2, [])), 0)
    assert counters.strangers == 2
    link._local_frame("1-1", bytes([FRAME_FORMAT.version + 1]), 0)
    assert counters.other_version == 1
    link._local_frame("1-1", log_line()[:-1], 0)
    assert counters.malformed == 1
    assert heard == []


async def test_a_flood_through_a_socket_is_cut_off(caplog):
    link = await link_of_a()
    heard = listen_to_logs(link)
    for _ in range(2 * int(FLOOD_LIMITS.burst_size)):
        link._local_frame("1-1", log_line(), 0)
    assert len(heard) == FLOOD_LIMITS.burst_size
    assert link.counters.flooded == FLOOD_LIMITS.burst_size
    await asyncio.sleep(0)
    assert caplog.text.count("floods us") == 1


async def test_an_error_of_a_handler_of_a_local_frame_is_counted():
    link = await link_of_a()

    def fails(*message):
        raise ValueError("no")

    link.bus.ports[0].handlers[DRONE_TOPICS.log.number] = fails
    link._receive_local("1-1", log_line(), 0)
    assert link.counters.failed == 1


@pytest.mark.parametrize(
    ("host", "heard", "reached"),
    [("b", ["0-1"], False), ("a", [], False), ("a", ["0-1"], True)],
)
async def test_processes_of_the_host_are_reached_when_hello_has_gone_both_ways(
    host, heard, reached
):
    link = await link_of_a()
    link.bus.host = "a"
    link.table.went("b", "1-1", "token")
    peer = link.table.came(host, "1-1", "token")
    asked = []
    link.local.reach = lambda process, address: asked.append((process, address))
    there = LocalAddress("machine", "path")
    said = Hello("1-1", host, 2, "1", 1.0, [1], [], [], heard, False, local=there)
    link._greeted(peer, said.payload(), 0.0)
    assert asked == ([("1-1", there)] if reached else [])
