"""The state of the battery, as a drone's own power management judges it."""

ON_BATTERY = 0
"""pm.state: the battery is fine."""
LOW = 3
"""pm.state: the battery is low."""
SHUTDOWN = 4
"""pm.state: the battery is so low that the drone switches off."""
PATIENCE = 5000
"""Milliseconds for which a voltage must be too low before it counts."""
LEVELS = (3.00, 3.78, 3.83, 3.87, 3.89, 3.92, 3.96, 4.00, 4.04, 4.10)
"""Volts from which a cell is 0, 10, ... 90 % full, in the firmware (pm_stm32f4.c)."""


class Power:
    """Decides whether the battery is low: for PATIENCE below `low` V, or below `critical` V."""

    def __init__(self) -> None:
        self._fine = self._alive = 0

    def look(self, now: int, vbat: float, low: float, critical: float) -> None:
        """Take the voltage at a time.

        now: ms of uptime
        vbat: V
        low: V
        critical: V
        """
        self._fine = now if vbat >= low else min(self._fine, now)
        self._alive = now if vbat >= critical else min(self._alive, now)

    def state(self, now: int) -> int:
        """Return pm.state at this ms of uptime."""
        if now - self._alive > PATIENCE:
            return SHUTDOWN
        return LOW if now - self._fine > PATIENCE else ON_BATTERY


def level(vbat: float) -> int:
    """Return pm.batteryLevel: %, in steps of 10."""
    return 10 * max(sum(vbat >= least for least in LEVELS) - 1, 0)
