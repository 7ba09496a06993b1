"""The inertial sensors: gyroscope and accelerometer with noise and bias.

Their noise is drawn without the state of a generator.
"""

import math
from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from crazychoir.numerics.kernels import kernel
from crazychoir.numerics.math3d import STANDARD_GRAVITY, clip
from crazychoir.simulation.common.draws import Keys, draw_normals
from crazychoir.types import Vec

# isort: off
from crazychoir.simulation.motor_level.lanes import (
    ACCELEROMETER_X,
    AIRBORNE_FLAG,
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
    gyro_vibration: float = 0.0
    """Density of the gyroscope's additional noise in flight, in rad/s/sqrt(Hz)."""
    acc_vibration: float = 0.0
    """Density of the accelerometer's additional noise in flight, in m/s2/sqrt(Hz)."""

    def scaled(self, noise: float, vibration: float) -> Self:
        """Return sensors with factors on noise and biases, and on the noise in flight."""
        return replace(
            self,
            gyro_noise=noise * self.gyro_noise,
            acc_noise=noise * self.acc_noise,
            gyro_bias=noise * self.gyro_bias,
            acc_bias=noise * self.acc_bias,
            gyro_vibration=vibration * self.gyro_vibration,
            acc_vibration=vibration * self.acc_vibration,
        )

    def deviations(self, h: float) -> tuple[float, float, float, float]:
        """Return the standard deviations of samples taken every h s.

        They are those of the gyroscope in rad/s and of the accelerometer in m/s2 at rest, and of
        both in flight. White noise of density d has the deviation d sqrt(1 / (2 h)).
        """
        share = math.sqrt(0.5 / h)
        return (
            self.gyro_noise * share,
            self.acc_noise * share,
            math.hypot(self.gyro_noise, self.gyro_vibration) * share,
            math.hypot(self.acc_noise, self.acc_vibration) * share,
        )


VIBRATING_IMU = Imu(gyro_vibration=1.1e-3, acc_vibration=4.9e-3)
"""Sensors in flight on a typical drone.

Behind the firmware's filters of 80 and 30 Hz, this gives 0.011 rad/s and 0.030 m/s2, which 77 flights
of a Crazyflie 2.1 have above 20 Hz (NanoBench, arXiv 2603.09908).
"""


@kernel()
def measure_block(
    m: Vec,
    keys: Keys,
    tick: int,
    at_rest: tuple[float, float],
    in_flight: tuple[float, float],
) -> None:
    """Write the readings of the sensors of a block at a tick.

        gyro = w + b + n,   acc = s + b + n,   s the specific force, body

    The noise is a function of (seed, tick, drone, axis) alone.
    at_rest, in_flight: rad/s, m/s2: standard deviations of n for gyroscope and accelerometer
    """
    for k in range(LANE_COUNT):
        flies = m[AIRBORNE_FLAG + k]
        gyro = at_rest[0] + flies * (in_flight[0] - at_rest[0])
        acc = at_rest[1] + flies * (in_flight[1] - at_rest[1])
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
