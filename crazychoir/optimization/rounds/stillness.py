"""The end of algorithms that improve until nothing changes: agreed by a logical and, in one round at all agents."""

from collections.abc import Mapping

from crazychoir.optimization.rounds.stopping import Flags


class Stillness:
    """Whether the team has been still for so long that nothing can change any more.

    An agent's flag is up while it has not changed for D + 1 rounds, and D rounds later all know whether all flags were
    up: 2 D + 1 rounds after the last change. In D rounds a message of each agent reaches all, so that in those D + 1
    all have heard all; where a step depends on what is heard alone, as with bases, nobody ever changes again.
    diameter: D, of a graph; of a sequence of graphs the longest time of a flood.
    Source: the rule of Notarstefano & Bullo 2011, IEEE TAC 56(10), 2247-2261; the logical and: see Flags.
    """

    def __init__(self, diameter: int) -> None:
        self._flags = Flags(diameter, False)
        self._needed = diameter + 1
        self._calm = 0

    @property
    def reached(self) -> bool:
        """Whether the team has ended."""
        return self._flags.agreed

    def message(self) -> bytes:
        """What the neighbours must hear."""
        return self._flags.message()

    def step(self, changed: bool, heard: Mapping[int, bytes]) -> None:
        """heard: the messages of all that are heard, b"" of who is not with us yet."""
        self._calm = 0 if changed else self._calm + 1
        self._flags.step(self._calm >= self._needed, heard)
