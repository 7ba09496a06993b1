"""The faults of virtual drones: what they do to the bodies, the batteries and the firmware."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from crazychoir.errors import ConfigError
from crazychoir.radio.virtual.faults import Faults, check_faults
from crazychoir.radio.virtual.port import DronePort
from crazychoir.simulation.motor_level.battery import OPEN_CIRCUIT_CURVE
from crazychoir.simulation.motor_level.crazyflies import CrazyflieWorld
from crazychoir.types import Vec

SHOWN_ERROR_SIZE = 40
"""Most characters of wrong words, and most drones, in an error."""


@dataclass(frozen=True, slots=True)
class FaultEffects:
    """How faults act on a body and its battery."""

    least_charge: float = 1e-3
    """Least charge of a battery, from 0 to 1."""
    tumble_rate: float = 15.0
    """rad/s: roll rate of a body that tumbles; cameras can follow it."""
    upside_down_cosine: float = -0.9
    """Cosine of the tilt of a body that lies on its back."""


FAULT_EFFECTS = FaultEffects()


class FaultControl:
    """Sets the faults of virtual drones, and lets them act on the world.

    faults: faults by drone, changed in place
    ports: ports by drone
    """

    def __init__(
        self,
        world: CrazyflieWorld,
        ports: Mapping[int, DronePort],
        faults: Mapping[int, Faults],
    ) -> None:
        self._world = world
        self._ports = ports
        self._faults = faults

    def hold(self) -> None:
        """Hold the batteries at their voltage and the bodies on their backs, as faults demand."""
        for i, fault in self._faults.items():
            if fault.tumble:
                overturn(self._world.states[self._world.row[i]])
            if fault.voltage > 0.0:
                self._world.charge_to(
                    i,
                    charge_at_voltage(
                        fault.voltage, self._world.platforms[self._world.row[i]].battery
                    ),
                )

    def set_faults(self, wanted: Any) -> None:
        """Set all faults, or none if one is not allowed."""
        if not isinstance(wanted, dict) or not all(
            isinstance(row, dict) for row in wanted.values()
        ):
            raise ConfigError("faults", wanted, "{id: {name: value}}")
        found = [
            (i, check_faults(row, tuple(self._ports)))
            for drone_text, row in wanted.items()
            for i in self._find_drones(drone_text)
        ]
        for i, row in found:
            for name, value in row.items():
                self._put(i, name, value)

    def _find_drones(self, drone_text: str) -> list[int]:
        """Return the drones of "all", "3" or "3,4"."""
        if drone_text == "all":
            return list(self._ports)
        names = {str(i): i for i in self._ports}
        words = [
            word.strip().lstrip("0") or "0"
            for word in drone_text.split(",")
            if word.strip()
        ]
        unknown = [word for word in words if word not in names]
        if unknown or not words:
            there = [*names][:SHOWN_ERROR_SIZE]
            left = (
                [f"and {len(names) - SHOWN_ERROR_SIZE} more"]
                if len(names) > SHOWN_ERROR_SIZE
                else []
            )
            raise ConfigError(
                "faults: drone",
                ", ".join(unknown)[:SHOWN_ERROR_SIZE],
                ", ".join(["all", *there, *left]),
            )
        return [names[word] for word in dict.fromkeys(words)]

    def _put(self, i: int, name: str, value: Any) -> None:
        """Set one fault of drone i, or do at once what has no duration."""
        drone = self._ports[i].drone
        fault = self._faults[i]
        if name == "reboot":
            if value:
                drone.restart()
        elif name == "home":
            if value:
                self.carry_home(i)
        elif name == "mend":
            if value:
                self._world.forget_fall(i)
        elif name == "swap":
            self._swap(i, int(value))
        else:
            changed = getattr(fault, name) != value
            setattr(fault, name, value)
            if name == "refuse_arming":
                drone.refuse_arming(bool(value))
            elif name == "off" and changed:
                drone.restart()
        if name in ("motor", "off"):
            self._world.turn(
                i, [not fault.off and k + 1 != fault.motor for k in range(4)]
            )

    def carry_home(self, i: int) -> None:
        """Put the body of drone i back at its home, with the motors that its faults leave."""
        self._world.restore(i)
        self._put(i, "motor", self._faults[i].motor)

    def _swap(self, i: int, j: int) -> None:
        """Exchange the poses of i and j, and undo any earlier exchange of either.

        j: the other drone; -1: only undo
        """
        for k in (i, j):
            if k in self._faults and (old := int(self._faults[k].swap)) >= 0:
                self._faults[k].swap = self._faults[old].swap = -1.0
        if j >= 0 and i != j:
            self._faults[i].swap = float(j)
            self._faults[j].swap = float(i)


def charge_at_voltage(volts: float, battery: Any) -> float:
    """Return the charge, 0 to 1 but not empty, at which a cell at rest has this voltage.

    volts: V
    battery: battery of the platform
    """
    x = (volts - battery.empty) / (battery.full - battery.empty)
    return max(
        float(
            np.interp(
                x, OPEN_CIRCUIT_CURVE, np.linspace(0.0, 1.0, len(OPEN_CIRCUIT_CURVE))
            )
        ),
        FAULT_EFFECTS.least_charge,
    )


def overturn(x: Vec) -> None:
    """Roll a body until it lies on its back, and hold it there.

    x: (13,) state, changed in place
    """
    upright = 1.0 - 2.0 * (x[6] ** 2 + x[7] ** 2) > FAULT_EFFECTS.upside_down_cosine
    x[10:13] = (FAULT_EFFECTS.tumble_rate if upright else 0.0, 0.0, 0.0)
