"""The dead-man option: an operator's console says that it is there; drones that hear none for too long land."""

import asyncio
import contextlib
from collections.abc import Callable

from crazychoir.bus.commands import Commander
from crazychoir.config.swarm_config import SwarmConfig
from crazychoir.runtime.actor import ON_FAILURE, Actor
from crazychoir.runtime.clock import Clock

WATCHED = "watched"
"""The command by which a console says that it is there."""
RATE = 2.0
"""Hz."""


class Console(Actor):
    """Tells every drone that its operator's console is there, for as long as it is."""

    name = "console"
    restart = ON_FAILURE

    def __init__(self, commander: Commander, ids: tuple[int, ...]) -> None:
        self.commander = commander
        self.ids = ids

    async def run(self) -> None:
        """Twice a second; who does not answer keeps the others no longer than that."""
        async for _ in self.commander.port.bus.clock.ticks(RATE):
            await asyncio.gather(*(self._tell(i) for i in self.ids))

    async def _tell(self, i: int) -> None:
        with contextlib.suppress(TimeoutError):
            await self.commander.request(i, WATCHED, 1.0 / RATE)


def is_console(config: SwarmConfig, host: str) -> bool:
    """Whether a process that looks on is to say so: drones count on it, and obey its host."""
    return config.flight.dead_man > 0.0 and (
        not config.secured or host in config.security.operators
    )


class DeadMan(Actor):
    """Lands the drones of a process when they fly and no console has said for `patience` s that it is there.

    A console that is silent because the network is cut has gone, too.
    """

    name = "dead man"
    restart = ON_FAILURE

    def __init__(
        self,
        clock: Clock,
        patience: float,
        flying: Callable[[], bool],
        land: Callable[[str], None],
    ) -> None:
        self.clock = clock
        self.patience = patience
        self.flying = flying
        self.land = land
        self._heard = clock.now()

    def heard(self) -> None:
        """A console is there."""
        self._heard = self.clock.now()

    async def run(self) -> None:
        """Look twice as often as a console speaks, until they land."""
        async for _ in self.clock.ticks(2.0 * RATE):
            if self.flying() and self.clock.now() - self._heard > self.patience:
                self.land(
                    f"no operator's console for {self.patience:g} s (flight.dead_man)"
                )
                return
