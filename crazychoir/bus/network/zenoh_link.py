"""The link to other processes: one Zenoh session, one wildcard
subscriber, one put for each (peer process, class, loop pass).

The keys are in link_keys.py.
Every put is DROP and never waits.
A peer is a process with a liveliness token. Messages go to it after its HELLO has arrived. Both
sides send HELLO until each has received the other's.
"""

import asyncio
import contextlib
import json
import logging
import os
import threading
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Self

import zenoh

from crazychoir.bus.codec import encode
from crazychoir.bus.frames import (
    FRAME_FORMAT,
    Envelope,
    Frame,
    FrameBuffer,
    FrameVersionError,
    decode_frame,
    encode_frame,
)
from crazychoir.bus.network import endpoints, handshakes
from crazychoir.bus.network.access import NetworkAccess
from crazychoir.bus.network.arrival_queue import ArrivalQueue
from crazychoir.bus.network.flood_limit import FrameBudget, FrameBudgets
from crazychoir.bus.network.foreign_connections import ForeignConnections
from crazychoir.bus.network.hello import Hello
from crazychoir.bus.network.hello_review import Introduction
from crazychoir.bus.network.link_counters import LinkCounters
from crazychoir.bus.network.link_keys import LinkKeys, read_sender, read_token
from crazychoir.bus.network.local_sockets import LocalIdentity, LocalSockets
from crazychoir.bus.network.lost_tokens import TokenRepair
from crazychoir.bus.network.peers import OnRefused, OnToken, Peer, Peers
from crazychoir.bus.port import PORT_ADDRESSES, Bus
from crazychoir.bus.topics import (
    ALL_TOPICS,
    DRONE_TOPICS,
    MESSAGE_TOPICS,
    MessageClass,
    Topic,
)
from crazychoir.errors import CodecError, ConfigError
from crazychoir.runtime.actor import Actor
from crazychoir.runtime.clock import NS_PER_SECOND

log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class ZenohSession:
    """How the session with Zenoh runs and ends."""

    close_deadline: float = 1.5
    """s: time to close the session; shorter than the time that a supervisor grants."""
    close_thread: str = "zenoh close"
    """Name of the thread in which a session may be left behind, see launch/process/ending.py.
    """
    runtime: str = "(rx: (worker_threads: 64))"
    """Zenoh's receiving threads.

    If a process vanishes, for example by a cut cable, Zenoh closes its connection in one of these
    threads. The thread then waits up to 10 s for the network (SO_LINGER; zenoh issues 1101, 2718). If
    no thread is left, no message is received.
    """
    kept_tokens: int = 8
    """Additional tokens of this process that are kept, the newest."""


ZENOH_SESSION = ZenohSession()


@dataclass(frozen=True, slots=True)
class HelloTiming:
    """How often a process describes itself, and checks its connections."""

    settling_time: int = 5
    """Seconds for which a changed HELLO is repeated every second.

    It is also the time between later repeats.
    """
    asking_rate: int = 4
    """HELLOs a second to a peer until HELLO has gone both ways."""
    check_period: int = 2
    """Seconds between checks of the connections."""


HELLO_TIMING = HelloTiming()


OPEN_NETWORK_WARNING = (
    "the network is neither encrypted nor closed (security.insecure): "
    "every host on it can read and command"
)
"""Warning for a network that is neither encrypted nor closed."""
_CLASS_PRIORITIES = {
    MessageClass.ESTOP: zenoh.Priority.REAL_TIME,
    MessageClass.CONTROL: zenoh.Priority.INTERACTIVE_HIGH,
    MessageClass.ROUNDS: zenoh.Priority.DATA_HIGH,
    MessageClass.RELIABLE: zenoh.Priority.DATA,
    MessageClass.BULK: zenoh.Priority.DATA_LOW,
}
"""Zenoh's priority of each class."""


@dataclass(slots=True, eq=False)
class PeerQueue:
    """The messages of one class on their way to one peer."""

    buffer: FrameBuffer
    """Messages for the next frame."""
    publisher: zenoh.Publisher
    """Zenoh's publisher of the frames."""
    process: str
    """Name of the peer."""


class ZenohLink(Actor):
    """This process on the network; the `Forwarder` of its bus.

    listen: endpoints at which to listen
    connect: endpoints to which to connect
    routers: endpoint of a router that passes all messages on, instead of `listen` and `connect`
    incarnation: 64 random bits, drawn when this process started
    version: version of crazychoir
    lease: seconds without a sign of a host before its tokens disappear
    access: rules for hosts; None if every host may do everything
    agreed: digests of keys of the swarm file, see Hello
    settings: more settings of Zenoh, by path
    on_token: called when the token of a process appears or disappears
    on_refused: called when another process had one of our drones first
    Raises ConfigError for a malformed endpoint.
    """

    name = "zenoh"

    def __init__(
        self,
        bus: Bus,
        swarm: str,
        *,
        listen: list[str],
        connect: list[str],
        incarnation: int,
        version: str,
        lease: float = 1.0,
        routers: list[str] | None = None,
        access: NetworkAccess | None = None,
        agreed: Mapping[str, str] | None = None,
        settings: Mapping[str, Any] | None = None,
        on_token: OnToken = lambda drones, there: None,
        on_refused: OnRefused = lambda refused: None,
    ) -> None:
        self.bus = bus
        self._keys = LinkKeys(swarm, bus.host, bus.process)
        self.access = access
        self.listen, self.connect = ([], routers) if routers else (listen, connect)
        self.counters = LinkCounters()
        own = Introduction(swarm, incarnation, version, dict(agreed or {}))
        identity = LocalIdentity(swarm, bus.process, incarnation)
        self.table = Peers(bus, own, access, on_token, on_refused)
        self.local = LocalSockets(identity, self.table.may_connect, bus.clock.now_ns)
        self._arrivals = ArrivalQueue(self.counters, bus.clock.now_ns)
        self._receive_local = partial(self._arrivals.take, self._local_frame)
        self.peers = self.table.by_name
        self.directory = self.table.directory
        secured = access.settings() if access is not None else {}
        mode = "client" if routers else "peer"
        reach = endpoints.zenoh_settings(self.listen, self.connect, lease, mode)
        self._config = _zenoh_config({**reach, **secured, **(settings or {})})
        self._loop = asyncio.get_running_loop()
        self._now_ns = bus.clock.now_ns
        self._budgets = FrameBudgets()
        self._token_budgets = FrameBudgets()
        self._flushing = False
        self._full: list[PeerQueue] = []
        self._after: deque[Callable[[], None]] = deque()
        self._to_greet: dict[str, None] = {}
        self._estranged = TokenRepair()
        self._connections = ForeignConnections()
        self._tokens: deque[Any] = deque()
        self._declared: list[Any] = []
        self._audiences: dict[str, zenoh.Publisher] = {}
        """By public topic: knows whether another program reads its keys."""
        self._session: zenoh.Session | None = None

    # Opening and closing --------------------------------------------------------------

    def open(self) -> None:
        """Listen, connect, subscribe, and only then declare the token.

        Raises ConfigError if the session cannot be opened, for example for a busy endpoint.
        """
        os.environ.setdefault("ZENOH_RUNTIME", ZENOH_SESSION.runtime)
        _report_handshakes(self.access)
        if self.access is None and not endpoints.are_local(self.listen + self.connect):
            log.warning("%s", OPEN_NETWORK_WARNING)
        try:
            session = zenoh.open(self._config)
        except zenoh.ZError as error:
            raise endpoints.opening_error(
                self.listen, self.connect, str(error)
            ) from error
        self._session = session
        self.local.open(self._receive_local)
        self.table.own = replace(self.table.own, local=self.local.address)
        received = zenoh.handlers.Callback(self._received, indirect=True)
        tokens = zenoh.handlers.Callback(self._token, indirect=True)
        self._declared = [
            session.declare_subscriber(self._keys.arriving_frames, received),
            session.liveliness().declare_subscriber(
                self._keys.all_tokens, tokens, history=True
            ),
            session.liveliness().declare_token(self._keys.own_token),
        ]
        self._audiences = {
            topic.name: session.declare_publisher(self._keys.public("*", topic.name))
            for topic in ALL_TOPICS
            if topic.public > 0
        }
        self.bus.forwarder = self

    async def run(self) -> None:
        """Repeat HELLO, and ask other hosts for their clocks.

        HELLO is sent often to peers that have not received ours, or sent theirs, and seldom when
        all are known.
        """
        tick = 0
        async for _ in self.bus.clock.ticks(
            HELLO_TIMING.asking_rate * MESSAGE_TOPICS.hello.rate
        ):
            tick += 1
            self.table.offer_new_ports()
            _, age = self.table.hello()
            due = (
                tick % HELLO_TIMING.asking_rate == 0
                and age < HELLO_TIMING.settling_time
            )
            if (
                due
                or age == 0.0
                or tick % (HELLO_TIMING.settling_time * HELLO_TIMING.asking_rate) == 0
            ):
                self.greet()
            for peer in self.peers.values():
                if not peer.refusal and not self.table.mutual(peer):
                    self._greet(peer)
            self._greet_estranged(gone_too=tick % HELLO_TIMING.asking_rate == 0)
            if tick % HELLO_TIMING.asking_rate == 0:
                self._ask_clocks()
            if tick % (HELLO_TIMING.check_period * HELLO_TIMING.asking_rate) == 0:
                self._look_who_is_connected()

    async def on_stop(self) -> None:
        """Send the waiting messages and close the session in a
        thread, because closing may take long.
        """
        self._flush()
        self.local.close()
        session = self._session
        self._session = None
        if session is None:
            return
        closed = asyncio.Event()
        threading.Thread(
            target=self._close,
            args=(session, closed),
            name=ZENOH_SESSION.close_thread,
            daemon=True,
        ).start()
        try:
            async with asyncio.timeout(ZENOH_SESSION.close_deadline):
                await closed.wait()
        except TimeoutError:
            log.warning(
                "the Zenoh session does not close within %g s; left behind",
                ZENOH_SESSION.close_deadline,
            )

    def _close(self, session: zenoh.Session, closed: asyncio.Event) -> None:
        try:
            for declared in reversed(
                [*self._declared, *self._audiences.values(), *self._tokens]
            ):
                declared.undeclare()
            session.close()
        except zenoh.ZError as error:
            log.warning("while the Zenoh session closed: %s", error)
        finally:
            self._arrivals.call_on_loop(closed.set)

    # Sending --------------------------------------------------------------------------

    def forward(
        self,
        topic: Topic,
        source: int,
        to: list[int],
        payload: bytes,
        number: int,
        channel: str,
        flags: int,
        age: float,
    ) -> None:
        """Add a message to the frame of each process that holds an address of `to`.

        Frames are sent at the end of this pass of the event loop.
        """
        directory = self.directory
        groups: dict[Peer | None, list[int]] = {}
        if len(to) == 1:
            groups[directory.get(to[0])] = to
        else:
            for j in to:
                groups.setdefault(directory.get(j), []).append(j)
        for peer, there in groups.items():
            if peer is None:
                self.bus.unroutable += len(there)
                continue
            for k in range(0, len(there), FRAME_FORMAT.max_destinations):
                some = tuple(there[k : k + FRAME_FORMAT.max_destinations])
                message = Envelope(
                    topic.number,
                    source,
                    some,
                    number,
                    flags,
                    max(0.0, age),
                    channel,
                    payload,
                )
                self._add(peer, topic.klass, message)

    def then(self, work: Callable[[], None]) -> None:
        """Call `work` after the puts at the end of this loop pass, so
        that other processes need not wait for it.
        """
        self._after.append(work)
        self._schedule_flush()

    def interested(self) -> None:
        """Send HELLO to all peers because our interests changed."""
        self.greet()

    def greet(self) -> None:
        """Send HELLO to every peer at the end of this loop pass."""
        self._to_greet.update(dict.fromkeys(self.peers))
        self._schedule_flush()

    def _greet(self, peer: Peer) -> None:
        self._to_greet[peer.process] = None
        self._schedule_flush()

    def _ask_clocks(self) -> None:
        self.bus.offsets = self.table.offsets()
        for peer in self.table.on_other_hosts:
            self._say_time(peer, peer.offset.ask(self._now_ns()))

    def _look_who_is_connected(self) -> None:
        """Warn about programs that connect with the certificate
        of a host and are not in the swarm.
        """
        session = self._session
        if session is None or self.access is None or self.access.router is not None:
            return  # through a router there are connections of all hosts
        links = [(link.auth_identifier, str(link.zid)) for link in session.info.links()]
        for host in self._connections.look(
            links, (peer.host for peer in self.peers.values())
        ):
            log.warning(
                "a program with the certificate of host %s is connected and is no process of this swarm: nothing of "
                "it is believed but what that host may say",
                host,
            )

    def _say_time(self, peer: Peer, payload: bytes) -> None:
        self._add(
            peer,
            MESSAGE_TOPICS.clock.klass,
            Envelope(MESSAGE_TOPICS.clock.number, 0, (), 0, 0, 0.0, "", payload),
        )

    def _greet_estranged(self, gone_too: bool) -> None:
        """Send HELLO to processes without a token, without the lanes of a peer."""
        session = self._session
        processes = self._estranged.due(gone_too)
        if session is None or not processes:
            return
        payload, age = self.table.hello()
        hello = Envelope(MESSAGE_TOPICS.hello.number, 0, (), 0, 0, age, "", payload)
        frame = encode_frame(
            Frame(
                self.bus.process,
                self.table.own.incarnation,
                MESSAGE_TOPICS.hello.klass,
                [hello],
            )
        )
        drop = zenoh.CongestionControl.DROP
        priority = _CLASS_PRIORITIES[MESSAGE_TOPICS.hello.klass]
        for process in processes:
            key = self._keys.frame_to(process, MESSAGE_TOPICS.hello.klass)
            self._put(
                partial(session.put, key, congestion_control=drop, priority=priority),
                frame,
            )

    def _declare_another_token(self, process: str) -> None:
        """Declare one more token because `process` does not see ours.

        Drop the oldest additional one.
        """
        session = self._session
        if session is None:
            return
        self.counters.tokens += 1
        key = f"{self._keys.own_token}/{self.counters.tokens}"
        log.info("%s hears us and has no token of ours: one more", process)
        try:
            self._tokens.append(session.liveliness().declare_token(key))
            if len(self._tokens) > ZENOH_SESSION.kept_tokens:
                self._tokens.popleft().undeclare()
        except zenoh.ZError as error:
            log.warning("a liveliness token could not be declared: %s", error)

    def _add(self, peer: Peer, klass: MessageClass, message: Envelope) -> None:
        """Add a message to the next frame for a peer and a class."""
        session = self._session
        if session is None:
            self.counters.dropped += 1
            return
        lane = peer.lanes.get(klass) or self._lane(session, peer, klass)
        if not lane.buffer:
            self._full.append(lane)
        try:
            lane.buffer.add(message)
        except CodecError as error:
            self.counters.unsendable += 1
            log.warning("not sent: %s", error)
            return
        self._schedule_flush()

    def _lane(
        self, session: zenoh.Session, peer: Peer, klass: MessageClass
    ) -> PeerQueue:
        """Open the lane of a class to a peer."""
        publisher = session.declare_publisher(
            self._keys.frame_to(peer.process, klass),
            congestion_control=zenoh.CongestionControl.DROP,
            priority=_CLASS_PRIORITIES[klass],
            reliability=zenoh.Reliability.RELIABLE,
        )
        name = self.bus.process
        number = self.table.own.incarnation
        conflate = klass is MessageClass.CONTROL
        buffer = FrameBuffer(name, number, klass, conflate)
        lane = peer.lanes[klass] = PeerQueue(buffer, publisher, peer.process)
        return lane

    def _schedule_flush(self) -> None:
        if not self._flushing:
            self._flushing = True
            self._loop.call_soon(self._flush)

    def _flush(self) -> None:
        """Send all frames at the end of a pass of the event loop,
        then run the work that waits for that.
        """
        if self._to_greet:
            self._say_hello()
        self._flushing = False
        full = self._full
        self._full = []
        for lane in full:
            try:
                frames = lane.buffer.take()
            except CodecError as error:
                self.counters.unsendable += 1
                log.warning("not sent: %s", error)
                continue
            for frame in frames:
                if self.local.is_connected(lane.process):
                    self._send_local(lane.process, frame)
                else:
                    self._put(lane.publisher.put, frame)
        for _ in range(len(self._after)):
            self._after.popleft()()

    def _send_local(self, process: str, frame: bytes) -> None:
        """Send a frame through the socket to a process of this host."""
        if self.local.send(process, frame):
            self.counters.frames_sent += 1
            self.counters.bytes_sent += len(frame)
        else:
            self.counters.full += 1

    def _say_hello(self) -> None:
        names = self._to_greet
        self._to_greet = {}
        payload, age = self.table.hello()
        hello = Envelope(MESSAGE_TOPICS.hello.number, 0, (), 0, 0, age, "", payload)
        for name in names:
            if name in self.peers:
                self._add(self.peers[name], MESSAGE_TOPICS.hello.klass, hello)

    def _put(self, put: Callable[[bytes], None], frame: bytes) -> None:
        """Send a frame, and measure how long the put takes."""
        counters = self.counters
        began_ns = self._now_ns()
        try:
            put(frame)
        except zenoh.ZError:
            counters.put_errors += 1
            return
        counters.worst_put_s = max(
            counters.worst_put_s, (self._now_ns() - began_ns) / NS_PER_SECOND
        )
        counters.frames_sent += 1
        counters.bytes_sent += len(frame)

    def has_audience(self, topic: str) -> bool:
        """Return whether another program reads the public copy of this topic of some drone."""
        publisher = self._audiences.get(topic)
        # zenoh's type stubs call this status a bool.
        status: Any = None if publisher is None else publisher.matching_status
        return status is not None and bool(status.matching)

    def announce(self, drone: int, topic: str, text: bytes) -> None:
        """Put a JSON text under the drone's public key, for other Zenoh programs."""
        if self._session is not None:
            key = self._keys.public(drone, topic)
            self._session.put(key, text, encoding=zenoh.Encoding.APPLICATION_JSON)

    def alarm(self, drone: int, text: str) -> None:
        """Send a log line to all readers of the drone's log, and a public copy.

        May be called from any thread, also while the event loop hangs.
        """
        session = self._session
        if session is None:
            return
        session.put(self._keys.public(drone, "alarm"), text)
        for peer in list(self.peers.values()):
            readers = _readers_at_peer(peer, DRONE_TOPICS.log, drone)
            if readers:
                line = Envelope(
                    DRONE_TOPICS.log.number, drone, readers, 0, 0, 0.0, "", encode(text)
                )
                frame = encode_frame(
                    Frame(
                        self.bus.process,
                        self.table.own.incarnation,
                        DRONE_TOPICS.log.klass,
                        [line],
                    )
                )
                session.put(
                    self._keys.frame_to(peer.process, DRONE_TOPICS.log.klass), frame
                )

    # Receiving ------------------------------------------------------------------------

    def _received(self, sample: zenoh.Sample) -> None:
        """Take a frame in Zenoh's thread: add it to the queue, without blocking."""
        key = str(sample.key_expr)
        host, _ = read_sender(key)
        budget = self._budgets.of(host, now := self._now_ns())
        if budget.take(now, len(sample.payload)):
            self._arrivals.add(self._frame, key, sample.payload.to_bytes())
        else:
            self._flooded(budget, host)

    def _token(self, sample: zenoh.Sample) -> None:
        """Take a change of a token in Zenoh's other thread."""
        there = sample.kind == zenoh.SampleKind.PUT
        key = str(sample.key_expr)
        host, _ = read_token(key)
        budget = self._token_budgets.of(host, now := self._now_ns())
        if budget.take(now):
            handler = self._token_came if there else self._token_went
            self._arrivals.add(handler, key, b"")
        else:
            self._flooded(budget, host)

    def _flooded(self, budget: FrameBudget, host: str) -> None:
        """Count a frame that is not read, and log the host once."""
        self.counters.flooded += 1
        if not budget.said:
            budget.said = True
            self._arrivals.call_on_loop(
                partial(
                    log.warning,
                    "host %s floods us: of what it says beyond that nothing is read",
                    host,
                )
            )

    def _token_came(self, key: str, data: bytes, arrived_ns: int) -> None:
        host, process = read_token(key)
        self._estranged.came(process)
        peer = self.table.came(host, process, key)
        if peer is not None:
            self._greet(peer)

    def _token_went(self, key: str, data: bytes, arrived_ns: int) -> None:
        host, process = read_token(key)
        peer = self.table.went(host, process, key)
        if peer is None:
            return
        self._estranged.went(process)
        self.local.forget(process)
        for lane in peer.lanes.values():
            self.counters.dropped += len(lane.buffer)
            lane.buffer.take()
            lane.publisher.undeclare()

    def _frame(self, key: str, data: bytes, arrived_ns: int) -> None:
        """Decode a frame, find its peer, and deliver its messages."""
        counters = self.counters
        try:
            frame = decode_frame(data)
        except FrameVersionError:
            counters.other_version += 1
            return
        except CodecError:
            counters.malformed += 1
            return
        peer = self._sender(key, frame)
        if peer is None:
            counters.strangers += 1
            self._stranger(key, frame)
            return
        counters.frames_received += 1
        self._distribute(peer, frame.envelopes, arrived_ns)

    def _local_frame(self, process: str, data: bytes, sent_ns: int) -> None:
        """Take a frame that came through a socket.

        sent_ns: ns, time of sending by the clock of this machine
        """
        peer = self.peers.get(process)
        if peer is None:
            self.counters.strangers += 1
            return
        now_ns = self._now_ns()
        if not peer.budget.take(now_ns, len(data)):
            self._flooded(peer.budget, f"{peer.host} (process {process})")
            return
        try:
            frame = decode_frame(data)
        except FrameVersionError:
            self.counters.other_version += 1
            return
        except CodecError:
            self.counters.malformed += 1
            return
        if frame.process != process:
            self.counters.strangers += 1
            return
        self.counters.frames_received += 1
        self._distribute(peer, frame.envelopes, min(sent_ns, now_ns))

    def _sender(self, key: str, frame: Frame) -> Peer | None:
        """Return the peer that sent a frame.

        Its key, its token and its content must agree, since certificates protect only keys.
        """
        host, process = read_sender(key)
        peer = self.peers.get(process)
        return (
            peer
            if peer is not None and peer.host == host and frame.process == process
            else None
        )

    def _stranger(self, key: str, frame: Frame) -> None:
        """Handle a frame of a process without a token.

        The process gets an answer, unless its name is forged, known, our own, or invalid.
        """
        host, process = read_sender(key)
        known = process == self.bus.process or process in self.peers
        if known or process != frame.process or not self.table.may_be(host, process):
            return
        self._estranged.heard(process)
        for message in frame.envelopes:
            if message.topic == MESSAGE_TOPICS.hello.number:
                self._greeted_by_stranger(host, process, message.payload)

    def _greeted_by_stranger(self, host: str, process: str, payload: bytes) -> None:
        try:
            hello = Hello.of(payload)
        except CodecError:
            self.counters.malformed += 1
            return
        if (hello.host, hello.process) == (host, process):
            self._heard_of_us(process, self.bus.process in hello.heard)

    def _heard_of_us(self, process: str, knows_us: bool) -> None:
        if self._estranged.greeted(process, knows_us):
            self._declare_another_token(process)

    def _distribute(
        self, peer: Peer, messages: list[Envelope], arrived_ns: int
    ) -> None:
        """Deliver the messages of a peer that it may send to the ports of this process."""
        directory = self.directory
        ports = self.bus.ports
        waited = (self._now_ns() - arrived_ns) / NS_PER_SECOND
        for message in messages:
            if message.topic == MESSAGE_TOPICS.hello.number:
                self._greeted(peer, message.payload, message.age + waited)
            elif message.topic == MESSAGE_TOPICS.clock.number:
                self._asked(peer, message.payload, arrived_ns)
            elif directory.get(message.source) is not peer:
                self.counters.strangers += 1
            elif self.access is not None and not self.access.may_say(
                peer.host, message
            ):
                self._forbid(peer)
            else:
                age = message.age + waited
                for j in (
                    message.to if len(message.to) == 1 else dict.fromkeys(message.to)
                ):
                    port = ports.get(j)
                    if port is not None:
                        port.deliver(
                            message.topic,
                            message.source,
                            message.payload,
                            message.number,
                            message.channel,
                            message.flags,
                            age,
                        )

    def _forbid(self, peer: Peer) -> None:
        """Count a command that is not executed, and log the process once."""
        self.counters.forbidden += 1
        if not peer.forbidden:
            peer.forbidden = True
            log.warning(
                "host %s (process %s) commands and is no operator: not obeyed",
                peer.host,
                peer.process,
            )

    def _asked(self, peer: Peer, payload: bytes, arrived_ns: int) -> None:
        """Handle a question for our clock, or the answer to ours, from a peer with a HELLO."""
        if peer.hello is None:
            return
        try:
            answer = peer.offset.hear(payload, arrived_ns, self._now_ns())
        except CodecError:
            self.counters.malformed += 1
            return
        if answer is not None:
            self._say_time(peer, answer)

    def _greeted(self, peer: Peer, payload: bytes, age: float) -> None:
        try:
            if self.table.greeted(peer, payload, age):
                self._greet(peer)
        except CodecError:
            self.counters.malformed += 1
            return
        if not peer.refusal:
            is_mutual = self.table.mutual(peer)
            self._heard_of_us(peer.process, is_mutual)
            is_here = peer.host == self.bus.host
            if is_mutual and is_here and peer.hello is not None:
                self.local.reach(peer.process, peer.hello.local)


@contextlib.contextmanager
def route_messages(
    listen: list[str], lease: float, access: NetworkAccess | None
) -> Iterator[None]:
    """Pass on the messages between the processes of a swarm, while its `with` lasts.

    lease: seconds without a sign of a host before its tokens disappear
    Raises ConfigError if the session cannot be opened.
    """
    os.environ.setdefault("ZENOH_RUNTIME", ZENOH_SESSION.runtime)
    _report_handshakes(access)
    if access is None and not endpoints.are_local(listen):
        log.warning("%s", OPEN_NETWORK_WARNING)
    secured = access.settings() if access is not None else {}
    try:
        session = zenoh.open(
            _zenoh_config({**endpoints.router_settings(listen, lease), **secured})
        )
    except zenoh.ZError as error:
        raise endpoints.opening_error(listen, [], str(error)) from error
    try:
        yield
    finally:
        session.close()


def _report_handshakes(access: NetworkAccess | None) -> None:
    if access is not None and handshakes.is_reading_output():
        zenoh.init_log_from_env_or(handshakes.ZENOH_LOG_READING.log_levels)


class OutsideSession:
    """A session with programs outside of a swarm, at an endpoint, while its `with` lasts.

    Raises ConfigError if the session cannot be opened.
    """

    def __init__(self, connect: str) -> None:
        os.environ.setdefault("ZENOH_RUNTIME", ZENOH_SESSION.runtime)
        try:
            self._session = zenoh.open(
                _zenoh_config(endpoints.zenoh_settings([], [connect], 1.0))
            )
        except zenoh.ZError as error:
            raise endpoints.opening_error([], [connect], str(error)) from error
        self._declared: list[Any] = []

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        for declared in reversed(self._declared):
            declared.undeclare()
        self._session.close()

    @property
    def id(self) -> str:
        """Id of the session, hexadecimal without leading zeros."""
        return str(self._session.info.zid()).lstrip("0")

    def token(self, key: str) -> None:
        """Declare a liveliness token until the end of the session."""
        self._declared.append(self._session.liveliness().declare_token(key))

    def put(self, key: str, data: bytes, attachment: bytes) -> None:
        """Send data to all subscribers of a key; it is dropped if they are too slow."""
        drop = zenoh.CongestionControl.DROP
        self._session.put(key, data, attachment=attachment, congestion_control=drop)


def _zenoh_config(settings: Mapping[str, Any]) -> zenoh.Config:
    config = zenoh.Config()
    for key, value in settings.items():
        try:
            config.insert_json5(key, json.dumps(value))
        except zenoh.ZError as error:
            raise ConfigError(
                f"Zenoh setting {key}", value, str(error).split(" at /", 1)[0]
            ) from error
    return config


def _readers_at_peer(peer: Peer, topic: Topic, drone: int) -> tuple[int, ...]:
    wants = peer.hello.wants() if peer.hello is not None else []
    return tuple(
        one.reader
        for one in wants
        if one.topic == topic.name and one.source in (PORT_ADDRESSES.any_drone, drone)
    )
