"""Commands on their way to drones that obey late, in whole steps of their world."""

from collections import deque
from dataclasses import dataclass, field

from crazychoir.simulation.common.world import Link
from crazychoir.types import Command


@dataclass
class DelayedLink:
    """The way to one drone: a command that is sent before step k acts from step k + steps on; a cut acts at once."""

    link: Link
    steps: int
    _way: deque[tuple[int, Command]] = field(default_factory=deque)
    _step: int = 0

    def send(self, command: Command) -> None:
        """On its way."""
        self._way.append((self._step + self.steps, command))

    def cut(self) -> None:
        """Nothing that is on its way acts any more."""
        self._way.clear()
        self.link.cut()

    def advance(self) -> None:
        """A step of the world begins: what is due arrives."""
        while self._way and self._way[0][0] <= self._step:
            self.link.send(self._way.popleft()[1])
        self._step += 1
