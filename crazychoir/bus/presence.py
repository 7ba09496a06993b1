"""Monitors which members of a team are ALIVE, SUSPECT or LOST.

A member is SUSPECT if its liveliness token is gone, or if no message came for a second.
A member is LOST if it was SUSPECT for `lost_after` while it was watched.

Heartbeats come from the drone's event loop and pass the simulated network like every other message.
Therefore a hung loop, a killed process and a partition all become visible. Any message counts as a
sign of life. So does a state of a member that comes without a message of its own, see
Port.life_signs: a drone that may not fly sends no heartbeats, though others hear its states.

A heartbeat needs no message if its receiver is in the same process and ignores its repetition. Then
the sender only notes its time at the receiver. If the simulated network may lose heartbeats, one
call draws for all receivers. A network that delays them or is divided gets messages.
"""

from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum

from crazychoir.bus.impairment.lossy_edges import LossyEdges
from crazychoir.bus.message import Message
from crazychoir.bus.port import Port
from crazychoir.bus.topics import MESSAGE_TOPICS
from crazychoir.runtime.actor import RESTART_ON_FAILURE, Actor
from crazychoir.runtime.clock import NS_PER_SECOND

SILENCE_TIMEOUT = 1.0  # s without any message after which a member is suspected
SILENCE_TIMEOUT_NS = round(SILENCE_TIMEOUT * NS_PER_SECOND)
HEARTBEAT_CHANNEL = "heartbeat"  # of the simulated network


def find_heard_ns(port: Port, source: int) -> int | None:
    """Return when a port last heard another one, by a message or without one, ns; None: never."""
    times = [sign(source) for sign in port.life_signs]
    times.append(port.heard_ns.get(source))
    return max((time for time in times if time is not None), default=None)


class Presence(Enum):
    """The believed state of a member."""

    ABSENT = "absent"
    """No message was ever received."""
    ALIVE = "alive"
    """Messages arrive."""
    SUSPECT = "suspect"
    """The liveliness token is gone, or messages are missing."""
    LOST = "lost"
    """Suspected for too long."""


@dataclass(slots=True)
class _Member:
    """The state of a watched member."""

    state: Presence = Presence.ABSENT
    """Believed presence."""
    since_ns: int = 0
    """ns: last change of the state."""
    token_gone: bool = False
    """True if its liveliness token has disappeared."""


OnChange = Callable[[int, Presence], None]
"""Callable that gets (id, presence) of a member with a new state."""


class PresenceMonitor(Actor):
    """Sends this drone's heartbeats to the watched members, and monitors them.

    watched: ids of the members; may be changed at any time
    beat: callable that returns the payload of a heartbeat
    lost_after: seconds after which a SUSPECT member is LOST
    seek: callable that returns further receivers of the next heartbeat, which are not monitored
    is_member: callable that returns whether states of a drone are signs of its life
    """

    name = "presence"
    restart = RESTART_ON_FAILURE

    def __init__(
        self,
        port: Port,
        watched: tuple[int, ...],
        beat: Callable[[], bytes],
        lost_after: float = 5.0,
        seek: Callable[[], tuple[int, ...]] = tuple,
        is_member: Callable[[int], bool] = lambda j: True,
    ) -> None:
        self.port = port
        self.beat = beat
        self.lost_after = lost_after
        self.seek = seek
        self._is_member = is_member
        self.listeners: list[OnChange] = []
        self.silent = False
        """True to send no heartbeats: a drone that cannot fly yet is no member."""
        self._members: dict[int, _Member] = {}
        self._watched = watched
        self._number = 0
        self._edges: LossyEdges | None = None
        self._edges_made_for: tuple[int, tuple[int, ...]] = (0, ())

    @property
    def watched(self) -> tuple[int, ...]:
        """The ids of the members."""
        return self._watched

    @watched.setter
    def watched(self, ids: tuple[int, ...]) -> None:
        now_ns = self.port.bus.clock.now_ns()
        known = frozenset(self._watched)
        for j in ids:
            # It sends no heartbeats to a drone that does not watch it: that silence does not count.
            if j not in known and self.state(j) is Presence.SUSPECT:
                self._members[j].since_ns = now_ns
        self._watched = ids

    async def run(self) -> None:
        """Send a heartbeat and check all members, four times a second."""
        self.tick()
        await self.port.bus.heartbeat_ticks.serve(self.tick)

    def tick(self) -> None:
        """Send one heartbeat to every watched member, and check each of them."""
        self._number += 1
        now_ns = self.port.bus.clock.now_ns()
        if not self.silent:
            beat = self.beat()
            ignoring = self._list_ignoring(beat)
            if ignoring:
                self._note_beat(ignoring, now_ns, len(beat))
            receivers = [j for j in self._watched if j not in ignoring]
            receivers += self.seek()
            if receivers:
                message = Message(
                    MESSAGE_TOPICS.heartbeat,
                    self.port.address,
                    beat,
                    self._number,
                    HEARTBEAT_CHANNEL,
                )
                self.port.send(message, receivers)
        for j in self._list_changing(now_ns):
            self._look(j)

    def _list_ignoring(self, beat: bytes) -> dict[int, Port]:
        """Return the ports of the watched members that need no message with this heartbeat."""
        bus = self.port.bus
        address = self.port.address
        if bus.ports.get(address) is not self.port:
            return {}
        ports = bus.ports
        # A loop without calls, because this is done for all members four times a second.
        ignoring = {
            j: port
            for j in self._watched
            if (port := ports.get(j)) is not None
            and port.ignored_beats.get(address) == beat
        }
        if ignoring and bus.impairment.active:
            self._refresh_edges()
            lossy = self._edges.destinations if self._edges is not None else ()
            ignoring = {j: port for j, port in ignoring.items() if j in lossy}
        return ignoring

    def _refresh_edges(self) -> None:
        """Make the edges of the simulated network anew if it or the watched members have changed."""
        impairment = self.port.bus.impairment
        address = self.port.address
        made_for = (impairment.version, self._watched)
        if made_for == self._edges_made_for:
            return
        self._edges_made_for = made_for
        if self._edges is not None:
            self._edges.close()
        lossy = [j for j in self._watched if impairment.only_loses(address, j)]
        self._edges = LossyEdges(impairment, address, lossy, HEARTBEAT_CHANNEL)

    def _note_beat(self, ignoring: dict[int, Port], now_ns: int, size: int) -> None:
        """Note a heartbeat of this drone at members that ignore it, unless it is lost on the way.

        ignoring: ports of these members
        size: bytes of the heartbeat
        """
        address = self.port.address
        reached = list(ignoring)
        if self.port.bus.impairment.active and self._edges is not None:
            reached = self._edges.send(self._number, reached)
            counters = self.port.counters
            counters.sent += len(ignoring)
            counters.lost += len(ignoring) - len(reached)
            counters.bytes += len(ignoring) * size
        for j in reached:
            ignoring[j].heard_ns[address] = now_ns

    def _list_changing(self, now_ns: int) -> list[int]:
        """Return the watched members that are not ALIVE, or may not be so any longer."""
        members = self._members
        heard_ns = self.port.heard_ns
        since_ns = now_ns - SILENCE_TIMEOUT_NS
        alive = Presence.ALIVE
        # A loop without calls, because this is done for all members four times a second.
        return [
            j
            for j in self._watched
            if (member := members.get(j)) is None
            or member.state is not alive
            or member.token_gone
            or heard_ns.get(j, 0) < since_ns
        ]

    def find_heard_ns(self, j: int) -> int | None:
        """Return the time of the last sign of life of drone j, ns; None: there was none."""
        if self._is_member(j):
            return find_heard_ns(self.port, j)
        return self.port.heard_ns.get(j)

    def state(self, j: int) -> Presence:
        """Return the believed state of member j."""
        member = self._members.get(j)
        return Presence.ABSENT if member is None else member.state

    def those(self, state: Presence) -> list[int]:
        """Return the watched members in a state, increasing."""
        members = self._members
        return [
            j
            for j in sorted(self._watched)
            if (member := members.get(j)) is not None and member.state is state
        ]

    def token_gone(self, j: int) -> None:
        """Note that the liveliness token of j's process has disappeared."""
        member = self._members.setdefault(j, _Member())
        member.token_gone = True
        if member.state is Presence.ALIVE:
            self._change(j, member, Presence.SUSPECT)

    def token_back(self, j: int) -> None:
        """Note that the liveliness token of j's process exists (again)."""
        member = self._members.get(j)
        if member is not None:
            member.token_gone = False

    def _look(self, j: int) -> None:
        """Update the state of member j from the time of its last message and from its token."""
        heard_ns = self.find_heard_ns(j)
        if heard_ns is None:
            return
        member = self._members.get(j)
        if member is None:
            member = self._members[j] = _Member()
        now_ns = self.port.bus.clock.now_ns()
        silent = now_ns - heard_ns > SILENCE_TIMEOUT_NS
        if not silent and not member.token_gone:
            if member.state is not Presence.ALIVE:
                self._change(j, member, Presence.ALIVE)
        elif member.state is Presence.ALIVE:
            self._change(j, member, Presence.SUSPECT)
        elif (
            member.state is Presence.SUSPECT
            and now_ns - member.since_ns > self.lost_after * NS_PER_SECOND
        ):
            self._change(j, member, Presence.LOST)

    def _change(self, j: int, member: _Member, state: Presence) -> None:
        member.state = state
        member.since_ns = self.port.bus.clock.now_ns()
        for listener in self.listeners:
            listener(j, state)
