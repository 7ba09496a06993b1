"""A running swarm that obeys coroutines."""

import asyncio
from collections.abc import AsyncIterator, Callable, Iterator, Sequence
from contextlib import asynccontextmanager
from typing import Any, overload

from crazychoir.agent.dead_man import ConsoleReporter, is_console
from crazychoir.agent.drone import UNFIT_TASK, WAITING_TASK
from crazychoir.api.running.async_drones import AsyncDrone, AsyncDrones, DroneOrders
from crazychoir.config.network import impairment_changes
from crazychoir.config.swarm_config import SwarmConfig
from crazychoir.config.tables import LinkTable
from crazychoir.launch.network import make_observer_link, run_attached
from crazychoir.launch.observer import Window
from crazychoir.launch.running_swarm import first_process_timeout, running_swarm
from crazychoir.runtime.clock import Clock, WallClock

LOOK_INTERVAL = 0.05
"""s between two looks at what the drones do."""
READY_TIMEOUT = 60.0
"""s for drones to get ready. A drone that is not ready then refuses commands, and says why."""
LANDING_ACCEPT_TIME = 5.0
"""s in which the drones of a run that ends must accept that they land."""


class AsyncSwarm(AsyncDrones):
    """All drones of a running swarm. `swarm[3]` is one of them, `swarm[[1, 2]]` are some.

    window: place in the network of the swarm
    """

    def __init__(self, window: Window) -> None:
        super().__init__(DroneOrders(window), window.config.ids)
        self.window = window
        """Place in the network of the swarm."""

    @property
    def config(self) -> SwarmConfig:
        """The swarm file of this flight."""
        return self.window.config

    @overload
    def __getitem__(self, which: int | str) -> AsyncDrone: ...
    @overload
    def __getitem__(self, which: Sequence[int | str]) -> AsyncDrones: ...
    def __getitem__(
        self, which: int | str | Sequence[int | str]
    ) -> AsyncDrone | AsyncDrones:
        """Return one drone, or several, by ids or names.

        Raises ConfigError for a drone that is not there.
        """
        find = self.config.find_drones
        if isinstance(which, int | str):
            return AsyncDrone(self._orders, find((which,), "swarm[i]"))
        return AsyncDrones(self._orders, find(which, "swarm[ids]"))

    def __iter__(self) -> Iterator[AsyncDrone]:
        return (self[i] for i in self.ids)

    def __len__(self) -> int:
        return len(self.ids)

    async def impair(
        self,
        loss: float | None = None,
        delay: float | None = None,
        jitter: float | None = None,
        edge: tuple[int, int] | None = None,
        drone: int | None = None,
        clear: bool = False,
    ) -> dict[int, Any]:
        """Change the simulated network between the drones, and return what each drone simulates.

        loss: probability that a message is lost
        delay: s
        jitter: s
        edge: only between these two drones
        drone: only at this drone
        clear: whether to undo all changes first
        """
        scope: dict[str, Any] = {"edge": edge, "drone": drone, "clear": clear or None}
        given = {key: value for key, value in scope.items() if value is not None}
        changes = impairment_changes(LinkTable(loss=loss, delay=delay, jitter=jitter))
        found = await self._orders.ask("impair", self.ids, **given, **changes)
        return dict(found)

    async def wait_until_ready(self, has_ended: Callable[[], bool]) -> None:
        """Wait until no drone prepares or waits for the others, at most READY_TIMEOUT s.

        has_ended: whether the run has ended; then nothing is waited for
        """
        clock = self.window.clock
        ends = clock.now() + READY_TIMEOUT
        while not (has_ended() or self._all_ready) and clock.now() < ends:
            await clock.sleep(LOOK_INTERVAL)

    @property
    def _all_ready(self) -> bool:
        statuses = self._orders.statuses
        return statuses.keys() >= set(self.ids) and not any(
            status.task in (WAITING_TASK, UNFIT_TASK) for status in statuses.values()
        )

    async def begin_landing(self) -> None:
        """Tell every drone to land, as far as it is there; do not wait until it has landed."""
        window = self.window
        await asyncio.gather(
            *(
                window.order_one(i, "land", LANDING_ACCEPT_TIME, {})
                for i in self.ids
                if window.is_there(i)
            )
        )

    async def clear_stop(self) -> None:
        """Clear an emergency stop."""
        await self.window.emergency_stop(True)

    @property
    def _stopped(self) -> Sequence[int] | None:
        return None


@asynccontextmanager
async def join_swarm(swarm: str | None, console: bool) -> AsyncIterator[AsyncSwarm]:
    """Join a running swarm in the present event loop; leave it at the end.

    swarm: swarm file, or its run on this machine; None as in `running_swarm`
    console: whether this process reports as an operator's console
    Raises Refused if there is none, or if several could be meant.
    """
    clock = WallClock(asyncio.get_running_loop())
    try:
        async with _join(clock, running_swarm(swarm), swarm, console) as joined:
            yield joined
    finally:
        clock.close()


@asynccontextmanager
async def _join(
    clock: Clock, config: SwarmConfig, option: str | None, console: bool
) -> AsyncIterator[AsyncSwarm]:
    link = make_observer_link(clock, config)
    window = Window(clock, config, link, option, first_process_timeout(config))
    reporters = (
        [ConsoleReporter(window.commander, config.ids)]
        if console and is_console(config, link.bus.host)
        else []
    )
    async with run_attached(link, *reporters):
        await window.find()
        yield AsyncSwarm(window)
