"""The reports of a drone behind a radio, for the safety table and the check before take-off."""

import math

from crazychoir.bus.port import Port
from crazychoir.bus.topics import DRONE_TOPICS
from crazychoir.firmware.supervision import SUPERVISOR_BITS
from crazychoir.platforms import Firmware
from crazychoir.runtime.actor import RESTART_ON_FAILURE, Actor
from crazychoir.runtime.mailbox import Latest
from crazychoir.safety.rules.guard import Guard
from crazychoir.types import LinkStatus

MENTIONED_SILENCE = 0.5
"""Seconds without a packet that are mentioned when a drone has fallen."""
MENTIONED_SILENCE_TIME = 5.0
"""Seconds for which such a gap is still mentioned after it has ended."""


class RadioWatch(Actor):
    """Reports link, battery and attitude of one drone to its guard, ten times a second.

    port: the port of the drone
    source: the address that publishes DRONE_TOPICS.link
    guard: of the drone
    firmware: of its platform: which battery voltages are low and critical
    """

    name = "radio watch"
    restart = RESTART_ON_FAILURE

    def __init__(
        self, port: Port, source: int, guard: Guard, firmware: Firmware
    ) -> None:
        self.port = port
        self.guard = guard
        self.clock = port.bus.clock
        self.firmware = firmware
        self._status: Latest[LinkStatus] = Latest(
            self.clock, f"drone {port.address} link", DRONE_TOPICS.link.max_age
        )
        self._low_since = math.inf
        self._heard_at = -math.inf
        self._gap = 0.0
        self._gap_ended = -math.inf
        port.bus.subscribe(DRONE_TOPICS.link, source, port.address, self._status)

    async def run(self) -> None:
        """Report at the rate of DRONE_TOPICS.link."""
        async for _ in self.clock.ticks(
            DRONE_TOPICS.link.rate, drone=self.port.address
        ):
            self.look()

    def look(self) -> None:
        """Report the newest link status to the guard."""
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
            now - self._heard_at,
            self._gap if now - self._gap_ended < MENTIONED_SILENCE_TIME else 0.0,
        )
        after = (
            f"its radio was silent for {silent:.2f} s, it is "
            if MENTIONED_SILENCE < silent < math.inf
            else ""
        )
        guard.tell(
            "tumbled",
            float(
                bool(
                    status.supervisor
                    & (
                        SUPERVISOR_BITS.tumbled
                        | SUPERVISOR_BITS.locked
                        | SUPERVISOR_BITS.crashed
                    )
                )
            ),
            after,
        )

    def _hear(self, at: float, now: float) -> None:
        """Note that the last packet of the drone came at the time `at`, in s.

        A restarted owner of the dongle has not received a packet yet, but its predecessor has.
        So the time of the last packet never goes back.
        """
        if math.isfinite(self._heard_at) and at - self._heard_at > MENTIONED_SILENCE:
            self._gap = at - self._heard_at
            self._gap_ended = now
        self._heard_at = max(self._heard_at, at)

    def turning(self) -> bool:
        """Return whether the motors turn, by the last report of the firmware; True without one."""
        status = self._status.fresh()
        return status is None or status.flying

    def astray(self) -> str:
        """Return how the body that the cameras take for the drone moved unlike it, else ""."""
        status = self._status.peek()
        return "" if status is None else status.astray

    def problems(self) -> list[str]:
        """Return the reasons why the drone may not take off."""
        status = self._status.fresh()
        if status is None:
            return ["nothing is heard of the owner of its dongle (crazychoir-radio)"]
        return status.problems
