"""The battery as a drone's own management of power sees it."""

ON_BATTERY, LOW, SHUTDOWN = 0, 3, 4
"""pm.state."""
PATIENCE = 5000
"""ms that a voltage is too low before it counts."""
LEVELS = (3.00, 3.78, 3.83, 3.87, 3.89, 3.92, 3.96, 4.00, 4.04, 4.10)
"""V from which on a cell is 0, 10, ... 90 % full, by the firmware (pm_stm32f4.c)."""


class Power:
    """Whether the battery is low: below `low` V for PATIENCE, or below `critical` V."""

    def __init__(self) -> None:
        self._fine = self._alive = 0

    def look(self, now: int, vbat: float, low: float, critical: float) -> None:
        """At this ms of uptime it has so many V."""
        self._fine = now if vbat >= low else min(self._fine, now)
        self._alive = now if vbat >= critical else min(self._alive, now)

    def state(self, now: int) -> int:
        """pm.state."""
        if now - self._alive > PATIENCE:
            return SHUTDOWN
        return LOW if now - self._fine > PATIENCE else ON_BATTERY


def level(vbat: float) -> int:
    """pm.batteryLevel: %, in steps of 10."""
    return 10 * max(sum(vbat >= least for least in LEVELS) - 1, 0)
