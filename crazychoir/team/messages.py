"""What the members of a team tell each other about themselves, and what they agree on."""

from dataclasses import dataclass
from typing import Annotated, Any
from zlib import crc32

import msgspec
from msgspec import Meta

from crazychoir.bus.codec import encode
from crazychoir.team.graph import Graph


class Roster(msgspec.Struct, frozen=True):
    """What all members agree on.

    members: {id: incarnation};  first_round: from which this epoch counts for algorithms that go on.
    """

    epoch: int
    members: dict[int, int]
    edges: list[list[int]]
    directed: bool
    seed: int
    first_round: int
    mission_hash: str
    version: str

    @property
    def ids(self) -> tuple[int, ...]:
        """Members in increasing order."""
        return tuple(sorted(self.members))

    @property
    def graph(self) -> Graph:
        """The communication graph of the members."""
        return Graph.from_edges(self.ids, self.edges, self.directed)

    @property
    def checksum(self) -> int:
        """Equal for equal rosters."""
        return crc32(encode(msgspec.to_builtins(self)))


class Go(msgspec.Struct, frozen=True):
    """A roster as it is told.  age: s since GO, of the mission: who joins it later counts from there too."""

    roster: Roster
    age: Annotated[float, Meta(ge=0.0, le=1e9)] = 0.0

    def wire(self) -> bytes:
        """As a message."""
        return encode(msgspec.to_builtins(self))


@dataclass(frozen=True)
class Beat:
    """What a heartbeat says: incarnation, epoch and checksum of its roster, whom it has lost, mission.

    hears: before the first roster, whom it hears;  refused: why it cannot fly and will not come; empty if it does.
    """

    incarnation: int
    epoch: int
    checksum: int
    hears: tuple[int, ...]
    lost: tuple[int, ...]
    mission_hash: str
    refused: str = ""

    def wire(self) -> list[Any]:
        """As the codec takes it."""
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
        ]

    @classmethod
    def of(cls, value: Any) -> "Beat":
        """From the wire; raises TypeError, ValueError."""
        incarnation, epoch, checksum, hears, lost, mission_hash, refused = value
        numbers = int(incarnation), int(epoch), int(checksum)
        return cls(
            *numbers,
            tuple(map(int, hears)),
            tuple(map(int, lost)),
            str(mission_hash),
            str(refused),
        )
