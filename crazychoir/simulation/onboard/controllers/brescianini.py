"""Controller 4 of the firmware: Brescianini's attitude control by quaternions, in N and N m."""

import math
from typing import NamedTuple

from crazychoir.numerics.kernels import kernel
from crazychoir.numerics.math3d import (
    Quaternion,
    Triple,
    clip,
    cross,
    dot,
    normalize_quaternion,
    quaternion_conjugate,
    quaternion_product,
    rotation_columns,
)
from crazychoir.simulation.onboard.controllers.attitude import (
    clamp,
    compute_tracking_errors,
)
from crazychoir.simulation.onboard.record import AXIS_MODES, OUTPUT_KINDS, Record
from crazychoir.simulation.onboard.units import FIRMWARE_GRAVITY


class BrescianiniSettings(NamedTuple):
    """Figures of the controller that are not parameters."""

    wanted_rate_ticks: int = 10
    """Period in ms of the wanted rates and thrust, 100 Hz; the torques follow each ms."""
    least_lift: float = 1.0
    """m/s2: least thrust for the mass."""
    most_lift: float = 18.0
    """m/s2: greatest thrust for the mass, and greatest acceleration on each axis."""
    tilt_rate_time: float = 0.015
    """s: time constant of the rates of roll and pitch."""
    yaw_rate_time: float = 0.0075
    """s: time constant of the rate of yaw."""
    fastest_tilt: float = 30.0
    """rad/s: limit of the rates of roll and pitch."""
    fastest_yaw: float = 10.0
    """rad/s: limit of the rate of yaw."""
    tilt_turning: float = 12.0
    """rad/s: rate of roll or pitch above which a drone turns on in the same sense."""
    yaw_turning: float = 5.0
    """rad/s: rate of yaw above which a drone turns on in the same sense."""
    small_angle: float = math.pi / 10800.0
    """rad: two directions with a smaller angle count as one."""
    inertia_xx: float = 16.6e-6
    """kg m2."""
    inertia_yy: float = 16.6e-6
    """kg m2."""
    inertia_zz: float = 29.3e-6
    """kg m2."""
    inertia_xy: float = 0.83e-6
    """kg m2."""
    inertia_xz: float = 0.72e-6
    """kg m2."""
    inertia_yz: float = 1.8e-6
    """kg m2."""


BRESCIANINI_SETTINGS = BrescianiniSettings()


@kernel()
def _normalize(v: Triple) -> Triple:
    n = 1.0 / math.sqrt(dot(v, v))
    return v[0] * n, v[1] * n, v[2] * n


@kernel()
def _turn_to(a: Triple, b: Triple) -> Quaternion:
    """Return the shortest rotation from the direction a to the direction b, both of length 1.

    Its axis is a x b; for a small angle it is (1, 1, 0), as in the firmware.
    """
    angle = math.acos(clip(dot(a, b), -1.0, 1.0))
    axis = (1.0, 1.0, 0.0)
    if angle > BRESCIANINI_SETTINGS.small_angle:
        axis = _normalize(cross(a, b))
    s = math.sin(0.5 * angle)
    return normalize_quaternion(
        (s * axis[0], s * axis[1], s * axis[2], math.cos(0.5 * angle))
    )


@kernel()
def _limit_acceleration(a: Triple, fairness: float) -> Triple:
    """Reduce an acceleration that needs more than the greatest lift.

        a <- (r a_x, r a_y, (r f + 1 - f) (a_z - g) + g),   |a| = most_lift,  0 <= r <= 1

    r is the larger root of that equation.
    a: m/s2, world: acceleration plus g e3
    fairness: f: 1 reduces all axes alike, 0 spares the vertical
    """
    f = clip(fairness, 0.0, 1.0)
    z = a[2] - FIRMWARE_GRAVITY
    kept = (1.0 - f) * z + FIRMWARE_GRAVITY
    square = a[0] * a[0] + a[1] * a[1] + (f * z) ** 2
    linear = 2.0 * f * z * kept
    free = max(BRESCIANINI_SETTINGS.most_lift**2 - kept * kept, 0.0)
    r = 0.0
    if square >= 1e-6:
        root = math.sqrt(linear * linear + 4.0 * square * free)
        r = clip((root - linear) / (2.0 * square), 0.0, 1.0)
    return r * a[0], r * a[1], r * f * z + kept


@kernel()
def _compute_acceleration(fw: Record, sp: Record, lift_share: float) -> Triple:
    """Return a = a_d + e_p / tau^2 + 2 zeta / tau e_v + g e3, m/s2, within the limits of the lift.

    lift_share: vertical part of the thrust axis
    """
    b = fw.brescianini
    p, v = compute_tracking_errors(fw, sp)
    most = BRESCIANINI_SETTINGS.most_lift
    spring_xy = 1.0 / b.tau_xy**2
    spring_z = 1.0 / b.tau_z**2
    damping_xy = 2.0 * b.zeta_xy / b.tau_xy
    damping_z = 2.0 * b.zeta_z / b.tau_z
    a = (
        clamp(sp.ax + spring_xy * p[0] + damping_xy * v[0], most),
        clamp(sp.ay + spring_xy * p[1] + damping_xy * v[1], most),
        clamp(sp.az + spring_z * p[2] + damping_z * v[2] + FIRMWARE_GRAVITY, most),
    )
    if abs(a[2] / lift_share) > most:
        a = _limit_acceleration(a, b.coll_fairness)
    return a


@kernel()
def _compute_yaw_error(q: Quaternion, up: Triple, yaw: float) -> Quaternion:
    """Return the rotation from the attitude q to the one with this thrust direction and yaw.

    yaw: rad
    """
    turned = (0.0, 0.0, math.sin(0.5 * yaw), math.cos(0.5 * yaw))
    wanted = quaternion_product(_turn_to((0.0, 0.0, 1.0), up), turned)
    e = normalize_quaternion(quaternion_product(quaternion_conjugate(q), wanted))
    return (-e[0], -e[1], -e[2], -e[3]) if e[3] < 0.0 else e


@kernel()
def _mix_errors(reduced: Quaternion, full: Quaternion, share: float) -> Quaternion:
    """Return the attitude error with a share of its turn about the thrust axis.

    reduced: without the yaw, in axes of the world, as in the firmware
    full: with the yaw, in axes of the body
    """
    if share <= 0.0:
        return reduced
    if share >= 1.0:
        return full
    between = quaternion_product(quaternion_conjugate(reduced), full)
    angle = share * math.acos(clip(between[3], -1.0, 1.0))
    s = -math.sin(angle) if between[2] < 0.0 else math.sin(angle)
    return quaternion_product(reduced, (0.0, 0.0, s, math.cos(angle)))


@kernel()
def _turn_on(wanted: float, rate: float, fast: float, most: float) -> float:
    """Return the wanted rate, or the greatest one in the sense in which the drone turns fast."""
    if wanted * rate < 0.0 and abs(rate) > fast:
        return math.copysign(most, rate)
    return wanted


@kernel()
def _write_wanted_rates(fw: Record, sp: Record, e: Quaternion) -> None:
    """Write w_d = 2 / tau_rp e + yaw' e3, reduced to the limits of the rates, rad/s."""
    b = fw.brescianini
    c = BRESCIANINI_SETTINGS
    gain = 2.0 / b.tau_rp
    x = _turn_on(gain * e[0], math.radians(fw.gx), c.tilt_turning, c.fastest_tilt)
    y = _turn_on(gain * e[1], math.radians(fw.gy), c.tilt_turning, c.fastest_tilt)
    yaw_rate = gain * e[2] + math.radians(sp.yaw_rate)
    z = _turn_on(yaw_rate, math.radians(fw.gz), c.yaw_turning, c.fastest_yaw)
    tilt = max(abs(x), abs(y)) / c.fastest_tilt
    scale = 1.0 / max(max(tilt, abs(z) / c.fastest_yaw), 1.0)
    b.wx = scale * x
    b.wy = scale * y
    b.wz = scale * z


@kernel()
def _follow_setpoint(fw: Record, sp: Record) -> None:
    """Write the wanted rates and the lift, the thrust for the mass."""
    b = fw.brescianini
    q = (fw.qx, fw.qy, fw.qz, fw.qw)
    axis = rotation_columns(q)[2]
    a = _compute_acceleration(fw, sp, axis[2])
    b.lift = clip(
        a[2] / axis[2],
        BRESCIANINI_SETTINGS.least_lift,
        BRESCIANINI_SETTINGS.most_lift,
    )
    up = _normalize(a)
    yaw = 0.0 if sp.mode_quat == AXIS_MODES.absolute else math.radians(sp.yaw)
    e = _mix_errors(_turn_to(axis, up), _compute_yaw_error(q, up, yaw), b.mixing_factor)
    _write_wanted_rates(fw, sp, e)


@kernel()
def control(fw: Record, sp: Record) -> None:
    """Make one pass at 1 kHz: write force N and torque N m.

        f = m a_z / z_b_z,   tau = J (w_d - w) / tau_w

    As in the firmware, a set-point without a mode along z stops the motors; any other is followed
    as a place on all axes, 0 without one. The yaw of a quaternion is not heeded.
    Source: Brescianini, Hehn & D'Andrea 2013, Nonlinear quadrocopter attitude control, ETH Zurich;
    figures and limits: controller_brescianini.c of the firmware. Quaternions are multiplied as in
    the paper; firmware before July 2026 (pull request 1665) multiplied them in the opposite order.
    """
    b = fw.brescianini
    c = BRESCIANINI_SETTINGS
    if fw.tick % c.wanted_rate_ticks == 0:
        _follow_setpoint(fw, sp)
    fw.output = OUTPUT_KINDS.force_torque
    if sp.mode_z == AXIS_MODES.disabled:
        fw.force = fw.torque_x = fw.torque_y = fw.torque_z = 0.0
        return
    x = (b.wx - math.radians(fw.gx)) / c.tilt_rate_time
    y = (b.wy - math.radians(fw.gy)) / c.tilt_rate_time
    z = (b.wz - math.radians(fw.gz)) / c.yaw_rate_time
    fw.force = b.lift * b.mass
    fw.torque_x = c.inertia_xx * x + c.inertia_xy * y + c.inertia_xz * z
    fw.torque_y = c.inertia_xy * x + c.inertia_yy * y + c.inertia_yz * z
    fw.torque_z = c.inertia_xz * x + c.inertia_yz * y + c.inertia_zz * z
