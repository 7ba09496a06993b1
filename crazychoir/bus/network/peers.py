"""The other processes: whose token is there, what they have said, and which of them holds which address.

Pure but for its callbacks: keys, tokens and bytes in. A HELLO counts only from a process of which a token is there.
"""

import logging
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Final

from crazychoir.bus.clock_offset import Estimate, Offset
from crazychoir.bus.network.access import Access
from crazychoir.bus.network.endpoints import is_name
from crazychoir.bus.network.hello import Hello
from crazychoir.bus.port import BODIES, EYES, OBSERVER, Bus
from crazychoir.bus.topics import Class
from crazychoir.errors import CodecError, Refused
from crazychoir.runtime.clock import SECOND

log = logging.getLogger(__name__)
MAX_PEERS = 512
MAX_TOKENS = 16
"""Of a peer."""

NEW: Final = 10.0
"""s that a process is up in which it ends if another one refuses it."""
COPY: Final = "Copy one file to every host, and start both again."

OnToken = Callable[[list[int], bool], None]
"""Called with the drones of a process whose token has gone (False), or is there and its HELLO has come (True)."""
OnRefused = Callable[[Refused], None]
"""Called when another process had one of our drones before us."""


@dataclass(slots=True, eq=False)
class Peer:
    """Another process, of which a liveliness token is there; without `hello` it is not yet, or not, talked to.

    tokens: their keys;  since_ns: when it began, by our clock;  said: its last HELLO as it came;  refusal: why it was
    not taken;  forbidden: whether it was said that it may not command;  offset: of its clock;  lanes: of the link.
    """

    process: str
    host: str
    tokens: set[str]
    hello: Hello | None = None
    since_ns: int = 0
    said: bytes | None = None
    refusal: str = ""
    forbidden: bool = False
    offset: Offset = field(default_factory=Offset)
    lanes: dict[Class, Any] = field(default_factory=dict)


class Peers:
    """What this process knows of the others, by name, and the way to each address."""

    def __init__(
        self,
        bus: Bus,
        swarm: str,
        incarnation: int,
        version: str,
        access: Access | None,
        on_token: OnToken,
        on_refused: OnRefused,
        agreed: Mapping[str, str] | None = None,
    ) -> None:
        self.bus = bus
        self.swarm = swarm
        self.incarnation = incarnation
        self.version = version
        self.access = access
        self.agreed = dict(agreed or {})
        self.on_token = on_token
        self.on_refused = on_refused
        self.by_name: dict[str, Peer] = {}
        self.directory: dict[int, Peer] = {}
        self._born = bus.clock.now()
        self._ports: list[int] = []
        self._offered: list[int] = []
        self._said: Hello | None = None
        self._payload = b""

    def came(self, host: str, process: str, token: str) -> Peer | None:
        """A token is there; returns the peer if it is new."""
        known = self.by_name.get(process)
        if known is not None and known.host == host and len(known.tokens) < MAX_TOKENS:
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
        """Whether it is a name, and one of its host's."""
        return is_name(process) and (
            self.access is None or self.access.may_be(host, process)
        )

    def _room(self, host: str) -> bool:
        """Whether there is room for one more process of a host."""
        there = sum(peer.host == host for peer in self.by_name.values())
        return len(self.by_name) < MAX_PEERS and (
            self.access is None or there < self.access.most(host)
        )

    def went(self, host: str, process: str, token: str) -> Peer | None:
        """A token has gone; returns the peer whose last one it was. A drone that another process flies is not gone."""
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
        """Whether HELLO has gone both ways."""
        return peer.hello is not None and self.bus.process in peer.hello.heard

    def hello(self) -> tuple[bytes, float]:
        """What we say of ourselves, and for how many s we have been saying so."""
        self._ports = list(self.bus.ports)
        uptime = self._uptime()
        said = self._said
        if said is None or said != self._hello(said.uptime):
            said = self._said = self._hello(uptime)
            self._payload = said.payload()
        return self._payload, uptime - said.uptime

    def _hello(self, uptime: float) -> Hello:
        return Hello(
            process=self.bus.process,
            host=self.bus.host,
            incarnation=self.incarnation,
            version=self.version,
            uptime=uptime,
            drones=[i for i in self._ports if i < OBSERVER],
            observers=[i for i in self._ports if i >= OBSERVER],
            interests=list(self.bus.interests),
            heard=[
                peer.process for peer in self.by_name.values() if peer.hello is not None
            ],
            stopped=self.bus.stopped
            and bool(self.bus.drones()),  # observers are not told when it is cleared
            agreed=self.agreed,
        )

    def greeted(self, peer: Peer, payload: bytes, age: float) -> bool:
        """A HELLO has come, `age` s old; returns whether the peer needs ours. Raises CodecError."""
        if payload == peer.said:
            return False
        hello = Hello.of(payload)
        if (hello.process, hello.host) != (peer.process, peer.host):
            raise CodecError(
                f"HELLO of {hello.process} on {hello.host}, sent by {peer.process} on {peer.host}"
            )
        peer.said = payload
        uptime = hello.uptime + age
        peer.since_ns = peer.since_ns or self.bus.clock.now_ns() - round(
            uptime * SECOND
        )
        if self._forbids(peer, hello):
            return False
        refusal, do = self._refusal(hello, uptime)
        if refusal:
            return self._refuse(peer, hello, refusal, do, uptime)
        self._take_in(peer, hello)
        return not self.mutual(peer)

    @property
    def on_other_hosts(self) -> list[Peer]:
        """Those whose clock is not ours, of whom HELLO has gone both ways."""
        return [
            peer
            for peer in self.by_name.values()
            if peer.host != self.bus.host and self.mutual(peer)
        ]

    def offsets(self) -> dict[str, Estimate]:
        """Of the clock of each other host, the best that any of its processes tells."""
        now_ns = self.bus.clock.now_ns()
        best = dict[str, Estimate]()
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
        """Let ports that the others have been told of serve what they asked for before."""
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
        """Whether an address that a peer claims reads what it asks for: not if it is another host's."""
        return (
            self.access is None or self.directory.get(address, peer).host == peer.host
        )

    def _forbids(self, peer: Peer, hello: Hello) -> bool:
        """Whether it claims what the swarm file gives to another host; said once."""
        others = [
            j
            for j in hello.addresses
            if self.access is not None and not self.access.may_hold(peer.host, j)
        ]
        if not others:
            return False
        who = f"process {hello.process} on host {hello.host}"
        what = _named(others[0])
        refusal = (
            f"{who} speaks for {what}, which the swarm file does not give to that host"
        )
        if not peer.refusal:
            log.warning("%s: it is refused", refusal)
        peer.refusal = refusal
        return True

    def _refusal(self, hello: Hello, uptime: float) -> tuple[str, str]:
        """Why a process that is up for so many s is refused, and what the user is to do; or two empty texts."""
        who = f"process {hello.process} on host {hello.host}"
        since = f"and has done so for {uptime:.1f} s"
        stop = (
            "Give this agent another --id, or stop that one."
            if self.bus.drones()
            else "Stop one of them."
        )
        doubles = ", ".join(str(i) for i in hello.drones if i in self.bus.ports)
        if doubles:
            return f"{who} flies drone(s) {doubles} too {since}", stop
        for base, owns in ((EYES, "the motion capture"), (BODIES, "the world")):
            same = ", ".join(
                str(j - base)
                for j in hello.observers
                if j >= base and j in self.bus.ports
            )
            if same:
                return f"{who} owns {owns} of drone(s) {same} too {since}", stop
        if hello.version != self.version:
            return (
                f"{who} runs version {hello.version}, this one runs {self.version}",
                "",
            )
        owner = any(j >= BODIES for j in (*hello.observers, *self.bus.ports))
        differ = [
            key
            for key, value in hello.agreed.items()
            if self.agreed.get(key, value) != value
        ]
        if owner and differ:
            return (
                f"{who} has another swarm file than this process, with another {', '.join(differ)}",
                COPY,
            )
        return "", ""

    def _refuse(
        self, peer: Peer, hello: Hello, refusal: str, do: str, uptime: float
    ) -> bool:
        """Say so, once; of two that cannot both be there, the one that came later gives way, as long as it is new.

        Later somebody may fly by it: a host that comes back, or says that it is up for long, ends nobody's flight.
        """
        said = peer.refusal
        peer.refusal = refusal
        if said:
            return False
        new = self._uptime() < NEW
        if (
            new
            and hello.version == self.version
            and hello.precedes(self.bus.process, uptime - self._uptime())
        ):
            self.on_refused(Refused(f"swarm {self.swarm}", f"{refusal}. {do}"))
        else:
            log.warning("%s: it is refused", refusal)
        return True

    def _take_in(self, peer: Peer, hello: Hello) -> None:
        was_mutual = self.mutual(peer)
        previous = peer.hello
        peer.hello = hello
        peer.refusal = ""
        if previous is None or previous.incarnation != hello.incarnation:
            peer.offset = Offset()
        if previous is None:
            self.bus.stopped = self.bus.stopped or hello.stopped
        if previous is None or previous.addresses != hello.addresses:
            self._route()
        # Not before it knows us: it would take a latched value for a stranger's.
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
        """Who holds which address: of two that claim one, an operator, then the process that has been up for longer."""
        operators = self.access.operators if self.access is not None else ()
        self.directory.clear()
        for peer in sorted(
            self.by_name.values(),
            key=lambda peer: (peer.host not in operators, peer.since_ns),
        ):
            for address in peer.hello.addresses if peer.hello is not None else ():
                self.directory.setdefault(address, peer)


def _named(address: int) -> str:
    """An address in words."""
    for base, what in (
        (EYES, "what cameras see of drone"),
        (BODIES, "the body of drone"),
    ):
        if address >= base:
            return f"{what} {address - base}"
    return f"drone {address}"
