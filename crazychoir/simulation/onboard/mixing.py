"""Power distribution: the controller's output as four motors, at the present battery voltage.

Motors in a cross: 0 front right, 1 back right, 2 back left, 3 front left. Motors 0 and 2 turn the
body towards a negative yaw.
"""

from typing import NamedTuple

import numpy as np

from crazychoir.numerics.kernels import kernel
from crazychoir.simulation.onboard.record import OUTPUT_KINDS, Record


class PowerDistribution(NamedTuple):
    """Figures of the power distribution."""

    full_request: float = 65535.0
    """Greatest request of a motor."""
    inverse_full_request: float = 1.0 / full_request
    """1 over the greatest request of a motor."""
    voltage_low_pass: float = 0.01
    """Share of a new battery voltage in its low-pass, each ms."""
    voltage_tolerance: float = 1e-9
    """Relative difference of battery and low-pass below which they count as equal."""


POWER_DISTRIBUTION = PowerDistribution()


@kernel()
def _mix_legacy(fw: Record) -> None:
    """Mix the legacy output: m = T -/+ roll/2 +/- pitch/2 +/- yaw; pitch positive nose up.

    The halves are truncated to integers.
    """
    r = float(np.trunc(0.5 * fw.roll_out))
    p = float(np.trunc(0.5 * fw.pitch_out))
    t = fw.thrust
    y = fw.yaw_out
    fw.request[0] = t - r + p + y
    fw.request[1] = t - r - p - y
    fw.request[2] = t + r - p + y
    fw.request[3] = t + r + p - y


@kernel()
def _mix_force_torque(fw: Record) -> None:
    """Mix force and torques: f = T/4 -/+ tx/(4 a) -/+ ty/(4 a) -/+ tz/(4 k), not below 0.

    a: m: arm along x
    k: m: torque of a thrust of 1 N
    """
    per_newton = POWER_DISTRIBUTION.full_request / fw.thrust_max
    t = 0.25 * fw.force
    r = 0.25 * fw.torque_x / fw.arm
    p = 0.25 * fw.torque_y / fw.arm
    y = 0.25 * fw.torque_z / fw.torque_ratio
    fw.request[0] = max(t - r - p - y, 0.0) * per_newton
    fw.request[1] = max(t - r + p + y, 0.0) * per_newton
    fw.request[2] = max(t + r + p - y, 0.0) * per_newton
    fw.request[3] = max(t + r - p + y, 0.0) * per_newton


@kernel()
def _cap_requests(fw: Record) -> None:
    """Reduce all motors by the excess of the highest over 65535, so that the torques stay.

    Then raise motors below idle to idle.
    """
    m = fw.request
    excess = max(
        max(max(m[0], m[1]), max(m[2], m[3])) - POWER_DISTRIBUTION.full_request, 0.0
    )
    for i in range(4):
        m[i] = max(m[i] - excess, fw.idle)


@kernel()
def _write_requests(fw: Record, allowed: bool) -> None:
    """Write the motor requests of the controller; all are 0 if the supervisor forbids motors."""
    if not allowed:
        for i in range(4):
            fw.request[i] = 0.0
        return
    if fw.output == OUTPUT_KINDS.legacy:
        _mix_legacy(fw)
    elif fw.output == OUTPUT_KINDS.force_torque:
        _mix_force_torque(fw)
    else:
        for i in range(4):
            fw.request[i] = fw.law_motors[i]
    _cap_requests(fw)


@kernel()
def distribute(fw: Record, allowed: bool) -> None:
    """Write the request of each motor, 0..65535.

    The parameters motorPowerSet override it, even if the supervisor forbids motors.
    """
    _write_requests(fw, allowed)
    if fw.power_set == 1:
        fw.request[0] = fw.power_1
        fw.request[1] = fw.power_2
        fw.request[2] = fw.power_3
        fw.request[3] = fw.power_4
    elif fw.power_set == 2:
        for i in range(4):
            fw.request[i] = fw.power_1


@kernel()
def _compute_thrust(fw: Record, v: float) -> float:
    """Return the thrust in N of one motor at v V: c0 + c1 v + c2 v^2 + c3 v^3."""
    f: float = fw.c0 + v * (fw.c1 + v * (fw.c2 + v * fw.c3))
    return f


@kernel()
def _find_voltage(fw: Record, v: float, request: float) -> float:
    """Return the voltage for the requested thrust, at least thrust_min.

    It makes one pass of Newton's method from v, the last result. The curve rises everywhere, and
    the remaining error only matters where the battery differs from its low-pass.
    """
    f: float = max(
        request * (fw.thrust_max * POWER_DISTRIBUTION.inverse_full_request),
        fw.thrust_min,
    )
    slope: float = fw.c1 + v * (2.0 * fw.c2 + 3.0 * v * fw.c3)
    return v - (_compute_thrust(fw, v) - f) / slope


@kernel()
def _compute_share(fw: Record, v: float, request: float, ratio: float) -> float:
    """Return the share of the full thrust of a motor at `ratio` times the voltage v V.

    At v the motor would give its request.
    """
    f = request * (fw.thrust_max * POWER_DISTRIBUTION.inverse_full_request)
    e = ratio - 1.0
    more = (
        v
        * e
        * (
            fw.c1
            + v * (fw.c2 * (1.0 + ratio) + v * fw.c3 * (1.0 + ratio * (1.0 + ratio)))
        )
    )
    g = (
        f + more
        if f < _compute_thrust(fw, fw.vbat_low)
        else _compute_thrust(fw, fw.vbat)
    )
    share: float = 0.0 if f < fw.thrust_min else max(g, 0.0) * (1.0 / fw.thrust_max)
    return share


@kernel()
def compensate(fw: Record) -> None:
    """Write the share of the full thrust that each motor gives.

        f = request / 65535 thrust_max, 0 below thrust_min
        duty = V(f) / v_low <= 1
        share = F(duty v) / thrust_max

    F: N: thrust of the motor at a voltage; V is its inverse
    v: V: voltage of the battery
    v_low: V: low-passed voltage of the battery
    All four motors are computed before one is written, and without branches, so that none waits
    for another.
    """
    r = fw.request
    v = fw.volts
    ratio = fw.vbat / fw.vbat_low
    if abs(ratio - 1.0) < POWER_DISTRIBUTION.voltage_tolerance:
        ratio = 1.0
    else:
        v[0] = _find_voltage(fw, v[0], r[0])
        v[1] = _find_voltage(fw, v[1], r[1])
        v[2] = _find_voltage(fw, v[2], r[2])
        v[3] = _find_voltage(fw, v[3], r[3])
    fw.motors[0] = _compute_share(fw, v[0], r[0], ratio)
    fw.motors[1] = _compute_share(fw, v[1], r[1], ratio)
    fw.motors[2] = _compute_share(fw, v[2], r[2], ratio)
    fw.motors[3] = _compute_share(fw, v[3], r[3], ratio)
