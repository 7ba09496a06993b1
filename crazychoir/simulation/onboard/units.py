"""The only place that converts between SI and the units and signs of the firmware."""

import math

from crazychoir.numerics.kernels import kernel, real
from crazychoir.platforms import Firmware

FULL_THRUST_COMMAND = 65535.0
"""Thrust command at which each motor gives thrust_max newtons."""


FIRMWARE_GRAVITY = 9.81
"""m/s2: gravity in the control laws and the estimator of the firmware."""


@kernel(real, real)
def scale_thrust_to_raw(newtons: float, largest: float) -> float:
    """Return the thrust command for a total thrust in N; linear.

    largest: N: thrust of one motor at FULL_THRUST_COMMAND
    """
    return newtons * FULL_THRUST_COMMAND / (4.0 * largest)


def convert_thrust_to_raw(newtons: float, firmware: Firmware) -> float:
    """Return the thrust command for a total thrust in N; linear, 65535 = 4 thrust_max."""
    return scale_thrust_to_raw(newtons, firmware.thrust_max)


def convert_thrust_to_newtons(raw: float, firmware: Firmware) -> float:
    """Return the thrust of all motors in N for a thrust command."""
    return raw * 4.0 * firmware.thrust_max / FULL_THRUST_COMMAND


@kernel(real, real, real)
def convert_roll_pitch_yaw_rate_to_raw(
    roll: float, pitch: float, yaw_rate: float
) -> tuple[float, float, float]:
    """Convert roll, pitch in rad and yaw rate in rad/s to the numbers of an RPYT packet.

    The arguments are of the body (forward, left, up). The packet has deg and deg/s, with the pitch
    positive nose up and the sign of the yaw rate inverted by the firmware. Roll and pitch rates in
    rad/s are converted in the same way.
    """
    return math.degrees(roll), -math.degrees(pitch), -math.degrees(yaw_rate)
