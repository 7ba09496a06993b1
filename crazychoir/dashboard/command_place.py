"""The place on the network from which the operators of a page observe and give commands."""

from typing import Protocol

from crazychoir.bus.commands import Commander
from crazychoir.bus.port import Bus
from crazychoir.config.swarm_config import SwarmConfig
from crazychoir.runtime.clock import Clock


class CommandPlace(Protocol):
    """A place on the network that can send commands to the drones of a swarm."""

    clock: Clock
    config: SwarmConfig
    commander: Commander

    def is_there(self, i: int) -> bool:
        """Return whether an agent answers for drone i."""
        ...

    @property
    def replays(self) -> bool:
        """Whether the messages come from a recording."""
        ...


class PageLink(Protocol):
    """The part of a network connection that the page needs."""

    bus: Bus


class PagePlace(CommandPlace, Protocol):
    """A place on the network that observes and commands."""

    address: int

    @property
    def link(self) -> PageLink:
        """Its connection to the network."""
        ...
