"""Ticks that many actors share: one alarm of the clock serves all of them."""

import asyncio
from collections.abc import Callable
from dataclasses import dataclass

from crazychoir.runtime.clock import NS_PER_SECOND, Alarm, Clock

AFTER_ALL_DRONES = 1 << 62
"""Drone of an alarm that comes after those of all drones at the same instant."""


@dataclass(eq=False, slots=True)
class _Served:
    """A function that is called at each tick."""

    work: Callable[[], None]
    """The function."""
    failure: "asyncio.Future[None]"
    """Gets the error of the function."""


class SharedTicks:
    """Aligned ticks, see `Clock.ticks`: each calls the functions of all actors in turn.

    An actor awaits `serve` in its `run`. So its supervisor learns of an error of its function and
    may start it again, while the functions of other actors go on. Missed ticks are skipped. A tick
    comes after the alarms of single drones at that instant.

    clock: of the process
    hz: ticks a second
    """

    def __init__(self, clock: Clock, hz: float) -> None:
        self.clock = clock
        self._period_ns = round(NS_PER_SECOND / hz)
        self._due_ns = 0
        self._served: list[_Served] = []
        self._alarm: Alarm | None = None

    async def serve(self, work: Callable[[], None]) -> None:
        """Call the function at each tick, until it fails or the caller is cancelled.

        Raises the error of the function.
        """
        served = _Served(work, self.clock.future())
        self._served.append(served)
        if self._alarm is None:
            self._due_ns = self.clock.find_last_tick(self._period_ns)
            self._set_alarm()
        try:
            await served.failure
        finally:
            self._served.remove(served)
            if not self._served and self._alarm is not None:
                self._alarm.cancel()
                self._alarm = None

    def _set_alarm(self) -> None:
        """Set the alarm of the next tick."""
        behind = (self.clock.now_ns() - self._due_ns) // self._period_ns
        self._due_ns += (behind + 1) * self._period_ns
        self._alarm = self.clock.call_at(
            self._due_ns, self._tick, drone=AFTER_ALL_DRONES
        )

    def _tick(self) -> None:
        """Call all functions; the failure of one does not keep another from its call."""
        for served in tuple(self._served):
            if served.failure.done():
                continue
            try:
                served.work()
            except Exception as error:  # noqa: BLE001 - the actor raises it
                served.failure.set_exception(error)
        self._set_alarm()
