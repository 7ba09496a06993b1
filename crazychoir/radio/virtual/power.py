"""The state of the battery, as a drone's own power management judges it."""

from dataclasses import dataclass
from enum import IntEnum


class PowerState(IntEnum):
    """Values of pm.state."""

    ON_BATTERY = 0
    """The battery is fine."""
    LOW_POWER = 3
    """The battery is low."""
    SHUTDOWN = 4
    """The battery is so low that the drone switches off."""


@dataclass(frozen=True, slots=True)
class BatteryRules:
    """How the drone's power management judges a voltage."""

    low_time: int = 5000
    """ms for which a voltage must be too low before it counts."""
    charge_levels: tuple[float, ...] = (
        3.00,
        3.78,
        3.83,
        3.87,
        3.89,
        3.92,
        3.96,
        4.00,
        4.04,
        4.10,
    )
    """V from which a cell is 0, 10, ... 90 % full, in the firmware (pm_stm32f4.c)."""


BATTERY_RULES = BatteryRules()


class PowerManagement:
    """Decides whether the battery is low, or critical: a real drone would shut down, this one logs pm.state.

    It is low after `BATTERY_RULES.low_time` below `low` V. It is critical after this time below
    `critical` V.
    """

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
        if now - self._alive > BATTERY_RULES.low_time:
            return PowerState.SHUTDOWN
        return (
            PowerState.LOW_POWER
            if now - self._fine > BATTERY_RULES.low_time
            else PowerState.ON_BATTERY
        )


def battery_level(vbat: float) -> int:
    """Return pm.batteryLevel: %, in steps of 10."""
    return 10 * max(sum(vbat >= least for least in BATTERY_RULES.charge_levels) - 1, 0)
