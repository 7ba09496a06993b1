"""The air between a client and a virtual drone.

It has the time of a shared dongle, losses, delays and silence; all may change.
"""

import random
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

from crazychoir.config.dongle_plan import RADIO_TRAFFIC, DongleTime
from crazychoir.radio.virtual.faults import Faults
from crazychoir.runtime.clock import NS_PER_SECOND, AlarmPriority, Clock


@dataclass(frozen=True, slots=True)
class AirModel:
    """The queues of a virtual dongle."""

    up_queue: int = 4
    """Most packets of one drone that wait at the client's end: those of a visit.

    A client of a real dongle keeps the others, and replaces old poses and commands. By UDP it does not notice
    that a dongle is late, so all packets beyond a visit are lost. Otherwise, after 1 s without time for this
    program, twelve drones would get poses and commands 0.6 s late for some seconds.
    """
    down_queue: int = 120
    """Most packets of one drone that wait on board (the firmware's queue)."""
    broadcast_queue: int = 25
    """Most different broadcast packets that wait (a chosen number)."""
    gathering_ns: int = NS_PER_SECOND // 500
    """ns for which a broadcast waits for its other packets. A client sends them together, but by UDP
    they arrive one by one.
    """
    lateness_ns: int = NS_PER_SECOND // 10
    """ns by which exchanges may be late on a busy machine and are made up for. A radio does not
    wait for this program.
    """


AIR_MODEL = AirModel()


Deliver = Callable[[], None]
"""Callback that delivers a packet."""


@dataclass
class WaitingBroadcasts:
    """Broadcast packets that wait for the dongle, each with the drones that it is for."""

    since_ns: int = 0
    """ns: when the first of them came."""
    packets: dict[bytes, list[Deliver]] = field(default_factory=dict)
    """Deliveries of each packet, by its content."""

    def add(self, content: bytes, deliver: Deliver, now_ns: int) -> bool:
        """Add a delivery; return False if too many packets wait."""
        if (
            content not in self.packets
            and len(self.packets) >= AIR_MODEL.broadcast_queue
        ):
            return False
        if not self.packets:
            self.since_ns = now_ns
        self.packets.setdefault(content, []).append(deliver)
        return True

    @property
    def due_ns(self) -> int:
        """When the packets may be sent, ns."""
        return self.since_ns + AIR_MODEL.gathering_ns


class VirtualDongle:
    """One radio with drones that take turns.

    An exchange carries at most one packet up, and one down on its acknowledgement. A drone with a
    packet to send is polled. A drone with no packet in either direction takes no time. A visit of a
    drone has several exchanges; the dongle needs time to change to another drone. A broadcast goes
    before the next visit, and is never acknowledged.

    drones: ids of the drones
    capacity: exchanges a second, if each is with another drone; None: by the number of drones
    longest_visit: most exchanges of a visit
    """

    def __init__(
        self,
        clock: Clock,
        drones: Sequence[int],
        capacity: float | None = None,
        longest_visit: int = RADIO_TRAFFIC.longest_visit,
    ) -> None:
        self.clock = clock
        self.drones = tuple(drones)
        self.capacity = capacity or (
            RADIO_TRAFFIC.single_drone_capacity
            if len(self.drones) == 1
            else RADIO_TRAFFIC.shared_capacity
        )
        self.time = DongleTime.of(self.capacity, len(self.drones))
        self.longest_visit = longest_visit
        self.exchanges = self.refused = 0
        """Exchanges so far, and packets refused because too many waited."""
        self.visits = 0
        """Changes to another drone so far."""
        self.broadcasts = self.spreads = 0
        """Broadcast packets so far, and the times that some were sent together."""
        self.busy_ns = 0
        """ns for which the dongle was busy."""
        self._up: dict[int, deque[Deliver]] = {i: deque() for i in self.drones}
        self._down: dict[int, deque[Deliver]] = {i: deque() for i in self.drones}
        self._waiting = WaitingBroadcasts()
        self._turns = deque(self.drones)
        self._visited: int | None = self.drones[0] if len(self.drones) == 1 else None
        self._visit = 0
        self._busy = False
        self._free_ns = 0

    def up(self, drone: int, deliver: Deliver) -> bool:
        """Queue a packet for this drone; return False if too many wait."""
        return self._wait(self._up[drone], AIR_MODEL.up_queue, deliver)

    def down(self, drone: int, deliver: Deliver) -> bool:
        """Queue a packet from this drone; return False if too many wait."""
        return self._wait(self._down[drone], AIR_MODEL.down_queue, deliver)

    def spread(self, content: bytes, deliver: Deliver) -> bool:
        """Queue a broadcast packet for one of its drones; return False if too many wait.

        Equal packets for several drones are one packet in the air.
        """
        is_first = not self._waiting.packets
        if not self._waiting.add(content, deliver, self.clock.now_ns()):
            self.refused += 1
            return False
        if is_first:
            self._wake_at(self._waiting.due_ns)
        return True

    def _wake_at(self, time_ns: int) -> None:
        """Go on at this time, if nothing else keeps the dongle busy then."""
        self.clock.call_at(
            time_ns,
            lambda: self._go_on(self.clock.now_ns()),
            priority=AlarmPriority.MESSAGE,
            drone=self.drones[0],
        )

    def _wait(self, queue: deque[Deliver], most: int, deliver: Deliver) -> bool:
        if len(queue) >= most:
            self.refused += 1
            return False
        queue.append(deliver)
        self._go_on(self.clock.now_ns())
        return True

    def _go_on(self, least_ns: int) -> None:
        """Start what comes next when the last exchange has ended, but not before this time.

        least_ns: ns
        """
        if self._busy:
            return
        start_ns = max(least_ns, self._free_ns)
        contents = list(self._waiting.packets)
        if contents and start_ns >= self._waiting.due_ns:
            self._begin(
                start_ns,
                self.time.broadcast(len(contents)),
                lambda: self._broadcast(contents),
            )
        elif (drone := self._choose_drone()) is not None:
            is_new = drone != self._visited
            self._visit = 1 if is_new else self._visit + 1
            self._visited = drone
            self.visits += is_new
            self._begin(
                start_ns,
                self.time.exchange + is_new * self.time.change,
                lambda: self._exchange(drone),
            )

    def _choose_drone(self) -> int | None:
        """Return the drone of the next exchange: the visited one, or the next in turn."""
        visited = self._visited
        if (
            visited is not None
            and self._has_packets(visited)
            and self._visit < self.longest_visit
        ):
            return visited
        for _ in self.drones:
            drone = self._turns[0]
            self._turns.rotate(-1)
            if self._has_packets(drone):
                return drone
        return None

    def _has_packets(self, drone: int) -> bool:
        return bool(self._up[drone] or self._down[drone])

    def _begin(self, start_ns: int, seconds: float, ends: Callable[[], None]) -> None:
        """Be busy for some time.

        start_ns: ns
        seconds: s
        ends: called at the end
        """
        self._busy = True
        duration_ns = round(seconds * NS_PER_SECOND)
        self.busy_ns += duration_ns
        self._free_ns = start_ns + duration_ns
        self.clock.call_at(
            self._free_ns,
            ends,
            priority=AlarmPriority.MESSAGE,
            drone=self.drones[0],
        )

    def _exchange(self, drone: int) -> None:
        """Exchange packets with a drone.

        The packet down was waiting before the packet up arrives, so it is delivered first.
        """
        self._busy = False
        carried = [
            queue.popleft() for queue in (self._down[drone], self._up[drone]) if queue
        ]
        self.exchanges += 1
        self._end(carried)

    def _broadcast(self, contents: list[bytes]) -> None:
        """Deliver broadcast packets."""
        self._busy = False
        if len(self.drones) > 1:
            self._visited = None
        self.broadcasts += len(contents)
        self.spreads += 1
        carried = [
            deliver
            for content in contents
            for deliver in self._waiting.packets.pop(content)
        ]
        self._end(carried)

    def _end(self, carried: list[Deliver]) -> None:
        """Deliver packets, and start what comes next."""
        for deliver in carried:
            deliver()
        self._go_on(self.clock.now_ns() - AIR_MODEL.lateness_ns)


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

    def spread(self, content: bytes, deliver: Deliver) -> None:
        """Send a broadcast packet to the drone, and to others that get the same one.

        content: of the packet
        """
        if self.dongle is None:
            self._rises(deliver)
        elif not self.dongle.spread(content, lambda: self._rises(deliver)):
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
