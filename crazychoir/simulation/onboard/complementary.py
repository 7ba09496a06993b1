"""Estimator 1 of the firmware: attitude by a complementary filter, height by the barometer.

It knows no horizontal position, and heeds no position or pose from outside. Distances downwards
are not modelled.

Source: Mahony, Hamel & Pflimlin 2008, IEEE TAC 53(5), explicit complementary filter; steps and
figures: crazyflie-firmware, sensfusion6.c, estimator_complementary.c and
position_estimator_altitude.c.
"""

import math
from typing import NamedTuple

from crazychoir.numerics.kernels import kernel
from crazychoir.numerics.math3d import Triple, clip, cross, dot
from crazychoir.simulation.onboard.record import Record
from crazychoir.simulation.onboard.units import FIRMWARE_GRAVITY


class ComplementaryPeriods(NamedTuple):
    """Periods of the estimator."""

    attitude_ticks: int = 4
    """Period in ms of the attitude, 250 Hz."""
    attitude_seconds: float = 0.004
    """s: the same period."""
    height_ticks: int = 10
    """Period in ms of the height, 100 Hz."""
    height_seconds: float = 0.01
    """s: the same period."""


COMPLEMENTARY_PERIODS = ComplementaryPeriods()


class RootSettings(NamedTuple):
    """Figures of the firmware's quick inverse square root."""

    offset: float = 0x5F3759DF / 2.0**23
    """Sum of the logarithm of the result and half of that of the argument."""
    bias: int = 127
    """Bias of the exponent of a number of 32 bits."""


ROOT_SETTINGS = RootSettings()


@kernel()
def _invert_root(x: float) -> float:
    """Return 1 / sqrt(x) as the firmware computes it, up to 0.2 % too small.

        L(x) = e + m - 1 + bias,   L(y) = offset - L(x) / 2,   y <- y (3 - x y^2) / 2

    L: logarithm to base 2 that is linear between powers of 2, for x = m 2^e with 1 <= m < 2
    """
    half_mantissa, exponent = math.frexp(x)
    log = exponent + 2.0 * half_mantissa - 2.0 + ROOT_SETTINGS.bias
    target = ROOT_SETTINGS.offset - 0.5 * log
    power = math.floor(target)
    y = math.ldexp(1.0 + target - power, int(power) - ROOT_SETTINGS.bias)
    return y * (1.5 - 0.5 * x * y * y)


@kernel()
def _correct_rates(c: Record, force: Triple) -> Triple:
    """Return what the accelerometer adds to the rates of the gyroscope, rad/s.

        w = k_p e + b,   b <- b + k_i e dt,   e = 1/2 a x g_b

    a: direction of the specific force, body
    g_b: estimated direction upwards, body
    As in the firmware, without an integral gain b is forgotten.
    """
    n = _invert_root(dot(force, force))
    a = (n * force[0], n * force[1], n * force[2])
    half_up = (
        c.qx * c.qz - c.qw * c.qy,
        c.qw * c.qx + c.qy * c.qz,
        c.qw * c.qw - 0.5 + c.qz * c.qz,
    )
    e = cross(a, half_up)
    if c.ki > 0.0:
        gain = c.ki * COMPLEMENTARY_PERIODS.attitude_seconds
        c.bias_x += gain * e[0]
        c.bias_y += gain * e[1]
        c.bias_z += gain * e[2]
    else:
        c.bias_x = c.bias_y = c.bias_z = 0.0
    return (
        c.bias_x + c.kp * e[0],
        c.bias_y + c.kp * e[1],
        c.bias_z + c.kp * e[2],
    )


@kernel()
def _turn(c: Record, rates: Triple) -> None:
    """Turn the attitude: q <- q + dt/2 q (w, 0), then to length 1, and find the upwards direction.

    rates: w, rad/s, body
    """
    half = 0.5 * COMPLEMENTARY_PERIODS.attitude_seconds
    x = half * rates[0]
    y = half * rates[1]
    z = half * rates[2]
    w = c.qw - c.qx * x - c.qy * y - c.qz * z
    qx = c.qx + c.qw * x + c.qy * z - c.qz * y
    qy = c.qy + c.qw * y - c.qx * z + c.qz * x
    qz = c.qz + c.qw * z + c.qx * y - c.qy * x
    n = _invert_root(w * w + qx * qx + qy * qy + qz * qz)
    c.qw = n * w
    c.qx = n * qx
    c.qy = n * qy
    c.qz = n * qz
    c.gravity_x = 2.0 * (c.qx * c.qz - c.qw * c.qy)
    c.gravity_y = 2.0 * (c.qw * c.qx + c.qy * c.qz)
    c.gravity_z = c.qw * c.qw - c.qx * c.qx - c.qy * c.qy + c.qz * c.qz


@kernel()
def _write_attitude(fw: Record) -> None:
    """Write quaternion and angles, deg, into the estimate; the pitch is positive nose up."""
    c = fw.complementary
    fw.qx = c.qx
    fw.qy = c.qy
    fw.qz = c.qz
    fw.qw = c.qw
    fw.roll = math.degrees(math.atan2(c.gravity_y, c.gravity_z))
    fw.pitch = math.degrees(math.asin(clip(c.gravity_x, -1.0, 1.0)))
    fw.yaw = math.degrees(
        math.atan2(
            2.0 * (c.qw * c.qz + c.qx * c.qy),
            c.qw * c.qw + c.qx * c.qx - c.qy * c.qy - c.qz * c.qz,
        )
    )


@kernel()
def _estimate_attitude(fw: Record) -> None:
    """Estimate attitude and vertical acceleration, and integrate this acceleration.

        v <- c_v (v + dt g d(a_z))

    a_z: g: specific force along the estimated vertical, less that of the first estimate
    d: 0 within the dead band, and less by it outside
    """
    c = fw.complementary
    rates = (math.radians(fw.gx), math.radians(fw.gy), math.radians(fw.gz))
    force = (fw.ax, fw.ay, fw.az)
    if dot(force, force) > 0.0:
        added = _correct_rates(c, force)
        rates = (rates[0] + added[0], rates[1] + added[1], rates[2] + added[2])
    _turn(c, rates)
    vertical = dot(force, (c.gravity_x, c.gravity_y, c.gravity_z))
    if not c.calibrated:
        c.base_force = vertical
        c.calibrated = 1
    _write_attitude(fw)
    lift = vertical - c.base_force
    fw.acz = FIRMWARE_GRAVITY * lift
    moving = math.copysign(max(abs(lift) - c.dead_band, 0.0), lift)
    c.speed += moving * COMPLEMENTARY_PERIODS.attitude_seconds * FIRMWARE_GRAVITY
    c.speed *= c.speed_share


@kernel()
def _estimate_height(fw: Record) -> None:
    """Estimate the height above the sea from the barometer and the integrated speed.

        z <- alpha z + (1 - alpha) z_baro + c_v v dt,   v_z = (z - z_before) / dt

    The horizontal position is 0; the horizontal velocity stays.
    """
    c = fw.complementary
    dt = COMPLEMENTARY_PERIODS.height_seconds
    before = c.height
    share = c.height_share if before != 0.0 else 0.0
    c.height = share * before + (1.0 - share) * fw.asl + c.speed_factor * c.speed * dt
    c.climb = (c.height - before) / dt
    fw.x = 0.0
    fw.y = 0.0
    fw.z = c.height
    fw.vz = c.climb


@kernel()
def estimate(fw: Record) -> None:
    """Estimate attitude at 250 Hz and height at 100 Hz from the filtered sensors of this ms."""
    if fw.tick % COMPLEMENTARY_PERIODS.attitude_ticks == 0:
        _estimate_attitude(fw)
    if fw.tick % COMPLEMENTARY_PERIODS.height_ticks == 0:
        _estimate_height(fw)
