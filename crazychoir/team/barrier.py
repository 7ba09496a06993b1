"""One drone's membership of a team: its start, and the epochs that follow.

Every heartbeat contains the sender's incarnation and the drones that it receives. The lowest live
id is the coordinator. It issues GO(roster) as soon as all members are present and each edge works
in both directions, or, at the start deadline, when enough are present (start_barrier.py).

A member that is LOST or joins begins a new epoch (epoch_change.py).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, Protocol

from crazychoir.bus.port import Port
from crazychoir.bus.topics import MESSAGE_TOPICS
from crazychoir.errors import CodecError
from crazychoir.team.epoch_change import EpochChange, HeldRounds
from crazychoir.team.graph import Graph
from crazychoir.team.messages import (
    GoMessage,
    HoldRequest,
    Roster,
    read_roster_message,
)
from crazychoir.team.start_barrier import StartBarrier
from crazychoir.team.team_presence import TeamPresence
from crazychoir.team.team_roster import TeamRoster


class EpochRounds(HeldRounds, Protocol):
    """The rounds of a drone that follow the epochs of its team."""

    def adopt(self, roster: Roster) -> None:
        """Put a roster in force."""
        ...


@dataclass(frozen=True, slots=True)
class AgreedMission:
    """What all members of a team must have alike before they fly together."""

    mission_hash: str
    """Hash of the swarm file and the mission."""
    version: str
    """Version of crazychoir."""
    agreed_keys: Sequence[str] = ()
    """Keys of the swarm file with digits of their own in the mission hash.

    With them an error can name the keys in which two swarm files differ.
    """
    seed: int = 0
    """Seed of the mission."""


class Barrier:
    """One drone's membership of its team: the start, the members, and their changes.

    port: port of the drone on the bus
    graph: communication graph of the whole swarm
    mission: what all members of the team must have alike
    start: "all", or the number of present drones with which the team starts at the deadline
    start_deadline: seconds to wait for the team
    lost_after: seconds of silence after which a drone is LOST

    Attributes:
    rosters: the roster in force, and its distribution
    presence: the heartbeats of the drones, and which of them are lost
    starting: the wait for the first roster
    changing: the change to the next roster
    monitor: actor that sends the heartbeats
    history: the newest changes of presence, as (seconds, id, presence)
    listeners: callables that get each new roster
    """

    def __init__(
        self,
        port: Port,
        graph: Graph,
        mission: AgreedMission,
        *,
        start: int | Literal["all"] = "all",
        start_deadline: float = 30.0,
        lost_after: float = 5.0,
    ) -> None:
        self.port = port
        self.id = port.address
        self.rosters = TeamRoster(
            port,
            graph,
            mission_hash=mission.mission_hash,
            version=mission.version,
            seed=mission.seed,
        )
        self.presence = TeamPresence(self.rosters, mission.agreed_keys, lost_after)
        self.starting = StartBarrier(self.rosters, self.presence, start, start_deadline)
        self.changing = EpochChange(self.rosters, self.presence)
        self.monitor = self.presence.monitor
        self.history = self.presence.history
        self.listeners = self.rosters.listeners
        self.rosters.reliable.listen(MESSAGE_TOPICS.roster, self._handle_message)

    @property
    def roster(self) -> Roster | None:
        """The present roster; None before GO."""
        return self.rosters.roster

    @property
    def absent(self) -> tuple[int, ...]:
        """Drones of the mission that are not in the team."""
        return self.rosters.absent

    @property
    def apart(self) -> str:
        """Text with the parts of the graph that cannot reach each other; empty if there are none."""
        return self.rosters.apart

    @property
    def refused(self) -> str:
        """Reason why this drone cannot fly; empty if it can."""
        return self.presence.refused

    @refused.setter
    def refused(self, reason: str) -> None:
        self.presence.refused = reason

    async def go(self) -> Roster:
        """Wait for GO and return the roster.

        Raises Refused as `StartBarrier.go` does.
        """
        return await self.starting.go()

    def attach(self, rounds: EpochRounds) -> None:
        """Let these rounds follow the epochs of the team."""
        self.changing.attach(rounds)
        self.listeners.append(rounds.adopt)
        if self.roster is not None:
            rounds.adopt(self.roster)

    def _handle_message(self, source: int, payload: bytes) -> None:
        """Handle a message about a roster: GO, HOLD, or the answer to HOLD."""
        try:
            message = read_roster_message(payload)
        except CodecError:
            self.port.counters.malformed += 1
            return
        if isinstance(message, GoMessage):
            self.rosters.take(message)
        elif isinstance(message, HoldRequest):
            self.changing.answer(source, message)
        else:
            self.changing.take_answer(source, message)
