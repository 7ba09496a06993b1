"""The PID of the firmware: the derivative is of the measurement, and the integral is clamped."""

import math
from typing import NamedTuple

from crazychoir.numerics.kernels import kernel
from crazychoir.numerics.math3d import clip
from crazychoir.simulation.onboard.record import Record

# Butterworth low-pass of order 2, 20 Hz at 100 Hz. Numerator: b0, b1 = 2 b0, b2 = b0. Denominator:
# a1, a2.
_PREWARPED_FREQUENCY = math.tan(math.pi * 20.0 / 100.0)
_FILTER_NORM = 1.0 / (
    1.0
    + math.sqrt(2.0) * _PREWARPED_FREQUENCY
    + _PREWARPED_FREQUENCY * _PREWARPED_FREQUENCY
)


class DerivativeFilter(NamedTuple):
    """Butterworth low-pass of order 2, 20 Hz at 100 Hz: b1 = 2 b0 and b2 = b0."""

    b0: float = _PREWARPED_FREQUENCY * _PREWARPED_FREQUENCY * _FILTER_NORM
    """First coefficient of the numerator."""
    a1: float = 2.0 * (_PREWARPED_FREQUENCY * _PREWARPED_FREQUENCY - 1.0) * _FILTER_NORM
    """Second coefficient of the denominator."""
    a2: float = (
        1.0
        - math.sqrt(2.0) * _PREWARPED_FREQUENCY
        + _PREWARPED_FREQUENCY * _PREWARPED_FREQUENCY
    ) * _FILTER_NORM
    """Third coefficient of the denominator."""


DERIVATIVE_FILTER = DerivativeFilter()


TURNS_PER_DEGREE = 1.0 / 360.0  # turns a degree


@kernel()
def wrap_degrees(angle: float) -> float:
    """Return the angle shifted by whole turns to [-180, 180) degrees."""
    if -180.0 <= angle < 180.0:  # nearly always, and faster
        return angle
    return angle - 360.0 * math.floor((angle + 180.0) * TURNS_PER_DEGREE)


@kernel()
def reset(pid: Record, measured: float) -> None:
    """Reset the integral and the filter; the next derivative is taken from this measurement.

    Log variables show no error until the next pass.
    """
    pid.integral = 0.0
    pid.previous = measured
    pid.d1 = 0.0
    pid.d2 = 0.0
    pid.desired = measured
    pid.slope = 0.0


@kernel()
def _sum_terms(
    pid: Record, desired: float, error: float, slope: float, rate: float
) -> float:
    """Return the sum of P, D, the integral including this error, and the feed-forward."""
    pid.desired = desired
    pid.slope = slope
    pid.integral += error * (1.0 / rate)
    if pid.i_limit > 0.0:
        pid.integral = clip(pid.integral, -pid.i_limit, pid.i_limit)
    out = pid.kp * error - pid.kd * slope + pid.ki * pid.integral + pid.kff * desired
    return clip(out, -pid.limit, pid.limit) if pid.limit > 0.0 else out


@kernel()
def _measure_change(pid: Record, measured: float) -> float:
    """Return the change of the measurement since the last step or reset."""
    change: float = measured - pid.previous
    pid.previous = measured
    return change


@kernel()
def follow(pid: Record, desired: float, measured: float, rate: float) -> float:
    """Make one step of the PID.

        e = desired - measured,  I += e dt, |I| <= i_limit
        u = kp e - kd d(measured)/dt + ki I + kff desired

    The integral is clamped before it is multiplied by ki, and u is clamped by `limit`. A limit of
    0 means no limit.
    rate: 1/dt, Hz
    """
    return _sum_terms(
        pid, desired, desired - measured, _measure_change(pid, measured) * rate, rate
    )


@kernel()
def follow_angle(pid: Record, desired: float, measured: float, rate: float) -> float:
    """Make one step of `follow` for an angle in deg, the short way round."""
    error = wrap_degrees(desired - measured)
    return _sum_terms(
        pid, desired, error, wrap_degrees(_measure_change(pid, measured)) * rate, rate
    )


@kernel()
def follow_smooth(pid: Record, desired: float, measured: float, rate: float) -> float:
    """Make one step of `follow` at 100 Hz with a low-passed derivative.

    The low-pass is a Butterworth filter of order 2 at 20 Hz.
    """
    raw = _measure_change(pid, measured) * rate
    slope = DERIVATIVE_FILTER.b0 * raw + pid.d1
    pid.d1 = 2.0 * DERIVATIVE_FILTER.b0 * raw - DERIVATIVE_FILTER.a1 * slope + pid.d2
    pid.d2 = DERIVATIVE_FILTER.b0 * raw - DERIVATIVE_FILTER.a2 * slope
    return _sum_terms(pid, desired, desired - measured, slope, rate)
