"""Monitors which members of a team are ALIVE, SUSPECT or LOST.

A member is SUSPECT if its liveliness token is gone, or if no message came for a second.
A member is LOST if it was SUSPECT for `lost_after`.

Heartbeats come from the drone's event loop and pass the simulated network like every other message.
Therefore a hung loop, a killed process and a partition all become visible. Any message counts as a
sign of life.
"""

from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum

from crazychoir.bus.port import Port
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
        self.watched = watched
        self.beat = beat
        self.lost_after = lost_after
        self.seek = seek
        self.listeners: list[OnChange] = []
        self._members: dict[int, _Member] = {}
        self._number = 0
        self.silent = False
        """True to send no heartbeats: a drone that cannot fly yet is no member."""

    async def run(self) -> None:
        """Send a heartbeat and check all members, four times a second."""
        self.tick()
        async for _ in self.port.bus.clock.ticks(
            MESSAGE_TOPICS.heartbeat.rate, drone=self.port.address
        ):
            self.tick()

    def tick(self) -> None:
        """Send one heartbeat to every watched member, and check each of them."""
        self._number += 1
        if not self.silent:
            self.port.send(
                MESSAGE_TOPICS.heartbeat,
                self.watched + self.seek(),
                self.beat(),
                self._number,
                "heartbeat",
            )
        for j in self.watched:
            self._look(j)

    def state(self, j: int) -> Presence:
        """Return the believed state of member j."""
        member = self._members.get(j)
        return Presence.ABSENT if member is None else member.state

    def those(self, state: Presence) -> list[int]:
        """Return the watched members in a state, increasing."""
        return [j for j in sorted(self.watched) if self.state(j) is state]

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
        heard_ns = self.port.heard_ns.get(j)
        if heard_ns is None:
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
        member.state = state
        member.since_ns = self.port.bus.clock.now_ns()
        for listener in self.listeners:
            listener(j, state)
