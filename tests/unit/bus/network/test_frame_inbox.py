"""Which frames are believed, and which ports get their messages, without a network."""

import asyncio

import msgspec
import pytest
import zenoh
from link_parts import (
    FRAME_KEY,
    make_bus,
    make_frame,
    make_hello,
    make_table,
    meet,
)
from message_parts import taking_parts

from crazychoir.bus.codec import decode, encode
from crazychoir.bus.frames import FRAME_FORMAT, Envelope
from crazychoir.bus.network.arrival_queue import FRAME_READING
from crazychoir.bus.network.flood_limit import FLOOD_LIMITS
from crazychoir.bus.network.frame_inbox import FrameInbox
from crazychoir.bus.network.link_counters import LinkCounters
from crazychoir.bus.topics import DRONE_TOPICS, MESSAGE_TOPICS, MessageClass


class NotedGreeter:
    """Notes what it gets."""

    def __init__(self):
        self.got = []

    def take_hello(self, peer, payload, age):
        self.got.append(("hello", peer.process, payload, age))

    def take_clock_message(self, peer, payload, arrived_ns):
        self.got.append(("clock", peer.process, payload, arrived_ns))

    def meet_stranger(self, key, frame):
        self.got.append(("stranger", key))

    def token_came(self, key, data, arrived_ns):
        self.got.append(("came", key))

    def token_went(self, key, data, arrived_ns):
        self.got.append(("went", key))


class Receiver:
    """The inbox of process 0-1, and the (value, age) of each log line that drone 0 has received."""

    def __init__(self):
        self.bus = make_bus()
        self.table = make_table(self.bus)
        self.greeter = NotedGreeter()
        self.counters = LinkCounters()
        self.inbox = FrameInbox(self.bus, self.table, self.greeter, self.counters)
        self.heard = []
        self.bus.ports[0].handlers[DRONE_TOPICS.log.number] = taking_parts(self._hear)

    def _hear(self, source, payload, number, channel, flags, age):
        self.heard.append((decode(payload), age))

    @property
    def waiting(self):
        """The frames and tokens that wait for the event loop."""
        return self.inbox._arrivals._waiting


@pytest.fixture
async def receiver():
    made = Receiver()
    yield made
    made.waiting.clear()


class Sample:
    """A sample in the form that Zenoh gives it."""

    def __init__(self, key, payload=b""):
        self.key_expr = key
        self.payload = zenoh.ZBytes(payload)


def log_line(text="x", source=1, to=(0,), age=0.5, number=0):
    topic = DRONE_TOPICS.log.number
    return Envelope(topic, source, to, number, 0, age, "", encode(text))


async def test_a_message_is_delivered_once_to_a_repeated_receiver(receiver):
    receiver.inbox._frame(FRAME_KEY, make_frame(log_line(to=(0,) * 1000)), 0)
    assert len(receiver.heard) == 1


async def test_a_frame_from_a_thread_is_read_in_the_event_loop(receiver):
    receiver.inbox.receive(Sample(FRAME_KEY, make_frame(log_line())))
    assert receiver.heard == []
    await asyncio.sleep(0)
    assert receiver.heard == [("x", 0.5)]
    assert receiver.counters.frames_received == 1


async def test_key_token_frame_and_message_must_name_one_sender(receiver):
    """Access control only checks which keys a host uses."""
    inbox = receiver.inbox
    said = make_frame(log_line())
    # Host c uses the name of a process of host b.
    inbox._frame("choir/s/f/0-1/c/1-1/control", said, 0)
    # Process 1-2 has no token.
    inbox._frame("choir/s/f/0-1/b/1-2/control", said, 0)
    inbox._frame(FRAME_KEY, make_frame(log_line(), process="1-2"), 0)
    strangers = [key for kind, key in receiver.greeter.got if kind == "stranger"]
    assert len(strangers) == 3
    # Host b sends for drone 2 of host c.
    meet(receiver.table, make_hello("2-1", "c", drones=[2]))
    inbox._frame(FRAME_KEY, make_frame(log_line(source=2)), 0)
    assert (receiver.heard, receiver.counters.strangers) == ([], 4)
    inbox._frame(FRAME_KEY, said, 0)
    assert len(receiver.heard) == 1


async def test_messages_between_processes_go_to_the_greeter(receiver):
    topics = (MESSAGE_TOPICS.hello, MESSAGE_TOPICS.clock)
    sent = [
        Envelope(topic.number, 0, (), 0, 0, 0.5, "", topic.name.encode())
        for topic in topics
    ]
    receiver.bus.clock.ns = 2_000_000_000
    receiver.inbox._frame(FRAME_KEY, make_frame(*sent), 1_000_000_000)
    assert receiver.greeter.got == [
        ("hello", "1-1", b"hello", 1.5),
        ("clock", "1-1", b"clock", 1_000_000_000),
    ]


async def test_tokens_are_taken_in_the_event_loop(receiver):
    key = "choir/s/live/b/1-2"
    receiver.inbox.receive_token(key, True)
    receiver.inbox.receive_token(key, False)
    assert receiver.greeter.got == []
    await asyncio.sleep(0)
    assert receiver.greeter.got == [("came", key), ("went", key)]


async def test_frames_that_cannot_be_decoded_are_counted(receiver):
    receiver.inbox._frame(FRAME_KEY, bytes([FRAME_FORMAT.version + 1]), 0)
    receiver.inbox._frame(FRAME_KEY, make_frame(log_line())[:-1], 0)
    counters = receiver.counters
    assert (counters.other_version, counters.malformed) == (1, 1)
    assert receiver.heard == []


@pytest.mark.parametrize(
    ("size", "most"),
    [
        (1, FLOOD_LIMITS.burst_size),
        (8 << 20, FLOOD_LIMITS.burst_size * FLOOD_LIMITS.frame_part / (8 << 20)),
    ],
)
async def test_a_flood_of_frames_is_cut_off_by_their_number_and_by_their_size(
    receiver, size, most
):
    payload = bytes(size)
    for _ in range(2 * int(most)):
        receiver.inbox.receive(Sample(FRAME_KEY, payload))
    assert len(receiver.waiting) <= most
    assert receiver.counters.flooded >= most - 1


async def test_a_flood_of_tokens_is_cut_off_and_leaves_the_queue_to_the_others(
    receiver, caplog
):
    for k in range(3 * FRAME_READING.backlog):
        receiver.inbox.receive_token(f"choir/s/live/b/1-{k}", True)
    receiver.inbox.receive(Sample("choir/s/f/0-1/c/2-1/control"))
    assert receiver.counters.overflowed == 0
    assert receiver.counters.flooded > FRAME_READING.backlog
    assert receiver.waiting[-1][1] == "choir/s/f/0-1/c/2-1/control"
    await asyncio.sleep(0)
    assert caplog.text.count("host b floods us") == 1


# Frames through a socket ----------------------------------------------------------------------------------------------


async def test_a_message_ages_in_the_socket(receiver):
    receiver.bus.clock.ns = 5_000_000_000
    receive = receiver.inbox.receive_local
    receive("1-1", make_frame(log_line()), 3_000_000_000)
    receive("1-1", make_frame(log_line("from the future")), 9_000_000_000)
    assert receiver.heard == [("x", 2.5), ("from the future", 0.5)]


async def test_what_is_no_frame_of_the_process_of_a_socket_is_counted(receiver):
    counters = receiver.counters
    receive = receiver.inbox.receive_local
    receive("2-1", make_frame(log_line()), 0)
    receive("1-1", make_frame(process="2-1"), 0)
    assert counters.strangers == 2
    receive("1-1", bytes([FRAME_FORMAT.version + 1]), 0)
    assert counters.other_version == 1
    receive("1-1", make_frame(log_line())[:-1], 0)
    assert counters.malformed == 1
    assert receiver.heard == []


async def test_what_has_no_topic_is_counted_as_malformed_from_a_known_source_alone(
    receiver,
):
    counters = receiver.counters
    unknown = msgspec.structs.replace(log_line(), topic=251)
    elsewhere = msgspec.structs.replace(unknown, source=7)
    receiver.inbox.receive_local("1-1", make_frame(unknown, elsewhere, log_line()), 0)
    assert (counters.malformed, counters.strangers) == (1, 1)
    assert [text for text, _ in receiver.heard] == ["x"]


async def test_a_flood_through_a_socket_is_cut_off(receiver, caplog):
    frame = make_frame(log_line())
    for _ in range(2 * int(FLOOD_LIMITS.burst_size)):
        receiver.inbox.receive_local("1-1", frame, 0)
    assert len(receiver.heard) == FLOOD_LIMITS.burst_size
    assert receiver.counters.flooded == FLOOD_LIMITS.burst_size
    await asyncio.sleep(0)
    assert caplog.text.count("floods us") == 1


async def test_an_error_of_a_handler_of_a_local_frame_is_counted(receiver):
    def fails(*message):
        raise ValueError("no")

    receiver.bus.ports[0].handlers[DRONE_TOPICS.log.number] = taking_parts(fails)
    receiver.inbox.receive_local("1-1", make_frame(log_line()), 0)
    assert receiver.counters.failed == 1


@pytest.mark.parametrize("klass", [MessageClass.CONTROL, MessageClass.ROUNDS])
async def test_control_through_zenoh_does_not_replace_newer_control_of_a_socket(
    receiver, klass
):
    """The first message through a socket may overtake the last ones through Zenoh."""
    inbox = receiver.inbox
    for number in (1, 3):
        frame = make_frame(log_line(str(number), number=number), klass=klass)
        inbox.receive_local("1-1", frame, 0)
    late = [log_line(str(number), number=number) for number in (2, 3, 4)]
    late += [log_line("unnumbered"), log_line("elsewhere", to=(0, 5), number=1)]
    for message in late:
        inbox._frame(FRAME_KEY, make_frame(message, klass=klass), 0)
    dropped = klass is MessageClass.CONTROL
    assert receiver.counters.overtaken == dropped
    assert [text for text, _ in receiver.heard] == [
        "1",
        "3",
        *(["2"] if not dropped else []),
        "3",
        "4",
        "unnumbered",
        "elsewhere",
    ]
