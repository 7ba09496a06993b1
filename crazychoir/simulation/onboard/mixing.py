"""Power distribution: from the controller's output to the PWM ratios of four motors.

The firmware mixes requests of thrust, without a limit. It turns each into the PWM ratio for the
present battery voltage, and limits the ratios.

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
    """Request of thrust_max, and the greatest PWM ratio of a motor."""
    inverse_full_request: float = 1.0 / full_request
    """1 over full_request."""
    voltage_low_pass: float = 0.01
    """Share of a new battery voltage in its low-pass, each ms."""
    least_battery_voltage: float = 2.0
    """V: below this voltage of the battery the motors stop."""
    voltage_tolerance: float = 1e-4
    """V: last step of Newton's method; the error is its square."""
    voltage_passes: int = 8
    """Greatest number of passes of Newton's method."""


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
def distribute(fw: Record) -> None:
    """Write the thrust that the controller asks of each motor: integers, 65535 for thrust_max.

    A request has no limit: it may exceed 65535 or be negative. Source: crazyflie-firmware,
    power_distribution_quadrotor.c.
    """
    if fw.output == OUTPUT_KINDS.legacy:
        _mix_legacy(fw)
    elif fw.output == OUTPUT_KINDS.force_torque:
        _mix_force_torque(fw)
    else:
        for i in range(4):
            fw.request[i] = fw.law_motors[i]
    for i in range(4):
        fw.request[i] = float(np.trunc(fw.request[i]))


@kernel()
def _compute_thrust(fw: Record, v: float) -> float:
    """Return the thrust in N of one motor at v V: c0 + c1 v + c2 v^2 + c3 v^3."""
    f: float = fw.c0 + v * (fw.c1 + v * (fw.c2 + v * fw.c3))
    return f


@kernel()
def _compute_newton_step(fw: Record, v: float, request: float) -> float:
    """Return the step of Newton's method from v V towards the voltage of the requested thrust.

    A request below thrust_min leads to the voltage of thrust_min.
    """
    f: float = max(
        request * (fw.thrust_max * POWER_DISTRIBUTION.inverse_full_request),
        fw.thrust_min,
    )
    slope: float = fw.c1 + v * (2.0 * fw.c2 + 3.0 * v * fw.c3)
    return (f - _compute_thrust(fw, v)) / slope


@kernel()
def _find_voltages(fw: Record) -> None:
    """Write the voltages at which the motors give the requested thrusts.

    Newton's method starts from the last voltages. The thrust rises with the voltage everywhere,
    and it converges in one or two passes in flight. All motors make a pass together, so that none
    waits for another.
    """
    r = fw.request
    v = fw.volts
    for _ in range(POWER_DISTRIBUTION.voltage_passes):
        s0 = _compute_newton_step(fw, v[0], r[0])
        s1 = _compute_newton_step(fw, v[1], r[1])
        s2 = _compute_newton_step(fw, v[2], r[2])
        s3 = _compute_newton_step(fw, v[3], r[3])
        v[0] += s0
        v[1] += s1
        v[2] += s2
        v[3] += s3
        largest = max(max(abs(s0), abs(s1)), max(abs(s2), abs(s3)))
        if largest < POWER_DISTRIBUTION.voltage_tolerance:
            break


@kernel()
def _compensate_battery(fw: Record) -> None:
    """Write the PWM ratios at which the motors give the requested thrusts, without a limit.

        ratio = 65535 V(f) / v_low,  0 for f < thrust_min or v_low < 2 V

    f: N: requested thrust; V is the inverse of the thrust over the voltage
    v_low: V: low-passed voltage of the battery
    Source: crazyflie-firmware, motors.c.
    """
    _find_voltages(fw)
    least = fw.thrust_min * POWER_DISTRIBUTION.full_request / fw.thrust_max
    scale = (
        POWER_DISTRIBUTION.full_request / fw.vbat_low
        if fw.vbat_low >= POWER_DISTRIBUTION.least_battery_voltage
        else 0.0
    )
    for i in range(4):
        fw.uncapped_ratio[i] = (
            float(np.trunc(fw.volts[i] * scale)) if fw.request[i] >= least else 0.0
        )


@kernel()
def _cap_ratios(fw: Record) -> None:
    """Reduce all PWM ratios by the excess of the highest over 65535, then raise them to idle.

    The differences stay, and so do the torques, if no motor comes to idle.
    """
    u = fw.uncapped_ratio
    excess = max(
        max(max(u[0], u[1]), max(u[2], u[3])) - POWER_DISTRIBUTION.full_request, 0.0
    )
    for i in range(4):
        fw.ratio[i] = max(u[i] - excess, fw.idle)


@kernel()
def _override_ratios(fw: Record) -> None:
    """Replace the PWM ratios by those of the parameters motorPowerSet."""
    if fw.power_set == 1:
        fw.ratio[0] = fw.power_1
        fw.ratio[1] = fw.power_2
        fw.ratio[2] = fw.power_3
        fw.ratio[3] = fw.power_4
    elif fw.power_set == 2:
        for i in range(4):
            fw.ratio[i] = fw.power_1


@kernel()
def drive_motors(fw: Record, allowed: bool) -> None:
    """Write the PWM ratio of each motor, 0..65535; all are 0 if the supervisor forbids motors.

    The parameters motorPowerSet override it, even if the supervisor forbids motors.
    Source of the order: crazyflie-firmware, stabilizer.c.
    """
    if allowed:
        distribute(fw)
        _compensate_battery(fw)
        _cap_ratios(fw)
    else:
        for i in range(4):
            fw.ratio[i] = 0.0
    _override_ratios(fw)


@kernel()
def compute_shares(fw: Record) -> None:
    """Write what the motors give at their PWM ratios, as shares of thrust_max, above 1 as well.

        share = F(ratio / 65535 v) / thrust_max,  0 if F < thrust_min

    F: N: thrust of a motor at a voltage; the curve says nothing below thrust_min
    v: V: voltage of the battery
    """
    scale = fw.vbat * POWER_DISTRIBUTION.inverse_full_request
    for i in range(4):
        thrust = _compute_thrust(fw, fw.ratio[i] * scale)
        turns = thrust >= fw.thrust_min
        fw.motors[i] = thrust * (1.0 / fw.thrust_max) if turns else 0.0
