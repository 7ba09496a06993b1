"""Termination by a distributed logic-and: all have been still for long enough, and all know it in the same round."""

from collections.abc import Iterable


class Stillness:
    """How long nobody has changed, as far as this agent can know.

        h_i <- 0 if i has changed in this round, else 1 + min(h_i, min_j h_j) over the neighbours that it hears

    h_i = T says that an agent d rounds away had not changed T - d times before. With D rounds in which a message of
    each agent reaches all (the diameter of a constant graph), h_i = 2 D + 1 says that for D + 1 rounds nobody had
    changed: all have heard all, and algorithms whose step depends on what is heard alone never change again. No agent
    gets there before all know of the last change, so all get there in the same round.
    Source: the rule of Notarstefano & Bullo 2011, IEEE TAC 56(10), 2247-2261, with the minimum as the logic-and.
    """

    def __init__(self, diameter: int) -> None:
        self.rounds, self._enough = 0, 2 * diameter + 1

    def step(self, changed: bool, heard: Iterable[int]) -> None:
        """Take what the neighbours' `rounds` were."""
        self.rounds = 0 if changed else 1 + min([self.rounds, *heard])

    @property
    def reached(self) -> bool:
        """Whether the team has ended."""
        return self.rounds >= self._enough
