"""What lies between a client and a virtual drone: a shared dongle's time, losses, delays, silence; all may change."""

import random
from collections.abc import Callable
from dataclasses import dataclass

from crazychoir.errors import ConfigError
from crazychoir.runtime.clock import MESSAGE, SECOND, Clock

CAPACITY = 250.0
"""Packets a second of one dongle that more than one drone shares, by cflib: figure of its users, not measured here."""
PATIENCE = 0.5
"""s that a packet waits for its turn at most; then it is lost, as cflib's queue is full."""


class Dongle:
    """One radio: packets of all its drones go one after the other.

    A packet down rides on the acknowledgement of one up, once; where none has gone up it takes a turn of its own.
    capacity: packets a second.
    """

    def __init__(self, clock: Clock, capacity: float = CAPACITY) -> None:
        self.clock, self.capacity = clock, capacity
        self.exchanges = self.refused = 0
        self._free_ns = 0
        self._empty: dict[int, int] = {}

    def up(self, drone: int) -> int | None:
        """ns until a packet to this drone has gone; None: too many wait."""
        wait = self._turn()
        if wait is not None:
            self._empty[drone] = self._empty.get(drone, 0) + 1
        return wait

    def down(self, drone: int) -> int | None:
        """ns until a packet from this drone has come; None: too many wait."""
        if self._empty.get(drone, 0) > 0:
            self._empty[drone] -= 1
            return max(self._free_ns - self.clock.now_ns(), 0)
        return self._turn()

    def _turn(self) -> int | None:
        now_ns = self.clock.now_ns()
        start_ns = max(now_ns, self._free_ns)
        if start_ns - now_ns > PATIENCE * SECOND:
            self.refused += 1
            return None
        self._free_ns = start_ns + round(SECOND / self.capacity)
        self._empty = {drone: min(n, 1) for drone, n in self._empty.items()}
        self.exchanges += 1
        return self._free_ns - now_ns


@dataclass
class Faults:
    """Of the link of one drone. loss: probability a packet, each way;  delay: s, each way;  silent: nothing passes."""

    loss: float = 0.0
    delay: float = 0.0
    silent: bool = False

    def set(self, name: str, value: float) -> None:
        """Change one; ConfigError for what there is not."""
        allowed = {"loss": (0.0, 1.0), "delay": (0.0, 10.0), "silent": (0.0, 1.0)}
        if name not in allowed:
            raise ConfigError("fault", name, ", ".join(allowed))
        low, high = allowed[name]
        if not low <= value <= high:
            raise ConfigError(f"fault {name}", value, f"{low:g} to {high:g}")
        setattr(self, name, bool(value) if name == "silent" else value)


class Air:
    """The way of one drone's packets. dongle: whose time it takes, None: that of nobody;  seed: of the losses."""

    def __init__(self, clock: Clock, drone: int, dongle: Dongle | None = None, seed: int = 0) -> None:
        self.clock, self.drone, self.dongle, self.faults = clock, drone, dongle, Faults()
        self.lost = 0
        self._draw = random.Random(f"{seed} {drone}")  # noqa: S311 - of a simulated loss

    def up(self, deliver: Callable[[], None]) -> None:
        """Let a packet go to the drone."""
        self._pass(None if self.dongle is None else self.dongle.up(self.drone), deliver)

    def down(self, deliver: Callable[[], None]) -> None:
        """Let a packet come from the drone."""
        self._pass(None if self.dongle is None else self.dongle.down(self.drone), deliver)

    def _pass(self, wait_ns: int | None, deliver: Callable[[], None]) -> None:
        faults = self.faults
        full = self.dongle is not None and wait_ns is None
        if full or faults.silent or (faults.loss > 0.0 and self._draw.random() < faults.loss):
            self.lost += 1
            return
        late_ns = (wait_ns or 0) + round(faults.delay * SECOND)
        if late_ns == 0:
            deliver()
        else:
            self.clock.call_at(self.clock.now_ns() + late_ns, deliver, priority=MESSAGE, drone=self.drone)
