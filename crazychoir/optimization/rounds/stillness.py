"""The end of algorithms that improve until nothing changes: all agents end in the same round."""

from collections.abc import Mapping

from crazychoir.optimization.rounds.stopping import Flags


class Stillness:
    """The test for a team in which nothing can change any more.

    The flag of an agent is up while the agent has not changed for D + 1 rounds. D rounds later all
    agents know whether all flags were up. So the team ends 2 D + 1 rounds after the last change.
    In D rounds a message of each agent reaches all agents, so in those D + 1 rounds each agent has
    heard from all. Where a step depends only on the messages, as with bases, no agent changes
    again.

    diameter: D, the diameter of a graph, or the longest time of a flood in a sequence of graphs
    Source: the rule of Notarstefano & Bullo 2011, IEEE TAC 56(10), 2247-2261; the logical AND:
    see Flags.
    """

    def __init__(self, diameter: int) -> None:
        self._flags = Flags(diameter, False)
        self._needed = diameter + 1
        self._calm = 0

    @property
    def reached(self) -> bool:
        """True when the team has ended."""
        return self._flags.agreed

    def message(self) -> bytes:
        """Return the flags for the neighbours."""
        return self._flags.message()

    def step(self, changed: bool, heard: Mapping[int, bytes]) -> None:
        """Count one round.

        changed: True if this agent changed in this round
        heard: flags of all in-neighbours; b"" for a neighbour that has not started yet
        """
        self._calm = 0 if changed else self._calm + 1
        self._flags.step(self._calm >= self._needed, heard)
