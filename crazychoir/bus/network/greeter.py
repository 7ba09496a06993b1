"""The processes of a swarm get to know each other.

A peer is a process with a liveliness token. Messages go to it after its HELLO has arrived. Both
sides send HELLO until each has received the other's.
"""

import logging
from collections.abc import Iterable
from dataclasses import dataclass

from crazychoir.bus.frames import Envelope, Frame
from crazychoir.bus.network.foreign_connections import ForeignConnections
from crazychoir.bus.network.frame_outbox import FrameOutbox
from crazychoir.bus.network.hello import Hello
from crazychoir.bus.network.link_counters import LinkCounters
from crazychoir.bus.network.link_keys import read_sender, read_token
from crazychoir.bus.network.local_sockets import LocalSockets
from crazychoir.bus.network.lost_tokens import TokenRepair
from crazychoir.bus.network.peers import Peer, Peers
from crazychoir.bus.network.zenoh_session import ZenohSession
from crazychoir.bus.port import Bus
from crazychoir.bus.topics import MESSAGE_TOPICS
from crazychoir.errors import CodecError

log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class HelloTiming:
    """How often a process describes itself, and checks its connections."""

    settling_time: int = 5
    """Seconds for which a changed HELLO is repeated every second.

    It is also the time between later repeats.
    """
    asking_rate: int = 4
    """Most HELLOs a second to a peer until HELLO has gone both ways."""
    check_period: int = 2
    """Seconds between checks of the connections."""


HELLO_TIMING = HelloTiming()


class Greeter:
    """Describes this process to the others, and takes their tokens and HELLOs.

    bus: bus of this process
    table: the other processes
    session: declares tokens, and tells which programs are connected
    outbox: sends HELLO and questions for the clock
    sockets: get connected with the processes of this host
    counters: gets the number of messages that could not be decoded
    """

    def __init__(
        self,
        bus: Bus,
        table: Peers,
        session: ZenohSession,
        outbox: FrameOutbox,
        sockets: LocalSockets,
        counters: LinkCounters,
    ) -> None:
        self._bus = bus
        self._table = table
        self._session = session
        self._outbox = outbox
        self._sockets = sockets
        self._counters = counters
        self._to_greet: dict[str, None] = {}
        self._estranged = TokenRepair()
        self._connections = ForeignConnections()

    # Sending HELLO --------------------------------------------------------------------

    async def run(self) -> None:
        """Repeat HELLO, and ask other hosts for their clocks.

        HELLO is sent often to peers that have not received ours, or sent theirs, and seldom when
        all are known. It tells each peer of this peer alone: if it named all that we have heard,
        each of N processes that start together would send it N times to each other one.
        """
        tick = 0
        async for _ in self._bus.clock.ticks(
            HELLO_TIMING.asking_rate * MESSAGE_TOPICS.hello.rate, aligned=True
        ):
            tick += 1
            self._table.offer_new_ports()
            due = (
                tick % HELLO_TIMING.asking_rate == 0
                and self._table.hello_age() < HELLO_TIMING.settling_time
            )
            if (
                self._table.has_news()
                or tick % (HELLO_TIMING.settling_time * HELLO_TIMING.asking_rate) == 0
            ):
                self.greet_all()
            elif due:
                self._repeat_hello()
            self._ask_unknown()
            self._greet_estranged(gone_too=tick % HELLO_TIMING.asking_rate == 0)
            if tick % HELLO_TIMING.asking_rate == 0:
                self._ask_clocks()
                self._bus.link_faults = self._counters.list_faults()
            if tick % (HELLO_TIMING.check_period * HELLO_TIMING.asking_rate) == 0:
                self._check_connections()

    def _ask_unknown(self) -> None:
        """Send HELLO to peers that have not received ours, or sent theirs: ever less often, then each second.

        On a busy machine a peer needs a while to answer, and more questions would make it longer.
        """
        for peer in self._table.by_name.values():
            if peer.refusal or self._table.mutual(peer):
                continue
            peer.asked += 1
            is_power_of_two = peer.asked & (peer.asked - 1) == 0
            if is_power_of_two or peer.asked % HELLO_TIMING.asking_rate == 0:
                self._greet([peer.process])

    def greet_all(self) -> None:
        """Send HELLO to every peer at the end of this pass of the event loop."""
        if self._table.by_name:
            self._greet(self._table.by_name)

    def _repeat_hello(self) -> None:
        """Send HELLO again to each peer that may have lost it: a socket hardly loses any."""
        connections = self._sockets.connections
        doubtful = [
            peer.process
            for peer in self._table.by_name.values()
            if peer.told != self._table.hello_to(peer)
            or peer.process not in connections
        ]
        if doubtful:
            self._greet(doubtful)

    def _greet(self, processes: Iterable[str]) -> None:
        """Send one HELLO to each of these processes at the end of this pass of the event loop."""
        if not self._to_greet:
            self._outbox.call_before_flush(self._say_hello)
        self._to_greet.update(dict.fromkeys(processes))

    def _say_hello(self) -> None:
        processes = self._to_greet
        self._to_greet = {}
        for process in processes:
            peer = self._table.by_name.get(process)
            if peer is not None:
                hello = self._make_hello(peer)
                self._outbox.add(peer, MESSAGE_TOPICS.hello.klass, hello)
                if process in self._sockets.connections:
                    peer.told = hello.payload

    def _make_hello(self, peer: Peer | None) -> Envelope:
        """Return the message with our HELLO for a peer, or for a process that is none."""
        payload = self._table.hello_to(peer)
        age = self._table.hello_age()
        return Envelope(MESSAGE_TOPICS.hello.number, 0, (), 0, 0, age, "", payload)

    def _greet_estranged(self, gone_too: bool) -> None:
        """Send HELLO to processes without a token, without the queues of a peer."""
        processes = self._estranged.due(gone_too)
        if self._session.is_open and processes:
            hello = self._make_hello(None)
            klass = MESSAGE_TOPICS.hello.klass
            self._outbox.send_without_queue(processes, klass, hello)

    # Taking HELLO ---------------------------------------------------------------------

    def take_hello(self, peer: Peer, payload: bytes, age: float) -> None:
        """Take a HELLO of a peer, which is `age` seconds old."""
        try:
            if self._table.greeted(peer, payload, age):
                self._greet([peer.process])
        except CodecError:
            self._counters.malformed += 1
            return
        if not peer.refusal:
            is_mutual = self._table.mutual(peer)
            lacks_token = peer.hello is not None and peer.hello.lacks_token
            self._heard_of_us(peer.process, is_mutual, lacks_token)
            is_here = peer.host == self._bus.host
            if is_mutual and is_here and peer.hello is not None:
                self._sockets.reach(peer.process, peer.hello.local)

    def meet_stranger(self, key: str, frame: Frame) -> None:
        """Take a frame of a process without a token.

        The process gets an answer, unless its name is forged, known, our own, or invalid.
        """
        host, process = read_sender(key)
        known = process == self._bus.process or process in self._table.by_name
        if known or process != frame.process or not self._table.may_be(host, process):
            return
        self._estranged.heard(process)
        for message in frame.envelopes:
            if message.topic == MESSAGE_TOPICS.hello.number:
                self._greeted_by_stranger(host, process, message.payload)

    def _greeted_by_stranger(self, host: str, process: str, payload: bytes) -> None:
        try:
            hello = Hello.of(payload)
        except CodecError:
            self._counters.malformed += 1
            return
        if (hello.host, hello.process) == (host, process):
            self._heard_of_us(process, hello.hears_receiver, hello.lacks_token)

    def _heard_of_us(self, process: str, knows_us: bool, lacks_token: bool) -> None:
        """Declare one more token if the process hears us and does not see ours."""
        if knows_us:
            self._estranged.known(process)
            return
        is_due = lacks_token and self._estranged.missed(process)
        if is_due and self._session.is_open:
            log.info("%s hears us and has no token of ours: one more", process)
            self._session.declare_another_token()

    # Tokens ---------------------------------------------------------------------------

    def token_came(self, key: str, data: bytes, arrived_ns: int) -> None:
        """Take a token that has appeared, and greet its process if it is new."""
        host, process = read_token(key)
        self._estranged.came(process)
        peer = self._table.came(host, process, key)
        if peer is not None:
            self._greet([peer.process])

    def token_went(self, key: str, data: bytes, arrived_ns: int) -> None:
        """Forget the process of a token that has disappeared, if it was its last one."""
        host, process = read_token(key)
        peer = self._table.went(host, process, key)
        if peer is not None:
            self._estranged.went(process)
            self._sockets.forget(process)
            self._outbox.drop_queues(peer)

    # Clocks ---------------------------------------------------------------------------

    def _ask_clocks(self) -> None:
        self._bus.offsets = self._table.offsets()
        now_ns = self._bus.clock.now_ns
        for peer in self._table.on_other_hosts:
            self._say_time(peer, peer.offset.ask(now_ns()))

    def take_clock_message(self, peer: Peer, payload: bytes, arrived_ns: int) -> None:
        """Take a question for our clock, or the answer to ours, from a peer with a HELLO.

        arrived_ns: ns, time of arrival
        """
        if peer.hello is None:
            return
        try:
            answer = peer.offset.hear(payload, arrived_ns, self._bus.clock.now_ns())
        except CodecError:
            self._counters.malformed += 1
            return
        if answer is not None:
            self._say_time(peer, answer)

    def _say_time(self, peer: Peer, payload: bytes) -> None:
        self._outbox.add(
            peer,
            MESSAGE_TOPICS.clock.klass,
            Envelope(MESSAGE_TOPICS.clock.number, 0, (), 0, 0, 0.0, "", payload),
        )

    # Connections ----------------------------------------------------------------------

    def _check_connections(self) -> None:
        """Warn about programs that connect with the certificate
        of a host and are not in the swarm.
        """
        access = self._table.access
        if not self._session.is_open or access is None or access.router is not None:
            return  # through a router there are connections of all hosts
        for host in self._connections.look(
            self._session.connected_programs(),
            (peer.host for peer in self._table.by_name.values()),
        ):
            log.warning(
                "a program with the certificate of host %s is connected and is no process of this swarm: nothing of "
                "it is believed but what that host may say",
                host,
            )
