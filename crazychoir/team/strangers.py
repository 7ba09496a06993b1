"""Drones under the same swarm's name whose swarm file or mission is another one: who of them is refused."""

from collections.abc import Collection, Sequence
from typing import Final

from crazychoir.runtime.clock import SECOND, Clock

SETTLE: Final = 2.0
"""s after the first stranger until it is judged who is the minority, if not everybody has been heard before."""

COPY: Final = "Copy one swarm file and one mission to every host."
CODE: Final = "the text of the mission"


def difference(ours: str, theirs: str, keys: Sequence[str]) -> list[str]:
    """Return the keys of the swarm file in which two mission hashes differ.

    keys: the keys that each hash holds two hex digits of, in their order.
    Returns [] where a hash holds no keys, other keys, or agrees by chance.
    """
    (_, _, a), (_, _, b) = ours.partition(":"), theirs.partition(":")
    names = (*keys, CODE)
    if len(a) != 2 * len(names) or len(b) != len(a):
        return []
    return [
        name
        for k, name in enumerate(names)
        if a[2 * k : 2 * k + 2] != b[2 * k : 2 * k + 2]
    ]


def _told(theirs: str, ours: str, keys: Sequence[str]) -> str:
    differs = difference(ours, theirs, keys)
    return theirs.partition(":")[0] + (
        f", which has another {', '.join(differs)}" if differs else ""
    )


class Strangers:
    """What drone `id`, one of `team` drones, has heard of other missions.

    keys: keys of the swarm file that the mission hash holds one by one.
    """

    def __init__(
        self,
        clock: Clock,
        id: int,
        team: int,
        mission_hash: str,
        keys: Sequence[str] = (),
    ) -> None:
        self.keys = keys
        self.clock = clock
        self.id = id
        self.team = team
        self.mission_hash = mission_hash
        self.missions: dict[int, str] = {}
        self._judge_ns = 0

    def heard(self, j: int, mission_hash: str) -> bool:
        """Whether j is one, by what its heartbeat says."""
        if mission_hash.partition(":")[0] == self.mission_hash.partition(":")[0]:
            self.missions.pop(j, None)
            return False
        self._judge_ns = self._judge_ns or self.clock.now_ns() + int(SETTLE * SECOND)
        self.missions[j] = mission_hash
        return True

    def are_more(self, ours: Collection[int]) -> bool:
        """Whether another mission has more drones than we and `ours` are; among equals, the lowest id is right."""
        missing = len(ours) + len(self.missions) < self.team - 1
        if not self.missions or (missing and self.clock.now_ns() < self._judge_ns):
            return False
        theirs = [
            [j for j, other in self.missions.items() if other == text]
            for text in self.missions.values()
        ]
        return any(
            (len(same), -min(same)) > (1 + len(ours), -min([self.id, *ours]))
            for same in theirs
        )

    def text(self) -> str:
        """What to tell the user of them, and in what they differ."""
        ours = self.mission_hash
        whole = self.mission_hash.partition(":")[0]
        missions = sorted(self.missions.items())
        others = ", ".join(
            f"drone {j} ({_told(theirs, ours, self.keys)})" for j, theirs in missions
        )
        return f"its swarm file or mission ({whole}) is not that of {others}. {COPY}"
