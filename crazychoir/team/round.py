"""The shape of an iterative distributed algorithm: no
input or output, so any runtime can run it.
"""

from typing import Any, Protocol, runtime_checkable


@runtime_checkable
class Round(Protocol):
    """One agent's part of a synchronous algorithm.

    The runtime repeats, for k = 0, 1, ...: send `message()` to the out-neighbours, wait for the
    message of round k of every in-neighbour, then call `step(heard)`. It stops when `done` is true.
    All agents of a connected team must become `done` in the same round.

    An algorithm with `asynchronous = True` wakes by its own timer, again and again. Then `step`
    gets the latest message of each neighbour that has sent one, and `message()` is sent once and
    may be lost. Each agent stops when it is `done` itself.
    `waits = True` beside it says that the algorithm needs all of its neighbours: a lost neighbour
    ends it.

    A message that cannot be decoded ends the algorithm, unless it is synchronous and has
    `takes_malformed = True`: then `step` gets a `Malformed` in the place of the message.
    """

    @property
    def done(self) -> bool:
        """True after the last round."""
        ...

    def message(self) -> Any:
        """Return the value for the neighbours in this round.

        A `PerNeighbor` holds one for each neighbour.
        """
        ...

    def step(self, heard: dict[int, Any]) -> None:
        """Take the neighbours' messages of this round, keyed by drone id in increasing order."""
        ...
