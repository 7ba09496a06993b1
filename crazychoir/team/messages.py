"""The messages in which members of a team describe
themselves, and the roster that they agree on.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Annotated, Any
from zlib import crc32

import msgspec
from msgspec import Meta

from crazychoir.bus.codec import decode, encode, register
from crazychoir.errors import CodecError
from crazychoir.team.graph import Graph
from crazychoir.team.message_kind import MOST_EPOCHS
from crazychoir.types import Wire


class Roster(msgspec.Struct, frozen=True, dict=True):
    """The composition of the team in one epoch, equal at all members.

    The members of a process share one roster, so its values must not be changed.
    """

    epoch: int
    """Number of this composition; a larger number is newer."""
    members: dict[int, int]
    """{drone id: incarnation}."""
    edges: list[list[int]]
    """Pairs [i, j] of the communication graph of the members."""
    directed: bool
    """True if an edge [i, j] says only that i sends to j."""
    seed: int
    """Seed of the mission, from the swarm file."""
    first_round: int
    """Round from which this epoch counts, for algorithms that continue across epochs."""
    mission_hash: str
    """Hash of the swarm file and the mission."""
    version: str
    """Version of crazychoir at the coordinator."""

    @cached_property
    def ids(self) -> tuple[int, ...]:
        """Members in increasing order."""
        return tuple(sorted(self.members))

    @cached_property
    def graph(self) -> Graph:
        """The communication graph of the members."""
        return Graph.from_edges(self.ids, self.edges, self.directed)

    @cached_property
    def checksum(self) -> int:
        """CRC-32 of the encoded roster: equal rosters have equal checksums."""
        return crc32(encode(msgspec.to_builtins(self)))

    def list_joined(self, before: Mapping[int, int]) -> tuple[int, ...]:
        """Return the members that were not in an earlier roster with the same incarnation.

        before: {drone id: incarnation} of the earlier roster; empty if there was none
        """
        if not before:
            return self.ids
        return tuple(j for j, n in self.members.items() if before.get(j) != n)

    def list_absent(self, ids: tuple[int, ...]) -> tuple[int, ...]:
        """Return the drones of `ids`, which are increasing, that are not members."""
        if ids == self.ids:
            return ()
        return tuple(j for j in ids if j not in self.members)


class GoMessage(msgspec.Struct, frozen=True):
    """A roster on the wire, with the age of the mission."""

    roster: Roster
    """The roster."""
    age: Annotated[float, Meta(ge=0.0, le=1e9)] = 0.0
    """Seconds since the mission's GO.

    A drone that joins later counts its mission time from GO too.
    """

    def wire(self) -> bytes:
        """Return the encoded message."""
        return encode(msgspec.to_builtins(self))


@register
class HoldRequest(Wire, frozen=True, array_like=True, gc=False):
    """A coordinator's request to send no further round before its next roster."""

    epoch: int
    """Number of the roster that the coordinator forms."""

    def wire(self) -> bytes:
        """Return the encoded message."""
        return encode(self)


@register
class HoldAnswer(Wire, frozen=True, array_like=True, gc=False):
    """The answer to a `HoldRequest`: the sender holds its rounds."""

    epoch: int
    """Number of the roster for which it holds."""
    first_held_round: int
    """First round that the sender has not sent."""
    members: dict[int, int]
    """{drone id: incarnation} of the sender's roster; empty before its first."""

    def wire(self) -> bytes:
        """Return the encoded message."""
        return encode(self)


RosterMessage = GoMessage | HoldRequest | HoldAnswer
"""A message about a roster."""


@lru_cache(maxsize=8)  # all drones of a process receive the same rosters
def read_roster_message(payload: bytes) -> RosterMessage:
    """Return the message about a roster that a payload holds.

    Raises CodecError if it holds none.
    """
    message = decode(payload)
    if isinstance(message, HoldRequest | HoldAnswer):
        return message
    try:
        return msgspec.convert(message, GoMessage)
    except msgspec.ValidationError as error:
        raise CodecError(f"payload: is no message about a roster: {error}") from error


@dataclass(frozen=True)
class TeamHeartbeat:
    """The content of a heartbeat."""

    incarnation: int
    """Number of the sender's process; a restarted agent has another one."""
    epoch: int
    """Epoch of the sender's roster; 0 before the first."""
    checksum: int
    """Checksum of the sender's roster."""
    hears: tuple[int, ...]
    """Drones from which the sender receives heartbeats; only before the first roster."""
    lost: tuple[int, ...]
    """Ids that the sender has lost."""
    mission_hash: str
    """Hash of the sender's swarm file and mission."""
    refused: str = ""
    """Reason why the sender cannot fly and will not join; empty if it can fly."""
    held_for: int = 0
    """Epoch for which the sender holds its rounds, as another drone has asked; 0 if it does not."""

    def wire(self) -> list[Any]:
        """Return the fields as a list for the codec."""
        hears = list(self.hears)
        lost = list(self.lost)
        return [
            self.incarnation,
            self.epoch,
            self.checksum,
            hears,
            lost,
            self.mission_hash,
            self.refused,
            self.held_for,
        ]

    @classmethod
    def of(cls, value: Any) -> "TeamHeartbeat":
        """Return the heartbeat that a decoded list describes.

        Raises TypeError or ValueError if the list is not a heartbeat.
        """
        incarnation, epoch, checksum, hears, lost, mission_hash, refused, held = value
        numbers = int(incarnation), int(epoch), int(checksum)
        if numbers[1] >= MOST_EPOCHS:
            raise ValueError(f"epoch {epoch}; allowed: below {MOST_EPOCHS}")
        return cls(
            *numbers,
            tuple(map(int, hears)),
            tuple(map(int, lost)),
            str(mission_hash),
            str(refused),
            int(held),
        )
