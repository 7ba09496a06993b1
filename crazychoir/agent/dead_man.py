"""The dead-man option: drones land when they hear no operator's console for too long."""

import asyncio
import contextlib
from collections.abc import Callable

from crazychoir.bus.commands import Commander
from crazychoir.config.swarm_config import SwarmConfig
from crazychoir.runtime.actor import RESTART_ON_FAILURE, Actor
from crazychoir.runtime.clock import Clock

WATCHED_COMMAND = "watched"
"""The command with which a console reports that it is there."""
WATCHED_RATE = 2.0
"""Hz: rate of these commands."""


class ConsoleReporter(Actor):
    """Reports to every drone that its operator's console is there."""

    name = "console"
    restart = RESTART_ON_FAILURE

    def __init__(self, commander: Commander, ids: tuple[int, ...]) -> None:
        self.commander = commander
        self.ids = ids

    async def run(self) -> None:
        """Report WATCHED_RATE times a second.

        A drone that does not answer delays the others by one period at most.
        """
        async for _ in self.commander.port.bus.clock.ticks(WATCHED_RATE):
            await asyncio.gather(*(self._tell(i) for i in self.ids))

    async def _tell(self, i: int) -> None:
        with contextlib.suppress(TimeoutError):
            await self.commander.request(i, WATCHED_COMMAND, 1.0 / WATCHED_RATE)


def is_console(config: SwarmConfig, host: str) -> bool:
    """Return whether an observing process must report as a console.

    It must if drones depend on consoles, and obey the host of the process.
    """
    return config.flight.dead_man > 0.0 and (
        not config.secured or host in config.security.operators
    )


class DeadMan(Actor):
    """Lands the drones of a process when they fly and no console has reported for `patience` s.

    A console that is silent because the network is cut counts as gone, too.

    clock: the clock of the swarm.
    patience: s.
    flying: returns whether any drone of the process flies.
    land: lands them, with a reason.
    """

    name = "dead man"
    restart = RESTART_ON_FAILURE

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
        """Record that a console is there."""
        self._heard = self.clock.now()

    async def run(self) -> None:
        """Check twice as often as a console reports, until the drones land."""
        async for _ in self.clock.ticks(2.0 * WATCHED_RATE):
            if self.flying() and self.clock.now() - self._heard > self.patience:
                self.land(
                    f"no operator's console for {self.patience:g} s (flight.dead_man)"
                )
                return
