"""How a link joins its parts, without a network."""

import pytest
from link_parts import OWN_INTRODUCTION, make_bus, make_frame, make_hello, meet
from message_parts import taking_parts

from crazychoir.bus.codec import encode
from crazychoir.bus.frames import FRAME_FORMAT, Envelope, decode_frame
from crazychoir.bus.message import Message
from crazychoir.bus.network.zenoh_link import ZenohLink
from crazychoir.bus.network.zenoh_session import SessionEndpoints
from crazychoir.bus.port import PORT_ADDRESSES, Interest
from crazychoir.bus.topics import DRONE_TOPICS, MESSAGE_TOPICS

OBSERVER = PORT_ADDRESSES.first_observer


class NotedSession:
    """Keeps what is put at a key."""

    is_open = True

    def __init__(self, keys):
        self.keys = keys
        self.put_at = {}

    def put(self, key, data):
        self.put_at[key] = data


@pytest.fixture
async def link():
    """The link of process 0-1 with drone 0, which knows 1-1 with drone 1 and 2-1 with drone 2."""
    made = ZenohLink(make_bus(), OWN_INTRODUCTION, SessionEndpoints([], []))
    meet(made.table, make_hello())
    meet(made.table, make_hello("2-1", "c", drones=[2, 3]))
    return made


def forwarded(link, to):
    """Return the (process, receivers) of each message that the outbox gets."""
    added = []
    link.outbox.add = lambda peer, klass, message: added.append(
        (peer.process, message.to)
    )
    link.forward(Message(MESSAGE_TOPICS.rounds, 0, b"x"), to, 0.0)
    return added


async def test_a_message_goes_once_to_each_process(link):
    assert forwarded(link, [1]) == [("1-1", (1,))]
    assert forwarded(link, [2, 1, 3]) == [("2-1", (2, 3)), ("1-1", (1,))]


async def test_a_message_to_an_unknown_drone_is_counted(link):
    assert forwarded(link, [7, 1, 8]) == [("1-1", (1,))]
    assert link.bus.unroutable == 2


async def test_receivers_that_do_not_fit_into_one_message_get_several(link):
    most = FRAME_FORMAT.max_destinations
    assert [len(to) for _, to in forwarded(link, [1] * (most + 1))] == [most, 1]


async def test_a_message_before_opening_is_dropped(link):
    link.forward(Message(MESSAGE_TOPICS.rounds, 0, b"x"), [1], 0.0)
    assert link.counters.dropped == 1


async def test_a_received_message_reaches_its_port(link):
    heard = []
    link.bus.ports[0].handlers[DRONE_TOPICS.log.number] = taking_parts(
        lambda *message: heard.append(message)
    )
    line = Envelope(DRONE_TOPICS.log.number, 1, (0,), 0, 0, 0.0, "", encode("x"))
    link.inbox.receive_local("1-1", make_frame(line), 0)
    assert len(heard) == 1
    assert link.counters.frames_received == 1


async def test_an_alarm_goes_to_the_readers_of_the_log_and_to_other_programs(link):
    reading = make_hello(
        "9-1",
        "c",
        drones=[],
        observers=[OBSERVER],
        interests=[Interest("log", 0, OBSERVER)],
    )
    meet(link.table, reading)
    link.session = NotedSession(link.session.keys)
    link.alarm(0, "the loop hangs")
    assert link.session.put_at.pop("choir/s/drone/0/alarm") == "the loop hangs"
    [(key, frame)] = link.session.put_at.items()
    assert key == "choir/s/f/9-1/a/0-1/bulk"
    [line] = decode_frame(frame).envelopes
    assert (line.to, line.payload) == ((OBSERVER,), encode("the loop hangs"))
    link.session.is_open = False
    link.alarm(1, "too late")
    assert list(link.session.put_at) == [key]
