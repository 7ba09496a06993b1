"""Drones under the same swarm's name whose swarm file or mission is another one: who of them is refused."""

from collections.abc import Collection
from typing import Final

from crazychoir.config.tables import AGREED
from crazychoir.runtime.clock import SECOND, Clock

SETTLE: Final = 2.0
"""s after the first stranger until it is judged who is the minority, if not everybody has been heard before."""

COPY: Final = "Copy one swarm file and one mission to every host."
CODE: Final = "the text of the mission"


def difference(ours: str, theirs: str) -> list[str]:
    """In which keys of the swarm file two mission hashes differ; [] where one of them does not say, or by chance."""
    (_, _, a), (_, _, b) = ours.partition(":"), theirs.partition(":")
    names = (*AGREED, CODE)
    if len(a) != 2 * len(names) or len(b) != len(a):
        return []
    return [name for k, name in enumerate(names) if a[2 * k : 2 * k + 2] != b[2 * k : 2 * k + 2]]


def _told(theirs: str, ours: str) -> str:
    differs = difference(ours, theirs)
    return theirs.partition(":")[0] + (f", which has another {', '.join(differs)}" if differs else "")


class Strangers:
    """What drone `id`, one of `team` drones, has heard of other missions."""

    def __init__(self, clock: Clock, id: int, team: int, mission_hash: str) -> None:
        self.clock, self.id, self.team, self.mission_hash = clock, id, team, mission_hash
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
        theirs = [[j for j, other in self.missions.items() if other == text] for text in self.missions.values()]
        return any((len(same), -min(same)) > (1 + len(ours), -min([self.id, *ours])) for same in theirs)

    def text(self) -> str:
        """What to tell the user of them, and in what they differ."""
        ours, whole = self.mission_hash, self.mission_hash.partition(":")[0]
        others = ", ".join(f"drone {j} ({_told(theirs, ours)})" for j, theirs in sorted(self.missions.items()))
        return f"its swarm file or mission ({whole}) is not that of {others}. {COPY}"
