"""A distributed algorithm written as one generator: `heard = yield message` is one round."""

from abc import abstractmethod
from collections.abc import Generator, Mapping
from typing import Any, Generic, TypeVar

T = TypeVar("T")
Exchange = Generator[Any, Mapping[int, Any], T]


class Program(Generic[T]):
    """A Round that executes the generator `run`; each `yield` is one round.

    Use it for algorithms with several phases, or with several exchanges a step.
    A subclass sets its fields and then calls `super().__init__()`, which runs the generator up to
    its first message.

    k: rounds done
    result: value that `run` returned, once `done`
    """

    def __init__(self) -> None:
        self.k = 0
        self._done = False
        self._program = self.run()
        self._advance(None)

    @abstractmethod
    def run(self) -> Exchange[T]:
        """Run the algorithm from the first message to the result."""

    @property
    def done(self) -> bool:
        """True when the last round is over."""
        return self._done

    def message(self) -> Any:
        """Return the message to the neighbours in this round."""
        return self._message

    def step(self, heard: Mapping[int, Any]) -> None:
        """End this round with the messages of the neighbours, and run up to the next message."""
        self.k += 1
        self._advance({j: heard[j] for j in sorted(heard)})

    def _advance(self, heard: Mapping[int, Any] | None) -> None:
        try:
            self._message = self._program.send(heard)  # type: ignore[arg-type]  # None starts it
        except StopIteration as end:
            self.result: T = end.value
            self._message = None
            self._done = True
