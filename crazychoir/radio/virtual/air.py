"""The air between a client and a virtual drone.

It has the time of a shared dongle, losses, delays and silence; all may change.
"""

import random
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from crazychoir.radio.virtual.faults import Faults
from crazychoir.runtime.clock import NS_PER_SECOND, AlarmPriority, Clock


@dataclass(frozen=True, slots=True)
class AirModel:
    """The capacity and the queues of a virtual dongle."""

    shared_capacity: float = 250.0
    """Exchanges a second of a dongle that several drones share through cflib. This is a figure of
    its users, not measured here.
    """
    single_capacity: float = 1000.0
    """Exchanges a second of a dongle with one drone: also a figure of users."""
    up_queue: int = 25
    """Most packets of one drone that wait at the client's end (a chosen number)."""
    down_queue: int = 120
    """Most packets of one drone that wait on board (the firmware's queue)."""
    lateness_ns: int = NS_PER_SECOND // 10
    """ns by which exchanges may be late on a busy machine and are made up for. A radio does not
    wait for this program.
    """


AIR_MODEL = AirModel()


Deliver = Callable[[], None]
"""Callback that delivers a packet."""


class VirtualDongle:
    """One radio with drones that take turns.

    An exchange carries at most one packet up, and one down on its acknowledgement. A drone with a
    packet to send is polled. A drone with no packet in either direction takes no time.

    drones: ids of the drones
    capacity: exchanges a second; None: by the number of drones
    """

    def __init__(
        self, clock: Clock, drones: Sequence[int], capacity: float | None = None
    ) -> None:
        self.clock = clock
        self.drones = tuple(drones)
        self.capacity = capacity or (
            AIR_MODEL.single_capacity
            if len(self.drones) == 1
            else AIR_MODEL.shared_capacity
        )
        self.exchanges = self.refused = 0
        """Exchanges so far, and packets refused because too many waited."""
        self._up: dict[int, deque[Deliver]] = {i: deque() for i in self.drones}
        self._down: dict[int, deque[Deliver]] = {i: deque() for i in self.drones}
        self._turns = deque(self.drones)
        self._busy = False
        self._free_ns = 0

    def up(self, drone: int, deliver: Deliver) -> bool:
        """Queue a packet for this drone; return False if too many wait."""
        return self._wait(self._up[drone], AIR_MODEL.up_queue, deliver)

    def down(self, drone: int, deliver: Deliver) -> bool:
        """Queue a packet from this drone; return False if too many wait."""
        return self._wait(self._down[drone], AIR_MODEL.down_queue, deliver)

    def _wait(self, queue: deque[Deliver], most: int, deliver: Deliver) -> bool:
        if len(queue) >= most:
            self.refused += 1
            return False
        queue.append(deliver)
        if not self._busy:
            self._begin(self.clock.now_ns())
        return True

    def _begin(self, least_ns: int) -> None:
        """Start the next exchange when the last one has ended, but not before this time.

        least_ns: ns
        """
        self._busy = True
        self._free_ns = max(least_ns, self._free_ns) + round(
            NS_PER_SECOND / self.capacity
        )
        self.clock.call_at(
            self._free_ns,
            self._exchange,
            priority=AlarmPriority.MESSAGE,
            drone=self.drones[0],
        )

    def _exchange(self) -> None:
        """Serve the next drone that has a packet waiting.

        The packet down was waiting before the packet up arrives, so it is delivered first.
        """
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
            self._begin(self.clock.now_ns() - AIR_MODEL.lateness_ns)


class Air:
    """The air between a client and one drone.

    drone: id of the drone
    faults: faults of the link
    dongle: the shared radio; None: exchanges take no time
    seed: seed of the losses
    """

    def __init__(
        self,
        clock: Clock,
        drone: int,
        faults: Faults,
        dongle: VirtualDongle | None = None,
        seed: int = 0,
    ) -> None:
        self.clock = clock
        self.drone = drone
        self.dongle = dongle
        self.faults = faults
        self.up = self.down = self.lost = 0
        """Packets delivered to the drone, packets delivered from it, and lost packets."""
        self._draw = random.Random(f"{seed} {drone}")  # noqa: S311 - simulated losses

    def rise(self, deliver: Deliver) -> None:
        """Send a packet to the drone."""
        if self.dongle is None:
            self._rises(deliver)
        elif not self.dongle.up(self.drone, lambda: self._rises(deliver)):
            self.lost += 1

    def sink(self, deliver: Deliver) -> None:
        """Send a packet from the drone."""
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
            late_ns = self.clock.now_ns() + round(faults.delay * NS_PER_SECOND)
            self.clock.call_at(
                late_ns, deliver, priority=AlarmPriority.MESSAGE, drone=self.drone
            )
        else:
            deliver()
        return True
