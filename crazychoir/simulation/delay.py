"""Delay of commands to drones, in whole steps of their world."""

from collections import deque
from dataclasses import dataclass, field

from crazychoir.simulation.common.world import DroneLink
from crazychoir.types import Command


@dataclass
class DelayedLink:
    """A link with a delay: a command sent before step k takes effect at step k + steps.

    A cut takes effect at once.
    """

    link: DroneLink
    """The link of the drone without delay."""
    steps: int
    """Steps of the world between sending and effect."""
    _way: deque[tuple[int, Command]] = field(default_factory=deque)
    _step: int = 0

    def send(self, command: Command) -> None:
        """Put the command into the queue."""
        self._way.append((self._step + self.steps, command))

    def cut(self) -> None:
        """Discard all queued commands and stop the motors for good."""
        self._way.clear()
        self.link.cut()

    def advance(self) -> None:
        """Begin a step of the world: deliver the commands that are due."""
        while self._way and self._way[0][0] <= self._step:
            self.link.send(self._way.popleft()[1])
        self._step += 1
