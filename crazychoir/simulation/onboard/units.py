"""SI to the firmware's units and signs, and back: the one place."""

import math

from crazychoir.platforms import Firmware

FULL = 65535.0
"""The command of thrust_max newtons a motor."""


def thrust_raw(newtons: float, firmware: Firmware) -> float:
    """The thrust command of a total thrust in N: 65535 = 4 thrust_max, linear."""
    return newtons * FULL / (4.0 * firmware.thrust_max)


def thrust_newtons(raw: float, firmware: Firmware) -> float:
    """N, all motors, of a thrust command."""
    return raw * 4.0 * firmware.thrust_max / FULL


def roll_pitch_yaw_rate_raw(
    roll: float, pitch: float, yaw_rate: float
) -> tuple[float, float, float]:
    """Roll, pitch rad and yaw rate rad/s of the body (forward, left, up) as an RPYT packet carries them.

    In deg and deg/s; there pitch is positive nose up, and the firmware turns the yaw rate's sign. Rates likewise.
    """
    return math.degrees(roll), -math.degrees(pitch), -math.degrees(yaw_rate)
