"""What lies between a client and a virtual drone: a shared dongle's time, losses, delays, silence; all may change."""

import random
from collections import deque
from collections.abc import Callable, Sequence

from crazychoir.radio.virtual.faults import Faults
from crazychoir.runtime.clock import MESSAGE, SECOND, Clock

CAPACITY = 250.0
"""Exchanges a second of one dongle that several drones share through cflib: its users' figure, not measured here."""
ALONE = 1000.0
"""Those of a dongle with one drone, likewise."""
UP, DOWN = 25, 120
"""Packets of one drone that wait at most: at the client's end (chosen) and on board (the firmware's queue)."""
BEHIND_NS = SECOND // 10
"""ns by which exchanges may be late on a busy machine, and are made up for: a radio does not wait for our computing."""
Deliver = Callable[[], None]


class Dongle:
    """One radio, whose drones take turns: an exchange carries a packet up, and one down on its acknowledgement.

    At most one each. A drone that has something to say is polled; one with nothing to hear or say takes no time.
    capacity: exchanges a second, None: by the number of its drones.
    """

    def __init__(
        self, clock: Clock, drones: Sequence[int], capacity: float | None = None
    ) -> None:
        self.clock = clock
        self.drones = tuple(drones)
        self.capacity = capacity or (ALONE if len(self.drones) == 1 else CAPACITY)
        self.exchanges = self.refused = 0
        self._up: dict[int, deque[Deliver]] = {i: deque() for i in self.drones}
        self._down: dict[int, deque[Deliver]] = {i: deque() for i in self.drones}
        self._turns = deque(self.drones)
        self._busy = False
        self._free_ns = 0

    def up(self, drone: int, deliver: Deliver) -> bool:
        """Let a packet wait for its way to this drone; False: too many wait."""
        return self._wait(self._up[drone], UP, deliver)

    def down(self, drone: int, deliver: Deliver) -> bool:
        """Let a packet wait for its way from this drone; False: too many wait."""
        return self._wait(self._down[drone], DOWN, deliver)

    def _wait(self, queue: deque[Deliver], most: int, deliver: Deliver) -> bool:
        if len(queue) >= most:
            self.refused += 1
            return False
        queue.append(deliver)
        if not self._busy:
            self._begin(self.clock.now_ns())
        return True

    def _begin(self, least_ns: int) -> None:
        """The next exchange, which begins when the last one has ended, and not before this time."""
        self._busy = True
        self._free_ns = max(least_ns, self._free_ns) + round(SECOND / self.capacity)
        self.clock.call_at(
            self._free_ns, self._exchange, priority=MESSAGE, drone=self.drones[0]
        )

    def _exchange(self) -> None:
        """Serve the next drone that has anything: what goes down has been waiting before what goes up has come."""
        self._busy = False
        for _ in self.drones:
            drone = self._turns[0]
            self._turns.rotate(-1)
            if self._up[drone] or self._down[drone]:
                break
        carried = [
            queue.popleft() for queue in (self._down[drone], self._up[drone]) if queue
        ]
        self.exchanges += 1
        for deliver in carried:
            deliver()
        if not self._busy and any(self._up.values()) | any(self._down.values()):
            self._begin(self.clock.now_ns() - BEHIND_NS)


class Air:
    """The way of one drone's packets. dongle: whose time it takes, None: that of nobody;  seed: of the losses.

    up, down: packets that have come through;  lost: those that have not.
    """

    def __init__(
        self,
        clock: Clock,
        drone: int,
        faults: Faults,
        dongle: Dongle | None = None,
        seed: int = 0,
    ) -> None:
        self.clock = clock
        self.drone = drone
        self.dongle = dongle
        self.faults = faults
        self.up = self.down = self.lost = 0
        self._draw = random.Random(f"{seed} {drone}")  # noqa: S311 - of a simulated loss

    def rise(self, deliver: Deliver) -> None:
        """Let a packet go to the drone."""
        if self.dongle is None:
            self._rises(deliver)
        elif not self.dongle.up(self.drone, lambda: self._rises(deliver)):
            self.lost += 1

    def sink(self, deliver: Deliver) -> None:
        """Let a packet come from the drone."""
        if self.dongle is None:
            self._sinks(deliver)
        elif not self.dongle.down(self.drone, lambda: self._sinks(deliver)):
            self.lost += 1

    def _rises(self, deliver: Deliver) -> None:
        if self._passes(deliver):
            self.up += 1

    def _sinks(self, deliver: Deliver) -> None:
        if self._passes(deliver):
            self.down += 1

    def _passes(self, deliver: Deliver) -> bool:
        faults = self.faults
        if faults.silent or (faults.loss > 0.0 and self._draw.random() < faults.loss):
            self.lost += 1
            return False
        if faults.delay > 0.0:
            late_ns = self.clock.now_ns() + round(faults.delay * SECOND)
            self.clock.call_at(late_ns, deliver, priority=MESSAGE, drone=self.drone)
        else:
            deliver()
        return True
