"""The other processes: their tokens, their HELLOs, and the process that holds each address.

The module only handles keys, tokens and bytes; it acts through its callbacks. A HELLO counts only
from a process with a token.
"""

import logging
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from msgspec.structs import replace

from crazychoir.bus.clock_offset import ClockOffset, OffsetEstimate
from crazychoir.bus.control_numbers import ControlNumbers
from crazychoir.bus.network.access import NetworkAccess
from crazychoir.bus.network.endpoints import is_name
from crazychoir.bus.network.flood_limit import FrameBudget
from crazychoir.bus.network.hello import Hello
from crazychoir.bus.network.hello_review import (
    HelloReview,
    Introduction,
    describe_address,
)
from crazychoir.bus.network.local_address import LocalIdentity
from crazychoir.bus.port import PORT_ADDRESSES, Bus
from crazychoir.bus.topics import MessageClass
from crazychoir.errors import CodecError, Refused
from crazychoir.runtime.clock import NS_PER_SECOND

log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class PeerLimits:
    """Limits of the other processes that this process knows."""

    max_peers: int = 512
    """Most peers."""
    max_tokens: int = 16
    """Most tokens of a peer."""
    new_process_time: float = 10.0
    """s after its start in which a process ends if another one refuses it."""


PEER_LIMITS = PeerLimits()


OnToken = Callable[[list[int], bool], None]
"""Callable for the drones of a process.

It gets (drones, True) when the token of the process exists and its HELLO has arrived, and (drones,
False) when the token has disappeared.
"""
OnRefused = Callable[[Refused], None]
"""Callable for the case that another process had one of our drones first."""


@dataclass(slots=True, eq=False)
class Peer:
    """Another process with a liveliness token; without `hello` no messages go to it."""

    process: str
    """Name of the process."""
    host: str
    """Name of its host."""
    tokens: set[str]
    """Keys of its tokens."""
    hello: Hello | None = None
    """Its last accepted HELLO."""
    since_ns: int = 0
    """ns, our clock: start of the process."""
    said: bytes | None = None
    """Its last HELLO as received."""
    told: bytes = b""
    """Our last HELLO that went to it through a socket."""
    asked: int = 0
    """Number of times that a HELLO from it was missing, of those when HELLO is sent."""
    refusal: str = ""
    """Reason why its HELLO was refused; empty if it was not."""
    forbidden: bool = False
    """True if a forbidden command of it was logged."""
    offset: ClockOffset = field(default_factory=ClockOffset)
    """Offset of its clock."""
    queues: dict[MessageClass, Any] = field(default_factory=dict)
    """Queues of the outbox, by class."""
    control: ControlNumbers = field(default_factory=ControlNumbers)
    """The newest control messages that came through a socket."""
    budget: FrameBudget = field(default_factory=FrameBudget)
    """The frames that it may still send through a socket."""


@dataclass(frozen=True, slots=True)
class HelloPayloads:
    """Our HELLO as bytes, for each kind of receiver."""

    to_stranger: bytes
    """For a process without a token."""
    to_unheard: bytes
    """For a peer with a HELLO that has not arrived."""
    to_heard: bytes
    """For a peer with a HELLO that has arrived."""


class Peers:
    """The other processes by name, and the way to each address.

    bus: bus of this process
    own: how this process introduces itself
    access: rights of the hosts; None: every host may hold every address
    on_token: gets the drones of a process that has come or gone
    on_refused: gets the error that ends this process

    Attributes:
    by_name: {name of the process: peer}
    directory: {address: peer that holds it}
    """

    def __init__(
        self,
        bus: Bus,
        own: Introduction,
        access: NetworkAccess | None,
        on_token: OnToken,
        on_refused: OnRefused,
    ) -> None:
        self.bus = bus
        self.own = own
        self.access = access
        self._review = HelloReview(bus, own)
        self.on_token = on_token
        self.on_refused = on_refused
        self.by_name: dict[str, Peer] = {}
        self.directory: dict[int, Peer] = {}
        self._born = bus.clock.now()
        self._ports: list[int] = []
        self._offered: list[int] = []
        self._said: Hello | None = None
        self._told_to_all: Hello | None = None
        self._payloads = HelloPayloads(b"", b"", b"")

    def came(self, host: str, process: str, token: str) -> Peer | None:
        """Add a token and return the peer if it is new."""
        known = self.by_name.get(process)
        if (
            known is not None
            and known.host == host
            and len(known.tokens) < PEER_LIMITS.max_tokens
        ):
            known.tokens.add(token)
        if (
            known is not None
            or process == self.bus.process
            or not (self.may_be(host, process) and self._room(host))
        ):
            return None
        peer = self.by_name[process] = Peer(process, host, {token})
        return peer

    def may_be(self, host: str, process: str) -> bool:
        """Return True if the process name is valid, and its host may use it."""
        return is_name(process) and (
            self.access is None or self.access.may_be(host, process)
        )

    def may_connect(self, identity: LocalIdentity) -> bool:
        """Return True if a process that connects to our socket is a peer of this host."""
        peer = self.by_name.get(identity.process)
        return (
            peer is not None
            and peer.host == self.bus.host
            and not peer.refusal
            and peer.hello is not None
            and peer.hello.incarnation == identity.incarnation
        )

    def _room(self, host: str) -> bool:
        """Return True if there is room for one more process of a host."""
        there = sum(peer.host == host for peer in self.by_name.values())
        return len(self.by_name) < PEER_LIMITS.max_peers and (
            self.access is None or there < self.access.most(host)
        )

    def went(self, host: str, process: str, token: str) -> Peer | None:
        """Remove a token and return the peer if it was its last one.

        A drone that another process flies too stays.
        """
        peer = self.by_name.get(process)
        if peer is None or peer.host != host:
            return None
        peer.tokens.discard(token)
        if peer.tokens:
            return None
        del self.by_name[process]
        self._route()
        if peer.hello is not None:
            self.bus.drop_readers(
                [j for j in peer.hello.addresses if j not in self.directory]
            )
            self.on_token(
                [i for i in peer.hello.drones if i not in self.directory], False
            )
        return peer

    def mutual(self, peer: Peer) -> bool:
        """Return True if HELLO has gone both ways."""
        return peer.hello is not None and peer.hello.hears_receiver

    def hello_to(self, peer: Peer | None) -> bytes:
        """Return our HELLO for a peer, or for a process that is none."""
        self._refresh_hello()
        if peer is None:
            return self._payloads.to_stranger
        if peer.hello is None:
            return self._payloads.to_unheard
        return self._payloads.to_heard

    def hello_age(self) -> float:
        """Return the age of our HELLO in seconds."""
        return self._uptime() - self._refresh_hello().uptime

    def _refresh_hello(self) -> Hello:
        """Make our HELLO anew if it has changed, and return it."""
        self._ports = list(self.bus.ports)
        said = self._said
        if said is None or said != make_hello(self.bus, self.own, said.uptime):
            said = self._said = make_hello(self.bus, self.own, self._uptime())
            self._payloads = HelloPayloads(
                to_stranger=replace(said, lacks_token=True).payload(),
                to_unheard=said.payload(),
                to_heard=replace(said, hears_receiver=True).payload(),
            )
        return said

    def has_news(self) -> bool:
        """Return True if our HELLO has changed since the last call."""
        now = self._refresh_hello()
        is_new = now is not self._told_to_all
        self._told_to_all = now
        return is_new

    def greeted(self, peer: Peer, payload: bytes, age: float) -> bool:
        """Take a HELLO that is `age` seconds old, and return True if the peer needs ours.

        It needs ours to know that we have received its own.
        Raises CodecError for an invalid HELLO, or in the name of another process.
        """
        if payload == peer.said:
            return peer.hello is not None and not peer.refusal and not self.mutual(peer)
        hello = Hello.of(payload)
        if (hello.process, hello.host) != (peer.process, peer.host):
            raise CodecError(
                f"HELLO of {hello.process} on {hello.host}, sent by {peer.process} on {peer.host}"
            )
        if is_older(hello, peer.hello):
            return not hello.hears_receiver
        peer.said = payload
        uptime = hello.uptime + age
        peer.since_ns = peer.since_ns or self.bus.clock.now_ns() - round(
            uptime * NS_PER_SECOND
        )
        if self._forbids(peer, hello):
            return False
        refusal, do = self._review.find_refusal(hello, uptime)
        if refusal:
            return self._refuse(peer, hello, refusal, do, uptime)
        is_first = peer.hello is None
        self._take_in(peer, hello)
        return is_first or not self.mutual(peer)

    @property
    def on_other_hosts(self) -> list[Peer]:
        """Peers on other hosts, with other clocks, after HELLO has gone both ways."""
        return [
            peer
            for peer in self.by_name.values()
            if peer.host != self.bus.host and self.mutual(peer)
        ]

    def offsets(self) -> dict[str, OffsetEstimate]:
        """Return the clock offset of each other host, the best of all its processes."""
        now_ns = self.bus.clock.now_ns()
        best = dict[str, OffsetEstimate]()
        for peer in self.on_other_hosts:
            found = peer.offset.estimate(now_ns)
            if found is not None and (
                peer.host not in best or found.error < best[peer.host].error
            ):
                best[peer.host] = found
        return dict(sorted(best.items()))

    def _uptime(self) -> float:
        return self.bus.clock.now() - self._born

    def offer_new_ports(self) -> None:
        """Let ports that the peers know from HELLO serve the interests from before."""
        if self._ports == self._offered:
            return
        self._offered = self._ports
        for peer in self.by_name.values():
            if peer.hello is not None and self.mutual(peer):
                self._serve(peer, peer.hello)

    def _serve(self, peer: Peer, hello: Hello) -> None:
        self.bus.add_remote_interests(
            [one for one in hello.wants() if self._reads(peer, one.reader)]
        )

    def _reads(self, peer: Peer, address: int) -> bool:
        """Return True if a peer may read at an address: no other host holds it."""
        return (
            self.access is None or self.directory.get(address, peer).host == peer.host
        )

    def _forbids(self, peer: Peer, hello: Hello) -> bool:
        """Return True if a peer claims an address of another host, by the swarm file.

        Log it once.
        """
        others = [
            j
            for j in hello.addresses
            if self.access is not None and not self.access.may_hold(peer.host, j)
        ]
        if not others:
            return False
        speaker = f"process {hello.process} on host {hello.host}"
        what = describe_address(others[0])
        refusal = f"{speaker} speaks for {what}, which the swarm file does not give to that host"
        if not peer.refusal:
            log.warning("%s: it is refused", refusal)
        peer.refusal = refusal
        return True

    def _refuse(
        self, peer: Peer, hello: Hello, refusal: str, do: str, uptime: float
    ) -> bool:
        """Log a refusal once; return True the first time.

        Of two processes that exclude each other, the later one ends, if it is still new. A process
        that is no longer new may have a flying drone. Therefore a host that comes back, or claims a
        long uptime, cannot end a flight.
        """
        said = peer.refusal
        peer.refusal = refusal
        if said:
            return False
        new = self._uptime() < PEER_LIMITS.new_process_time
        if (
            new
            and hello.version == self.own.version
            and hello.precedes(self.bus.process, uptime - self._uptime())
        ):
            self.on_refused(Refused(f"swarm {self.own.swarm}", f"{refusal}. {do}"))
        else:
            log.warning("%s: it is refused", refusal)
        return True

    def _take_in(self, peer: Peer, hello: Hello) -> None:
        """Accept a HELLO: update the way to its addresses, and serve its interests."""
        was_mutual = self.mutual(peer)
        previous = peer.hello
        peer.hello = hello
        peer.refusal = ""
        if previous is None or previous.incarnation != hello.incarnation:
            peer.offset = ClockOffset()
        if previous is None:
            self.bus.stopped = self.bus.stopped or hello.stopped
        if previous is None or previous.addresses != hello.addresses:
            self._route()
        # Not before the peer knows us: it would drop a latched value as a stranger's.
        if self.mutual(peer) and not (
            was_mutual
            and previous is not None
            and previous.interests == hello.interests
        ):
            self.bus.drop_readers(
                [j for j in previous.addresses if self._reads(peer, j)]
                if previous
                else []
            )
            self._serve(peer, hello)
        if previous is None or previous.drones != hello.drones:
            self.on_token(hello.drones, True)

    def _route(self) -> None:
        """Find the process that holds each address.

        If several processes claim an address, an operator wins, then the process that is up for the
        longest time.
        """
        operators = self.access.operators if self.access is not None else ()
        self.directory.clear()
        for peer in sorted(
            self.by_name.values(),
            key=lambda peer: (peer.host not in operators, peer.since_ns),
        ):
            for address in peer.hello.addresses if peer.hello is not None else ():
                self.directory.setdefault(address, peer)


def is_older(hello: Hello, taken: Hello | None) -> bool:
    """Return whether a HELLO came late, after a newer one of the same process was taken.

    Of two HELLOs with the same uptime, the newer one says that ours has arrived. A process that
    lacks our token has lost us since, so its HELLO is never older.
    """
    if taken is None or hello.incarnation != taken.incarnation or hello.lacks_token:
        return False
    return (hello.uptime, hello.hears_receiver) < (taken.uptime, taken.hears_receiver)


def make_hello(bus: Bus, own: Introduction, uptime: float) -> Hello:
    """Return the HELLO of this process to a peer that it has not heard.

    bus: bus of this process
    own: how this process introduces itself
    uptime: s since it started
    """
    return Hello(
        process=bus.process,
        host=bus.host,
        incarnation=own.incarnation,
        version=own.version,
        uptime=uptime,
        drones=[i for i in bus.ports if i < PORT_ADDRESSES.first_observer],
        observers=[i for i in bus.ports if i >= PORT_ADDRESSES.first_observer],
        interests=list(bus.interests),
        # An observer does not learn that a stop is cleared, so it does not report one.
        stopped=bus.stopped and bool(bus.drones()),
        agreed=dict(own.agreed),
        local=own.local,
    )
