"""Faults of a virtual drone, its link and the cameras: names, ranges and values."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

from crazychoir.errors import ConfigError

FaultValue = float | tuple[float, ...]
"""Value of a fault: one number or several."""


@dataclass(frozen=True)
class FaultSetting:
    """One fault that can be set."""

    low: float
    """Least value; 0 is allowed too."""
    high: float
    """Largest value."""
    means: str
    """Effect of the fault."""
    size: int = 1
    """Number of numbers in its value."""
    whole: bool = False
    """True if only whole numbers are allowed."""

    @property
    def allowed(self) -> str:
        """The range, as text."""
        if (self.low, self.high, self.whole) == (0, 1, True):
            return "0 or 1"
        kind = "whole numbers" if self.whole else "numbers"
        each = f"{'0, or ' if self.low > 0 else ''}{self.low:g} to {self.high:g}"
        return each if self.size == 1 else f"{self.size} {kind} of {each}"

    def checked(self, name: str, value: Any) -> FaultValue:
        """Return the value. Raises ConfigError if it is not allowed."""
        found = [value] if not isinstance(value, list | tuple) else list(value)
        good = len(found) == self.size and all(self._fits(one) for one in found)
        if not good:
            raise ConfigError(f"fault {name}", value, f"{self.allowed}: {self.means}")
        numbers = tuple(float(one) for one in found)
        return numbers[0] if self.size == 1 else numbers

    def _fits(self, one: Any) -> bool:
        number = isinstance(one, int | float) and (
            one == 0 or self.low <= one <= self.high
        )
        return number and (not self.whole or one == int(one))


def _switch(means: str) -> FaultSetting:
    return FaultSetting(0, 1, means, whole=True)


FAULT_SETTINGS = {
    "loss": FaultSetting(0, 1, "probability that a packet is lost, each way"),
    "delay": FaultSetting(0, 10, "s that a packet is late, each way"),
    "silent": _switch("nothing passes its link, either way; its port stays open"),
    "off": _switch(
        "it is switched off: its port is closed, its motors stand; 0 starts it again"
    ),
    "refuse_arming": _switch("its checks before flight fail"),
    "voltage": FaultSetting(
        3, 4.2, "V of its battery at rest, held there; 0: as it is"
    ),
    "tumble": _switch("its body is turned over, and held so"),
    "motor": FaultSetting(0, 4, "the motor that stands still, 0: none", whole=True),
    "home": _switch("1 carries it home, charged and whole, and stands it there, once"),
    "reboot": _switch("1 restarts it where it lies, once"),
    "mend": _switch("1 forgets its fastest fall, once"),
    "deck_lost": _switch("its deck does not see the lighthouses"),
    "pose_lost": _switch("the cameras do not see it"),
    "offset": FaultSetting(
        -10, 10, "m along x, y, z by which the cameras see it elsewhere", size=3
    ),
    "turned": FaultSetting(
        -math.pi,
        math.pi,
        "rad about its z by which its body is put on, or defined, the wrong way round",
    ),
    "swap": FaultSetting(
        -1,
        9999,
        "the drone that the cameras take for it, and the other way round; -1: none",
        whole=True,
    ),
}
"""All faults, by name."""


@dataclass
class Faults:
    """The faults of one drone; `FAULT_SETTINGS` explains each."""

    loss: float = 0.0
    delay: float = 0.0
    silent: float = 0.0
    off: float = 0.0
    refuse_arming: float = 0.0
    voltage: float = 0.0
    tumble: float = 0.0
    motor: float = 0.0
    deck_lost: float = 0.0
    pose_lost: float = 0.0
    offset: tuple[float, ...] = (0.0, 0.0, 0.0)
    turned: float = 0.0
    swap: float = -1.0

    def listed(self) -> dict[str, Any]:
        """Return all faults, by name."""
        return asdict(self)


def check_faults(
    wanted: Mapping[str, Any], ids: Sequence[int]
) -> dict[str, FaultValue]:
    """Return the faults if all are allowed. Raises ConfigError, with the allowed ones, otherwise.

    wanted: values by name of the fault
    ids: ids of the drones
    """
    found: dict[str, FaultValue] = {}
    for name, value in wanted.items():
        if name not in FAULT_SETTINGS:
            raise ConfigError("fault", name, ", ".join(FAULT_SETTINGS))
        found[name] = FAULT_SETTINGS[name].checked(name, value)
    if "swap" in found and found["swap"] not in (-1.0, *ids):
        raise ConfigError(
            "fault swap", found["swap"], f"-1, or one of {', '.join(map(str, ids))}"
        )
    return found
