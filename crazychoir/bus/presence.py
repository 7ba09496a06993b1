"""Monitors which members of a team are ALIVE, SUSPECT or LOST.

A member is SUSPECT if its liveliness token is gone, or if no message came for a second.
A member is LOST if it was SUSPECT for `lost_after`.

Heartbeats come from the drone's event loop and pass the simulated network like every other message.
Therefore a hung loop, a killed process and a partition all become visible. Any message counts as a
sign of life.

A heartbeat needs no message if its receiver is in the same process, ignores its repetition, and no
network is simulated. Then the drone only notes on the bus that it is alive, until `Bus.disturb`.
"""

from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum

from crazychoir.bus.port import NEVER_HEARD_NS, Port
from crazychoir.bus.topics import MESSAGE_TOPICS
from crazychoir.runtime.actor import RESTART_ON_FAILURE, Actor
from crazychoir.runtime.clock import NS_PER_SECOND

SILENCE_TIMEOUT = 1.0  # s without any message after which a member is suspected


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
    ) -> None:
        self.port = port
        self.beat = beat
        self.lost_after = lost_after
        self.seek = seek
        self.listeners: list[OnChange] = []
        self._watched = watched
        self._silent = False
        self._is_running = False
        self._members: dict[int, _Member] = {}
        self._members_by_state: dict[Presence, set[int]] = {
            state: set() for state in Presence
        }
        self._number = 0
        self._addressed = watched
        self._seen_disturbance = (-1, -1)

    @property
    def watched(self) -> tuple[int, ...]:
        """Ids of the members that get heartbeats and are monitored."""
        return self._watched

    @watched.setter
    def watched(self, ids: tuple[int, ...]) -> None:
        if ids != self._watched:
            self._watched = ids
            self.port.bus.disturb()

    @property
    def silent(self) -> bool:
        """True to send no heartbeats: a drone that cannot fly yet is no member."""
        return self._silent

    @silent.setter
    def silent(self, is_silent: bool) -> None:
        self._silent = is_silent
        self._note_beating()

    async def run(self) -> None:
        """Send a heartbeat and check all members, four times a second."""
        self._is_running = True
        self._note_beating()
        try:
            self.tick()
            await self.port.bus.heartbeat_ticks.serve(self.tick)
        finally:
            self._is_running = False
            self._note_beating()

    def _note_beating(self) -> None:
        """Note on the bus whether this drone sends heartbeats."""
        bus = self.port.bus
        address = self.port.address
        if self._is_running and not self._silent:
            bus.beating[address] = self.port
        elif bus.beating.get(address) is self.port:
            del bus.beating[address]
        bus.disturb()

    def tick(self) -> None:
        """Send one heartbeat to every watched member that needs it, and check each of these."""
        bus = self.port.bus
        self._number += 1
        disturbance = (bus.disturbances, bus.impairment.version)
        if disturbance != self._seen_disturbance:
            self._seen_disturbance = disturbance
            self._addressed = self._watched
        addressed = self._addressed
        if not self._silent:
            address = self.port.address
            is_open = bus.beating.get(address) is self.port
            if is_open and len(addressed) < len(self._watched):
                bus.alive_ns[address] = bus.clock.now_ns()
            self._send(addressed + self.seek())
        for j in addressed:
            self._look(j)

    def _send(self, receivers: tuple[int, ...]) -> None:
        """Send one heartbeat, and find the members that need no further ones for now."""
        if not receivers:
            return
        beat = self.beat()
        self.port.send(
            MESSAGE_TOPICS.heartbeat, receivers, beat, self._number, "heartbeat"
        )
        if not self.port.bus.impairment.active:
            self._addressed = tuple(
                j for j in self._addressed if not self._is_settled(j, beat)
            )

    def _is_settled(self, j: int, beat: bytes) -> bool:
        """Return True if member j sends heartbeats in this process, and ignores this one."""
        port = self.port.bus.beating.get(j)
        return (
            port is not None
            and port.ignored_beats.get(self.port.address) == beat
            and self.state(j) is Presence.ALIVE
        )

    def state(self, j: int) -> Presence:
        """Return the believed state of member j."""
        member = self._members.get(j)
        return Presence.ABSENT if member is None else member.state

    def those(self, state: Presence) -> list[int]:
        """Return the watched members in a state other than ABSENT, increasing."""
        known = self._members_by_state[state]
        return sorted(j for j in known if j in self._watched) if known else []

    def token_gone(self, j: int) -> None:
        """Note that the liveliness token of j's process has disappeared."""
        member = self._members.setdefault(j, _Member())
        member.token_gone = True
        self.port.bus.disturb()
        if member.state is Presence.ALIVE:
            self._change(j, member, Presence.SUSPECT)

    def token_back(self, j: int) -> None:
        """Note that the liveliness token of j's process exists (again)."""
        member = self._members.get(j)
        if member is not None:
            member.token_gone = False
            self.port.bus.disturb()

    def _look(self, j: int) -> None:
        """Update the state of member j from the time of its last message and from its token."""
        heard_ns = self.port.last_heard_ns(j)
        if heard_ns == NEVER_HEARD_NS:
            return
        member = self._members.get(j)
        if member is None:
            member = self._members[j] = _Member()
        now_ns = self.port.bus.clock.now_ns()
        silent = now_ns - heard_ns > SILENCE_TIMEOUT * NS_PER_SECOND
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
        self._members_by_state[member.state].discard(j)
        self._members_by_state[state].add(j)
        member.state = state
        member.since_ns = self.port.bus.clock.now_ns()
        for listener in self.listeners:
            listener(j, state)
