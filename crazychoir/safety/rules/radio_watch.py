"""What a drone that a radio reaches says of itself, for the safety table and for who wants to take off."""

import math

from crazychoir.bus.port import Port
from crazychoir.bus.topics import LINK
from crazychoir.platforms import Firmware
from crazychoir.runtime.actor import ON_FAILURE, Actor
from crazychoir.runtime.mailbox import Latest
from crazychoir.safety.rules.guard import Guard
from crazychoir.types import LinkStatus

TUMBLED, LOCKED, CRASHED = 1 << 5, 1 << 6, 1 << 7
"""Bits of the firmware's supervisor: it flies no more."""
SILENT, LATELY = 0.5, 5.0
"""s without a packet that are worth a word of who has fallen, and for how many s after them."""


class RadioWatch(Actor):
    """Tells the guard of one drone how its link, its battery and its attitude are, ten times a second.

    source: the address that says LINK;  firmware: of its platform, which knows when a battery is low.
    """

    name = "radio watch"
    restart = ON_FAILURE

    def __init__(
        self, port: Port, source: int, guard: Guard, firmware: Firmware
    ) -> None:
        self.port = port
        self.guard = guard
        self.clock = port.bus.clock
        self.firmware = firmware
        self._status: Latest[LinkStatus] = Latest(
            self.clock, f"drone {port.address} link", LINK.max_age
        )
        self._low_since = math.inf
        self._heard_at = -math.inf
        self._gap = 0.0
        self._gap_ended = -math.inf
        port.bus.subscribe(LINK, source, port.address, self._status)

    async def run(self) -> None:
        """As often as it is said."""
        async for _ in self.clock.ticks(LINK.rate, drone=self.port.address):
            self.look()

    def look(self) -> None:
        """Tell what is known now."""
        status = self._status.peek()
        if status is None:
            return
        now = self.clock.now()
        guard = self.guard
        self._hear(now - status.silence - self._status.age(), now)
        guard.tell("link", now - self._heard_at)
        self._low_since = (
            min(self._low_since, now)
            if status.battery < self.firmware.low
            else math.inf
        )
        guard.tell("battery", now - self._low_since, f"{self.firmware.low}")
        missing = self.firmware.critical - status.battery
        guard.tell(
            "empty",
            missing if missing > 0.0 else -math.inf,
            f"{self.firmware.critical}",
        )
        silent = max(
            now - self._heard_at, self._gap if now - self._gap_ended < LATELY else 0.0
        )
        after = (
            f"its radio was silent for {silent:.2f} s, it is "
            if SILENT < silent < math.inf
            else ""
        )
        guard.tell(
            "tumbled",
            float(bool(status.supervisor & (TUMBLED | LOCKED | CRASHED))),
            after,
        )

    def _hear(self, at: float, now: float) -> None:
        """Its last packet came at s; an owner that was started again has not heard it yet, the one before has."""
        if math.isfinite(self._heard_at) and at - self._heard_at > SILENT:
            self._gap = at - self._heard_at
            self._gap_ended = now
        self._heard_at = max(self._heard_at, at)

    def turning(self) -> bool:
        """Whether its motors turn, as its firmware has said last; True while nobody says anything."""
        status = self._status.fresh()
        return status is None or status.flying

    def astray(self) -> str:
        """How what the cameras take for it has moved otherwise than it, empty if it has not."""
        status = self._status.peek()
        return "" if status is None else status.astray

    def problems(self) -> list[str]:
        """Why its drone may not take off."""
        status = self._status.fresh()
        if status is None:
            return ["nothing is heard of the owner of its dongle (crazychoir-radio)"]
        return status.problems
