"""How processes get to know each other, without a network."""

import asyncio
from pathlib import Path

import pytest
from link_parts import make_bus, make_hello, make_table, meet

from crazychoir.bus.clock_offset import ClockOffset
from crazychoir.bus.frames import Envelope, Frame
from crazychoir.bus.network.access import NetworkAccess
from crazychoir.bus.network.greeter import Greeter
from crazychoir.bus.network.hello import Hello
from crazychoir.bus.network.link_counters import LinkCounters
from crazychoir.bus.network.local_address import LocalAddress
from crazychoir.bus.network.lost_tokens import LOST_TOKEN_LIMITS
from crazychoir.bus.topics import MESSAGE_TOPICS
from crazychoir.runtime.clock import run_virtual

HELLO_TOPIC = MESSAGE_TOPICS.hello


class NotedSession:
    """Counts the additional tokens, and tells which programs are connected."""

    is_open = True
    tokens = 0
    programs = ()

    def declare_another_token(self):
        self.tokens += 1

    def connected_programs(self):
        return list(self.programs)


class NotedOutbox:
    """Keeps what is sent."""

    def __init__(self):
        self.before = []
        self.sent = []
        self.apart = []
        self.dropped = []

    def call_before_flush(self, work):
        self.before.append(work)

    def flush(self):
        """End a pass of the event loop, and return the (process, topic) of what is sent."""
        while self.before:
            self.before.pop(0)()
        sent = [(process, message.topic) for process, message in self.sent]
        self.sent.clear()
        return sent

    def add(self, peer, klass, message):
        self.sent.append((peer.process, message))

    def send_without_queue(self, processes, klass, message):
        self.apart += [(process, message.topic) for process in processes]

    def drop_queues(self, peer):
        self.dropped.append(peer.process)


class NotedSockets:
    """Notes the processes that it is to reach and to forget."""

    def __init__(self):
        self.reached = []
        self.forgotten = []
        self.connections = {}

    def reach(self, process, address):
        self.reached.append((process, address))

    def forget(self, process):
        self.forgotten.append(process)


class Meeting:
    """The greeter of process 0-1, and what it does."""

    def __init__(self, access=None):
        self.bus = make_bus()
        self.table = make_table(self.bus, access)
        self.session = NotedSession()
        self.outbox = NotedOutbox()
        self.sockets = NotedSockets()
        self.counters = LinkCounters()
        self.greeter = Greeter(
            self.bus,
            self.table,
            self.session,
            self.outbox,
            self.sockets,
            self.counters,
        )

    def meet_stranger(self, process, *payloads, key_process=None):
        """Take a frame with HELLOs of a process of host b without a token."""
        messages = [
            Envelope(HELLO_TOPIC.number, 0, (), 0, 0, 0.0, "", payload)
            for payload in payloads
        ]
        self.greeter.meet_stranger(
            f"choir/s/f/0-1/b/{key_process or process}/rounds",
            Frame(process, 2, HELLO_TOPIC.klass, messages),
        )

    def answered(self):
        """Return the processes without a token that get a HELLO."""
        self.greeter._greet_estranged(gone_too=True)
        return [process for process, _ in self.outbox.apart]


def closed_network(router=None):
    processes = {"a": ("0",), "b": ("1",)}
    return NetworkAccess(
        "s", "a", Path("k"), processes, {0: "a", 1: "b"}, ("a",), router
    )


def test_a_peer_gets_one_hello_in_a_pass_of_the_loop():
    meeting = Meeting()
    meet(meeting.table, make_hello("2-1", "c", drones=[2]))
    meeting.greeter.greet_all()
    meeting.greeter.greet_all()
    assert meeting.outbox.flush() == [
        ("1-1", HELLO_TOPIC.number),
        ("2-1", HELLO_TOPIC.number),
    ]
    assert meeting.outbox.flush() == []


def test_a_peer_that_has_gone_gets_no_hello():
    meeting = Meeting()
    meeting.greeter.greet_all()
    meeting.table.went("b", "1-1", "token")
    assert meeting.outbox.flush() == []


def test_without_peers_there_is_nothing_to_send():
    meeting = Meeting()
    meeting.table.by_name.clear()
    meeting.greeter.greet_all()
    assert meeting.outbox.before == []


def test_a_new_process_is_greeted():
    meeting = Meeting()
    key = "choir/s/live/c/2-1"
    meeting.greeter.token_came(key, b"", 0)
    meeting.greeter.token_came(key, b"", 0)
    assert meeting.outbox.flush() == [("2-1", HELLO_TOPIC.number)]


def test_first_hello_of_a_peer_is_answered_once():
    meeting = Meeting()
    peer = meeting.table.came("b", "2-1", "token")
    answers = []
    for knows_us, drones in ((True, [2]), (True, [2, 3]), (False, [2])):
        said = make_hello("2-1", drones=drones, hears_receiver=knows_us)
        meeting.greeter.take_hello(peer, said.payload(), 0.0)
        answers.append(meeting.outbox.flush())
    answer = [("2-1", HELLO_TOPIC.number)]
    assert answers == [answer, [], answer], "the last HELLO tells that we are not heard"


def test_only_a_process_that_is_heard_for_the_first_time_gets_a_hello():
    meeting = Meeting()

    async def main(clock):
        meeting.bus.clock = clock
        running = asyncio.create_task(meeting.greeter.run())
        await clock.sleep(1.1)
        meeting.outbox.flush()
        peer = meeting.table.came("b", "2-1", "token")
        said = make_hello("2-1", drones=[2])
        meeting.greeter.take_hello(peer, said.payload(), 0.0)
        await clock.sleep(0.3)
        after_heard = meeting.outbox.flush()
        meeting.bus.port(7)
        await clock.sleep(0.3)
        after_port = meeting.outbox.flush()
        running.cancel()
        return after_heard, after_port

    after_heard, after_port = run_virtual(main)
    assert after_heard == [("2-1", HELLO_TOPIC.number)]
    assert sorted(after_port) == [
        ("1-1", HELLO_TOPIC.number),
        ("2-1", HELLO_TOPIC.number),
    ]


def test_what_waits_for_a_process_is_dropped_with_its_last_token():
    meeting = Meeting()
    first = "choir/s/live/b/1-1"
    meeting.table.by_name["1-1"].tokens = {first, f"{first}/1"}
    meeting.greeter.token_went(first, b"", 0)
    assert meeting.outbox.dropped == meeting.sockets.forgotten == []
    meeting.greeter.token_went(f"{first}/1", b"", 0)
    assert meeting.outbox.dropped == meeting.sockets.forgotten == ["1-1"]
    assert meeting.answered() == ["1-1"], "its link may come back"


@pytest.mark.parametrize(
    ("host", "knows_us", "reached"),
    [("b", True, False), ("a", False, False), ("a", True, True)],
)
def test_processes_of_the_host_are_reached_when_hello_has_gone_both_ways(
    host, knows_us, reached
):
    meeting = Meeting()
    meeting.table.went("b", "1-1", "token")
    peer = meeting.table.came(host, "1-1", "token")
    there = LocalAddress("machine", "path")
    said = make_hello(host=host, hears_receiver=knows_us, local=there)
    meeting.greeter.take_hello(peer, said.payload(), 0.0)
    assert meeting.sockets.reached == ([("1-1", there)] if reached else [])


def test_a_stranger_with_another_s_name_is_not_answered():
    meeting = Meeting(closed_network())
    for process in ("0-2", "observer-a.1", "1-2"):
        meeting.meet_stranger(process)
    meeting.meet_stranger("1-3", key_process="1-4")
    assert meeting.answered() == ["1-2"]


def test_a_process_that_hears_us_and_lost_our_token_gets_another_one():
    meeting = Meeting()
    forgetful = make_hello("1-2", hears_receiver=False, lacks_token=True).payload()
    for _ in range(LOST_TOKEN_LIMITS.patience - 1):
        meeting.meet_stranger("1-2", forgetful)
        meeting.answered()
    assert meeting.session.tokens == 0
    meeting.meet_stranger("1-2", forgetful)
    assert meeting.session.tokens == 1


def test_a_process_that_has_not_heard_us_yet_needs_no_further_token():
    meeting = Meeting()
    peer = meeting.table.by_name["1-1"]
    for k in range(2 * LOST_TOKEN_LIMITS.patience):
        early = make_hello(uptime=1.0 + k, hears_receiver=False)
        meeting.greeter.take_hello(peer, early.payload(), 0.0)
        meeting.answered()
    assert meeting.session.tokens == 0


def test_a_peer_that_does_not_answer_is_asked_ever_less_often():
    meeting = Meeting()
    meet(meeting.table, make_hello("2-1", drones=[2], hears_receiver=False))

    async def greet(clock):
        meeting.bus.clock = clock
        running = asyncio.create_task(meeting.greeter.run())
        await clock.sleep(0.05)
        greeted = []
        for _ in range(16):
            await clock.sleep(0.25)
            greeted.append(("2-1", HELLO_TOPIC.number) in meeting.outbox.flush())
        running.cancel()
        return [k for k, is_asked in enumerate(greeted, 1) if is_asked]

    assert run_virtual(greet) == [1, 2, 4, 8, 12, 16]


def test_a_closed_session_declares_no_token_and_greets_no_stranger():
    meeting = Meeting()
    meeting.session.is_open = False
    forgetful = make_hello("1-2", hears_receiver=False, lacks_token=True).payload()
    for _ in range(LOST_TOKEN_LIMITS.patience):
        meeting.meet_stranger("1-2", forgetful)
        assert meeting.answered() == []
    assert meeting.session.tokens == 0


def test_a_hello_that_has_not_changed_is_seldom_repeated_through_a_socket():
    meeting = Meeting()
    meet(meeting.table, make_hello("0-2", host="a", drones=[2]))
    meeting.sockets.connections["0-2"] = "socket"

    async def greet_each_second(clock):
        meeting.bus.clock = clock
        running = asyncio.create_task(meeting.greeter.run())
        greeted = []
        for second in range(6):
            await clock.sleep(1.0 if second else 1.1)
            greeted.append("0-2" in dict(meeting.outbox.flush()))
            if second == 2:
                meeting.bus.port(7)
        running.cancel()
        return greeted

    assert run_virtual(greet_each_second) == [True, False, False, True, True, False]


def test_a_hello_that_no_socket_carries_is_repeated_each_second():
    meeting = Meeting()
    for name in ("0-2", "0-3"):
        meet(meeting.table, make_hello(name, host="a", drones=[int(name[-1])]))
    meeting.sockets.connections["0-3"] = "socket"

    async def greet_each_second(clock):
        meeting.bus.clock = clock
        running = asyncio.create_task(meeting.greeter.run())
        greeted = []
        for second in range(4):
            await clock.sleep(1.0 if second else 1.1)
            sent = dict(meeting.outbox.flush())
            greeted.append([name in sent for name in ("0-2", "0-3")])
            if second == 1:
                del meeting.sockets.connections["0-3"]
        running.cancel()
        return greeted

    assert run_virtual(greet_each_second) == [
        [True, True],
        [True, False],
        [True, True],
        [True, True],
    ]


def test_faults_of_the_link_are_shown_within_a_second():
    meeting = Meeting()
    meeting.counters.full = 3

    async def main(clock):
        meeting.bus.clock = clock
        running = asyncio.create_task(meeting.greeter.run())
        await clock.sleep(1.1)
        running.cancel()

    run_virtual(main)
    assert meeting.bus.link_faults == [
        "frames dropped, because a process of this host reads too slowly: 3"
    ]


def test_messages_that_cannot_be_decoded_are_counted():
    meeting = Meeting()
    peer = meeting.table.by_name["1-1"]
    meeting.greeter.take_hello(peer, b"no hello", 0.0)
    meeting.greeter.take_clock_message(peer, b"no time", 0)
    meeting.meet_stranger("1-2", b"no hello")
    assert meeting.counters.malformed == 3


def test_a_question_for_the_clock_is_answered_after_hello():
    meeting = Meeting()
    peer = meeting.table.by_name["1-1"]
    question = ClockOffset().ask(5)
    meeting.greeter.take_clock_message(peer, question, 7)
    [(process, answer)] = meeting.outbox.sent
    assert (process, answer.topic) == ("1-1", MESSAGE_TOPICS.clock.number)
    meeting.outbox.sent.clear()
    peer.hello = None
    meeting.greeter.take_clock_message(peer, question, 7)
    assert meeting.outbox.sent == []


@pytest.mark.parametrize(("router", "count"), [(None, 1), ("r", 0)])
def test_programs_that_are_no_processes_of_the_swarm_are_reported(
    router, count, caplog
):
    meeting = Meeting(closed_network(router))
    meeting.session.programs = [("b", "1"), ("b", "2")]
    for _ in range(3):
        meeting.greeter._check_connections()
    assert caplog.text.count("certificate of host b is connected") == count


def test_the_hello_that_is_sent_describes_this_process():
    meeting = Meeting()
    meeting.greeter.greet_all()
    meeting.outbox.before[0]()
    [(_, message)] = meeting.outbox.sent
    hello = Hello.of(message.payload)
    assert (hello.process, hello.host, hello.drones) == ("0-1", "a", [0])
    assert hello.hears_receiver
