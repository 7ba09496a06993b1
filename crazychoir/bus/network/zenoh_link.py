"""The link to other processes: one Zenoh session, one wildcard
subscriber, one put for each (peer process, class, loop pass).

    bus ──> ZenohLink.forward ──> FrameOutbox ──> LocalSockets ──> other process of this host
                                             └──> ZenohSession ──> process of another host
    bus <── FrameInbox <── LocalSockets, ZenohSession
             └──> Greeter    HELLO, tokens, clocks

The keys are in link_keys.py.
"""

from collections.abc import Callable
from dataclasses import replace

from crazychoir.bus.codec import encode
from crazychoir.bus.frames import FRAME_FORMAT, Envelope
from crazychoir.bus.message import Message
from crazychoir.bus.network.access import NetworkAccess
from crazychoir.bus.network.frame_inbox import FrameInbox
from crazychoir.bus.network.frame_outbox import FrameOutbox
from crazychoir.bus.network.greeter import Greeter
from crazychoir.bus.network.hello_review import Introduction
from crazychoir.bus.network.link_counters import LinkCounters
from crazychoir.bus.network.link_keys import LinkKeys
from crazychoir.bus.network.local_address import LocalIdentity
from crazychoir.bus.network.local_sockets import LocalSockets
from crazychoir.bus.network.peers import OnRefused, OnToken, Peer, Peers
from crazychoir.bus.network.zenoh_session import SessionEndpoints, ZenohSession
from crazychoir.bus.port import PORT_ADDRESSES, Bus
from crazychoir.bus.topics import DRONE_TOPICS, Topic
from crazychoir.runtime.actor import Actor


class ZenohLink(Actor):
    """This process on the network; the `Forwarder` of its bus.

    bus: bus of this process
    own: how this process introduces itself
    reach: endpoints of this process
    access: rules for hosts; None if every host may do everything
    on_token: called when the token of a process appears or disappears
    on_refused: called when another process had one of our drones first
    Raises ConfigError for a malformed endpoint, and for a name that cannot be part of a key.

    Attributes:
    peers: {name of the process: peer}
    directory: {address: peer that holds it}
    """

    name = "zenoh"

    def __init__(
        self,
        bus: Bus,
        own: Introduction,
        reach: SessionEndpoints,
        *,
        access: NetworkAccess | None = None,
        on_token: OnToken = lambda drones, there: None,
        on_refused: OnRefused = lambda refused: None,
    ) -> None:
        now_ns = bus.clock.now_ns
        counters = LinkCounters()
        keys = LinkKeys(own.swarm, bus.host, bus.process)
        identity = LocalIdentity(own.swarm, bus.process, own.incarnation)
        self.bus = bus
        self.counters = counters
        self.table = Peers(bus, own, access, on_token, on_refused)
        self.peers = self.table.by_name
        self.directory = self.table.directory
        self.session = ZenohSession(keys, reach, access, counters, now_ns)
        self.sockets = LocalSockets(identity, self.table.may_connect, counters, now_ns)
        self.outbox = FrameOutbox(self.session, self.sockets, own.incarnation, counters)
        self.greeter = Greeter(
            bus, self.table, self.session, self.outbox, self.sockets, counters
        )
        self.inbox = FrameInbox(bus, self.table, self.greeter, counters)

    def open(self) -> None:
        """Listen, connect, and take the messages of the bus for other processes.

        Raises ConfigError if the session cannot be opened, for example for a busy endpoint.
        """
        self.session.open(self.inbox.receive, self.inbox.receive_token)
        self.sockets.open(self.inbox.receive_local)
        self.table.own = replace(self.table.own, local=self.sockets.address)
        self.bus.forwarder = self

    async def run(self) -> None:
        """Keep this process known to the others."""
        await self.greeter.run()

    async def on_stop(self) -> None:
        """Send the waiting messages, and close all connections."""
        self.outbox.flush()
        self.sockets.close()
        await self.session.close()

    def forward(self, message: Message, to: list[int], age: float) -> None:
        """Add a message to the frame of each process that holds an address of `to`.

        Frames are sent at the end of this pass of the event loop.
        """
        topic = message.topic
        age = max(0.0, age)
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
                envelope = Envelope(
                    topic.number,
                    message.source,
                    some,
                    message.number,
                    message.flags,
                    age,
                    message.channel,
                    message.payload,
                )
                self.outbox.add(peer, topic.klass, envelope)

    def then(self, work: Callable[[], None]) -> None:
        """Call `work` after the puts at the end of this loop pass, so
        that other processes need not wait for it.
        """
        self.outbox.call_after_flush(work)

    def interested(self) -> None:
        """Send HELLO to all peers because our interests changed."""
        self.greeter.greet_all()

    def alarm(self, drone: int, text: str) -> None:
        """Send a log line to all readers of the drone's log, and a public copy.

        May be called from any thread, also while the event loop hangs.
        """
        session = self.session
        if not session.is_open:
            return
        session.put(session.keys.public(drone, "alarm"), text)
        log_topic = DRONE_TOPICS.log
        for peer in list(self.peers.values()):
            readers = _readers_at_peer(peer, log_topic, drone)
            if readers:
                line = Envelope(
                    log_topic.number, drone, readers, 0, 0, 0.0, "", encode(text)
                )
                session.put(
                    session.keys.frame_to(peer.process, log_topic.klass),
                    self.outbox.encode(log_topic.klass, line),
                )


def _readers_at_peer(peer: Peer, topic: Topic, drone: int) -> tuple[int, ...]:
    wants = peer.hello.wants() if peer.hello is not None else []
    return tuple(
        one.reader
        for one in wants
        if one.topic == topic.name and one.source in (PORT_ADDRESSES.any_drone, drone)
    )
