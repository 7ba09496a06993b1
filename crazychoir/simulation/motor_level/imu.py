"""The inertial sensors: gyroscope and accelerometer with noise and bias.

Their noise is drawn without the state of a generator.
"""

import math
from dataclasses import dataclass

import numpy as np

from crazychoir.numerics.kernels import kernel
from crazychoir.numerics.math3d import STANDARD_GRAVITY, clip
from crazychoir.simulation.common.draws import Keys, draw_normals
from crazychoir.types import Vec

# isort: off
from crazychoir.simulation.motor_level.lanes import (
    ACCELEROMETER_X,
    GYROSCOPE_BIAS_X,
    ACCELEROMETER_BIAS_X,
    GYROSCOPE_X,
    LANE_COUNT,
    SPECIFIC_FORCE_X,
    RATE_X,
)
# isort: on

GYRO_RANGE = math.radians(2000.0)  # rad/s: largest rate that the gyroscope reports
ACC_RANGE = (
    24.0 * STANDARD_GRAVITY
)  # m/s2: largest acceleration that the accelerometer reports


@dataclass(frozen=True)
class Imu:
    """Noise and bias of a BMI088, from its data sheet (Bosch Sensortec BST-BMI088-DS001).

    The sheet allows a bias of 1 deg/s for the gyroscope; the firmware measures it on the floor and
    subtracts it. What is left is the sheet's 0.015 deg/s/K, for 5 K of warming up.
    """

    gyro_noise: float = math.radians(0.014)
    """Noise density of the gyroscope in rad/s/sqrt(Hz)."""
    acc_noise: float = 190e-6 * STANDARD_GRAVITY
    """Noise density of the accelerometer in m/s2/sqrt(Hz), for its worst axis."""
    gyro_bias: float = math.radians(0.075)
    """Largest bias of an axis of the gyroscope, in rad/s."""
    acc_bias: float = 0.020 * STANDARD_GRAVITY
    """Largest bias of an axis of the accelerometer, in m/s2."""

    def deviations(self, h: float) -> tuple[float, float]:
        """Return the standard deviations in rad/s and m/s2 of samples taken every h s.

        White noise of density d has the deviation d sqrt(1 / (2 h)).
        """
        return self.gyro_noise * math.sqrt(0.5 / h), self.acc_noise * math.sqrt(0.5 / h)


@kernel()
def measure_block(m: Vec, keys: Keys, tick: int, gyro: float, acc: float) -> None:
    """Write the readings of the sensors of a block at a tick.

        gyro = w + b + n,   acc = s + b + n,   s the specific force, body

    The noise is a function of (seed, tick, drone, axis) alone.
    gyro: rad/s: standard deviation of the gyroscope's noise
    acc: m/s2: standard deviation of the accelerometer's noise
    """
    for k in range(LANE_COUNT):
        for c in range(3):
            n = c * LANE_COUNT + k
            a, b = draw_normals(keys[k], np.uint64(3 * tick + c))
            m[GYROSCOPE_X + n] = clip(
                m[RATE_X + n] + m[GYROSCOPE_BIAS_X + n] + gyro * a,
                -GYRO_RANGE,
                GYRO_RANGE,
            )
            m[ACCELEROMETER_X + n] = clip(
                m[SPECIFIC_FORCE_X + n] + m[ACCELEROMETER_BIAS_X + n] + acc * b,
                -ACC_RANGE,
                ACC_RANGE,
            )
