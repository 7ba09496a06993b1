"""Strangers: drones that use the name of this swarm with another swarm file or mission.

The smaller of the two groups is refused.
"""

from collections.abc import Collection, Sequence
from typing import Final

from crazychoir.runtime.clock import NS_PER_SECOND, Clock

SETTLE_TIME: Final = 2.0
"""Seconds after the first stranger until the smaller group is decided, in a small team.

It comes earlier if all drones are known.
"""

COPY_SWARM_ADVICE: Final = "Copy one swarm file and one mission to every host."
"""Advice of the error text."""
MISSION_CODE_NAME: Final = "the text of the mission"
"""Name of the last part of a mission hash, after the keys of the swarm file."""


def differing_keys(ours: str, theirs: str, keys: Sequence[str]) -> list[str]:
    """Return the keys of the swarm file in which two mission hashes differ.

    A mission hash is "digest:digits", with two hex digits for each key and for the mission text.

    keys: the keys with digits, in their order
    Returns [] if a hash has no digits or digits of other keys, or if the digits agree by chance.
    """
    (_, _, a), (_, _, b) = ours.partition(":"), theirs.partition(":")
    names = (*keys, MISSION_CODE_NAME)
    if len(a) != 2 * len(names) or len(b) != len(a):
        return []
    return [
        name
        for k, name in enumerate(names)
        if a[2 * k : 2 * k + 2] != b[2 * k : 2 * k + 2]
    ]


def _describe_difference(theirs: str, ours: str, keys: Sequence[str]) -> str:
    differs = differing_keys(ours, theirs, keys)
    return theirs.partition(":")[0] + (
        f", which has another {', '.join(differs)}" if differs else ""
    )


class Strangers:
    """The other missions from which drone `id`, one of `team` drones, has received heartbeats.

    keys: keys of the swarm file with digits of their own in the mission hash
    settle_time: seconds after the first stranger until the smaller group is decided
    missions: {drone id: mission hash} of the strangers
    """

    def __init__(
        self,
        clock: Clock,
        id: int,
        team: int,
        mission_hash: str,
        keys: Sequence[str] = (),
        settle_time: float = SETTLE_TIME,
    ) -> None:
        self.keys = keys
        self.settle_time = settle_time
        self.clock = clock
        self.id = id
        self.team = team
        self.mission_hash = mission_hash
        self.missions: dict[int, str] = {}
        self._companions: dict[int, None] = {}
        """Drones of this mission that were heard since the first stranger."""
        self._judge_ns = 0

    def heard(self, j: int, mission_hash: str) -> bool:
        """Note a heartbeat of drone j with this mission; return True if j is a stranger."""
        if mission_hash.partition(":")[0] == self.mission_hash.partition(":")[0]:
            self.missions.pop(j, None)
            if self.missions:
                self._companions[j] = None
            return False
        self._judge_ns = self._judge_ns or self.clock.now_ns() + int(
            self.settle_time * NS_PER_SECOND
        )
        self._companions.pop(j, None)
        self.missions[j] = mission_hash
        return True

    def are_more(self, ours: Collection[int]) -> bool:
        """Return True if another mission has more drones than this drone and `ours` together.

        Between groups of equal size, the group with the lowest id wins.
        Returns False until all drones are known or `settle_time` has passed.
        """
        if not self.missions:
            return False
        ours = {**dict.fromkeys(ours), **self._companions}
        missing = len(ours) + len(self.missions) < self.team - 1
        if missing and self.clock.now_ns() < self._judge_ns:
            return False
        theirs: dict[str, list[int]] = {}
        for j, text in self.missions.items():
            theirs.setdefault(text, []).append(j)
        return any(
            (len(same), -min(same)) > (1 + len(ours), -min([self.id, *ours]))
            for same in theirs.values()
        )

    def text(self) -> str:
        """Return a text for the user that names the strangers and the differences."""
        ours = self.mission_hash
        whole = self.mission_hash.partition(":")[0]
        missions = sorted(self.missions.items())
        others = ", ".join(
            f"drone {j} ({_describe_difference(theirs, ours, self.keys)})"
            for j, theirs in missions
        )
        return f"its swarm file or mission ({whole}) is not that of {others}. {COPY_SWARM_ADVICE}"
