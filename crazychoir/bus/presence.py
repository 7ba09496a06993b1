"""Who is there: ALIVE, SUSPECT (liveliness token gone, or silent for a second), LOST (SUSPECT for `lost_after`).

Heartbeats come from the drone's event loop and pass the simulated network like every other message, so a hung
loop, a killed process and a partition all show; any message counts as a sign of life.
"""

from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum

from crazychoir.bus.port import Port
from crazychoir.bus.topics import HEARTBEAT
from crazychoir.runtime.actor import ON_FAILURE, Actor
from crazychoir.runtime.clock import SECOND

SILENCE = 1.0
"""s without any message before a member is suspected."""


class Presence(Enum):
    """What is believed of a member."""

    ABSENT = "absent"
    """never heard"""
    ALIVE = "alive"
    SUSPECT = "suspect"
    LOST = "lost"


@dataclass
class _Member:
    state: Presence = Presence.ABSENT
    since_ns: int = 0
    token_gone: bool = False


OnChange = Callable[[int, Presence], None]


class PresenceMonitor(Actor):
    """Sends this drone's heartbeats to those who watch it, and watches others.

    `watched` may be changed at any time; `beat` makes the heartbeat's payload, of the codec.
    """

    name = "presence"
    restart = ON_FAILURE

    def __init__(
        self,
        port: Port,
        watched: tuple[int, ...],
        beat: Callable[[], bytes],
        lost_after: float = 5.0,
    ) -> None:
        self.port = port
        self.watched = watched
        self.beat = beat
        self.lost_after = lost_after
        self.listeners: list[OnChange] = []
        self._members: dict[int, _Member] = {}
        self._number = 0
        self.silent = False
        """Whether it only listens: who cannot fly yet is no member."""

    async def run(self) -> None:
        """Beat and look, four times a second."""
        self.tick()
        async for _ in self.port.bus.clock.ticks(
            HEARTBEAT.rate, drone=self.port.address
        ):
            self.tick()

    def tick(self) -> None:
        """One heartbeat to everybody watched, and one look at each."""
        self._number += 1
        if not self.silent:
            self.port.send(
                HEARTBEAT, self.watched, self.beat(), self._number, "heartbeat"
            )
        for j in self.watched:
            self._look(j)

    def state(self, j: int) -> Presence:
        """What is believed of member j now."""
        member = self._members.get(j)
        return Presence.ABSENT if member is None else member.state

    def those(self, state: Presence) -> list[int]:
        """Watched members in a state, in order."""
        return [j for j in sorted(self.watched) if self.state(j) is state]

    def token_gone(self, j: int) -> None:
        """The liveliness token of the process of j has disappeared."""
        member = self._members.setdefault(j, _Member())
        member.token_gone = True
        if member.state is Presence.ALIVE:
            self._change(j, member, Presence.SUSPECT)

    def token_back(self, j: int) -> None:
        """The liveliness token is there (again)."""
        self._members.setdefault(j, _Member()).token_gone = False

    def _look(self, j: int) -> None:
        member = self._members.setdefault(j, _Member())
        heard_ns = self.port.heard_ns.get(j)
        if heard_ns is None:
            return
        now_ns = self.port.bus.clock.now_ns()
        silent = now_ns - heard_ns > SILENCE * SECOND
        if not silent and not member.token_gone:
            if member.state is not Presence.ALIVE:
                self._change(j, member, Presence.ALIVE)
        elif member.state is Presence.ALIVE:
            self._change(j, member, Presence.SUSPECT)
        elif (
            member.state is Presence.SUSPECT
            and now_ns - member.since_ns > self.lost_after * SECOND
        ):
            self._change(j, member, Presence.LOST)

    def _change(self, j: int, member: _Member, state: Presence) -> None:
        member.state = state
        member.since_ns = self.port.bus.clock.now_ns()
        for listener in self.listeners:
            listener(j, state)
