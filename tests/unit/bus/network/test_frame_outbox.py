"""When messages leave, in which frames and on which way, without a network."""

import asyncio

import pytest
from link_parts import make_bus, make_table

from crazychoir.bus.frames import FRAME_FORMAT, Envelope, decode_frame
from crazychoir.bus.network.frame_outbox import FrameOutbox
from crazychoir.bus.network.link_counters import LinkCounters
from crazychoir.bus.network.link_keys import LinkKeys
from crazychoir.bus.topics import MessageClass

KEPT_CLASS = MessageClass.ROUNDS


class NotedPublisher:
    """Keeps its frames."""

    def __init__(self, klass):
        self.klass = klass
        self.frames = []
        self.is_declared = True

    def put(self, payload):
        self.frames.append(payload)

    def undeclare(self):
        self.is_declared = False


class NotedSession:
    """A session that keeps the frames, and may refuse them."""

    keys = LinkKeys("s", "a", "0-1")

    def __init__(self):
        self.is_open = True
        self.refuses = False
        self.publishers = []
        self.declared = []
        self.apart = []

    def make_publisher(self, process, klass, *, is_occasional):
        self.publishers.append(NotedPublisher(klass))
        self.declared += [] if is_occasional else [process]
        return self.publishers[-1]

    def send(self, put, frame):
        if not self.refuses:
            put(frame)
        return not self.refuses

    def send_frame(self, process, klass, frame):
        self.apart.append((process, klass, frame))
        return not self.refuses

    @property
    def frames(self):
        """The decoded frames of all publishers."""
        return [
            decode_frame(frame)
            for publisher in self.publishers
            for frame in publisher.frames
        ]


class NotedSockets:
    """Sockets to some processes of this host."""

    def __init__(self):
        self.connections = {}
        self.is_full = False
        self.frames = []

    def send_at_once(self, frame):
        if not self.is_full:
            self.frames.append(frame)
        return not self.is_full

    def send(self, process, klass, frame):
        return False


class Sending:
    """The outbox of process 0-1, and a peer."""

    def __init__(self):
        self.peer = make_table(make_bus()).by_name["1-1"]
        self.session = NotedSession()
        self.sockets = NotedSockets()
        self.counters = LinkCounters()
        self.outbox = FrameOutbox(self.session, self.sockets, 7, self.counters)

    def add(self, number, klass=KEPT_CLASS):
        message = Envelope(1, 0, (1,), number, 0, 0.0, "", b"x")
        self.outbox.add(self.peer, klass, message)

    @property
    def numbers(self):
        """The numbers of the messages of each frame that went through Zenoh."""
        return [
            [message.number for message in frame.envelopes]
            for frame in self.session.frames
        ]


@pytest.fixture
async def sending():
    return Sending()


async def test_the_messages_of_a_pass_share_a_frame_for_each_class(sending):
    sending.add(1)
    sending.add(2)
    sending.add(3, MessageClass.BULK)
    assert sending.numbers == []
    await asyncio.sleep(0)
    assert sending.numbers == [[1, 2], [3]]
    assert [frame.kind for frame in sending.session.frames] == [
        KEPT_CLASS,
        MessageClass.BULK,
    ]
    frame = sending.session.frames[0]
    assert (frame.process, frame.incarnation) == ("0-1", 7)
    sending.add(4)
    await asyncio.sleep(0)
    assert sending.numbers == [[1, 2], [4], [3]]
    assert sending.counters.frames_sent == 3
    assert sending.counters.bytes_sent == sum(
        len(frame)
        for publisher in sending.session.publishers
        for frame in publisher.frames
    )


async def test_only_the_newest_control_message_leaves(sending):
    for number in range(3):
        sending.add(number, MessageClass.CONTROL)
    sending.outbox.flush()
    assert sending.numbers == [[2]]


async def test_frames_to_a_connected_process_go_through_its_socket(sending):
    sending.sockets.connections["1-1"] = sending.sockets
    sending.add(1)
    sending.outbox.flush()
    assert (len(sending.sockets.frames), sending.numbers) == (1, [])
    sending.sockets.connections.clear()
    sending.add(2)
    sending.outbox.flush()
    assert (len(sending.sockets.frames), sending.numbers) == (1, [[2]])
    assert sending.counters.frames_sent == 2


@pytest.mark.parametrize(("host", "count"), [("a", 0), ("b", 1)])
async def test_nothing_is_declared_for_frames_to_a_process_of_the_host(
    sending, host, count
):
    sending.peer.host = host
    sending.add(1)
    sending.outbox.flush()
    assert len(sending.session.declared) == count
    assert sending.numbers == [[1]]


async def test_frames_that_do_not_leave_are_not_counted_as_sent(sending):
    sending.session.refuses = True
    sending.add(1)
    sending.outbox.flush()
    sending.sockets.connections["1-1"] = sending.sockets
    sending.sockets.is_full = True
    sending.add(2)
    sending.outbox.flush()
    counters = sending.counters
    assert (counters.frames_sent, counters.bytes_sent) == (0, 0)


async def test_a_closed_session_takes_no_message(sending):
    sending.session.is_open = False
    sending.add(1)
    await asyncio.sleep(0)
    assert (sending.counters.dropped, sending.session.publishers) == (1, [])


async def test_a_message_that_fits_into_no_frame_is_counted(sending, caplog):
    size = FRAME_FORMAT.max_bytes + 1
    message = Envelope(1, 0, (1,), 0, 0, 0.0, "", bytes(size))
    sending.outbox.add(sending.peer, KEPT_CLASS, message)
    sending.outbox.flush()
    assert (sending.counters.unsendable, sending.numbers) == (1, [])
    assert "not sent" in caplog.text


async def test_work_before_the_flush_adds_messages_that_leave_in_this_pass(sending):
    sending.outbox.call_before_flush(lambda: sending.add(1))
    await asyncio.sleep(0)
    assert sending.numbers == [[1]]


async def test_work_after_the_flush_runs_when_the_frames_have_left(sending):
    seen = []
    sending.outbox.call_after_flush(lambda: seen.append(sending.numbers))
    sending.add(1)
    await asyncio.sleep(0)
    assert seen == [[[1]]]


async def test_what_waits_for_a_peer_that_went_away_is_dropped(sending):
    sending.add(1)
    sending.add(2)
    sending.outbox.drop_queues(sending.peer)
    sending.outbox.flush()
    assert (sending.counters.dropped, sending.numbers) == (2, [])
    assert not sending.session.publishers[0].is_declared


async def test_a_process_without_a_token_gets_a_frame_of_its_own(sending):
    message = Envelope(1, 0, (), 3, 0, 0.0, "", b"x")
    sending.outbox.send_without_queue(["2-1", "2-2"], KEPT_CLASS, message)
    assert [process for process, _, _ in sending.session.apart] == ["2-1", "2-2"]
    _, klass, frame = sending.session.apart[0]
    assert (klass, decode_frame(frame).envelopes) == (KEPT_CLASS, [message])
    assert sending.counters.frames_sent == 2
