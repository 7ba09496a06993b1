"""The inertial sensors: gyroscope and accelerometer with noise and bias, drawn without a generator's state."""

import math
from dataclasses import dataclass

import numpy as np

from crazychoir.numerics.kernels import kernel
from crazychoir.numerics.math3d import GRAVITY, clip
from crazychoir.simulation.common.draws import Keys, normals
from crazychoir.types import Vec

# isort: off
from crazychoir.simulation.motor_level.lanes import (
    ACCX,
    BIAS1,
    BIAS4,
    GYROX,
    LANES,
    SX,
    WX,
)
# isort: on

GYRO_RANGE, ACC_RANGE = math.radians(2000.0), 24.0 * GRAVITY


@dataclass(frozen=True)
class Imu:
    """A BMI088, by its data sheet (Bosch Sensortec BST-BMI088-DS001): how noisy, and how far from zero at rest.

    gyro_noise: rad/s/sqrt(Hz);  acc_noise: m/s2/sqrt(Hz), the worst axis;  gyro_bias: rad/s, acc_bias: m/s2, bounds of
    what is drawn for a drone's axis. The sheet allows the gyroscope 1 deg/s, which the firmware measures on the floor
    and takes off: what is left is the sheet's 0.015 deg/s/K, for 5 K of warming up.
    """

    gyro_noise: float = math.radians(0.014)
    acc_noise: float = 190e-6 * GRAVITY
    gyro_bias: float = math.radians(0.075)
    acc_bias: float = 0.020 * GRAVITY

    def deviations(self, h: float) -> tuple[float, float]:
        """rad/s and m/s2 of one sample every h s: white noise of density d has the deviation d sqrt(1 / (2 h))."""
        return self.gyro_noise * math.sqrt(0.5 / h), self.acc_noise * math.sqrt(0.5 / h)


@kernel()
def measure(m: Vec, keys: Keys, tick: int, gyro: float, acc: float) -> None:
    """What the sensors of a block say at a tick; gyro rad/s, acc m/s2: standard deviations.

        gyro = w + b + n,   acc = s + b + n,   s the specific force, body

    What is drawn is a function of (seed, tick, drone, axis) alone.
    """
    for k in range(LANES):
        for c in range(3):
            n = c * LANES + k
            a, b = normals(keys[k], np.uint64(3 * tick + c))
            m[GYROX + n] = clip(
                m[WX + n] + m[BIAS1 + n] + gyro * a, -GYRO_RANGE, GYRO_RANGE
            )
            m[ACCX + n] = clip(
                m[SX + n] + m[BIAS4 + n] + acc * b, -ACC_RANGE, ACC_RANGE
            )
