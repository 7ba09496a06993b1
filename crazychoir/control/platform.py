"""What a drone is made of: one row a platform, every figure with its source."""

from dataclasses import dataclass

import numpy as np

from crazychoir.math3d import GRAVITY, Vec


@dataclass(frozen=True)
class Platform:
    """Figures of one kind of drone.

    mass: kg;  drag: diagonal of A, kg/s, body axes;  max_thrust: N, all motors;  max_rate: rad/s, body;
    max_landing_speed: m/s, a faster touch-down is a crash;  source: where the figures come from.
    """

    name: str
    mass: float
    drag: tuple[float, float, float]
    max_thrust: float
    max_rate: tuple[float, float, float]
    max_landing_speed: float
    source: str

    @property
    def weight(self) -> float:
        """N."""
        return self.mass * GRAVITY

    @property
    def flat(self) -> Vec:
        """(9,) for the kernels: mass, drag (3), max_thrust, max_rate (3), max_landing_speed."""
        return np.array([self.mass, *self.drag, self.max_thrust, *self.max_rate, self.max_landing_speed])


HOVER_ROTOR_SPEEDS = 4 * 1862.1  # rad/s, sum of four rotors carrying 27 g: Förster's thrust and speed maps

PAPER = Platform(
    name="crazyflie 2.0, 27 g",
    mass=0.027,
    drag=(9.1785e-7 * HOVER_ROTOR_SPEEDS, 9.1785e-7 * HOVER_ROTOR_SPEEDS, 10.311e-7 * HOVER_ROTOR_SPEEDS),
    max_thrust=0.48,
    max_rate=(10.0, 10.0, 5.0),
    max_landing_speed=1.0,
    source="mass: the CrazyChoir paper; drag per rotor speed: Förster 2015, ETH Zürich, at the rotor speed of hover; "
    "thrust: 0.12 N a motor, the firmware's limit; rates and landing speed: chosen",
)
