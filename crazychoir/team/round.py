"""The shape of an iterative distributed algorithm: pure, without I/O, run by any runtime."""

from typing import Any, Protocol, runtime_checkable


@runtime_checkable
class Round(Protocol):
    """One agent's part of a synchronous algorithm.

    The runtime repeats, for k = 0, 1, ...: send `message()` to the out-neighbours, wait for the
    message of round k of every in-neighbour, call `step(heard)`; until `done`.
    All agents of a connected team must become `done` in the same round.

    One with `asynchronous = True` is instead woken by itself, again and again: `step` gets the latest message of each
    neighbour that has been heard, then `message()` is sent once, and may be lost. Each ends when it is `done` itself.
    `waits = True` beside it says that it cannot go on without all of its neighbours: one that is lost ends it.
    """

    @property
    def done(self) -> bool:
        """Whether the last round is over."""
        ...

    def message(self) -> Any:
        """What the neighbours get in this round; a `PerNeighbor` gives each its own."""
        ...

    def step(self, heard: dict[int, Any]) -> None:
        """Take the neighbours' messages of this round, by drone id in increasing order."""
        ...
