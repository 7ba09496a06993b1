"""Controller 3 of the firmware: incremental nonlinear dynamic inversion (INDI).

The model is not the inertia but the effectiveness of a change of the command; the accelerations are
measured, by filtered and differentiated sensors. An outer loop gives roll, pitch and thrust for a
wanted acceleration, an inner loop the commands for a wanted angular acceleration. All axes are
forward-right-down; the world has its y axis inverted and z down.

Source: Smeur, Chu & de Croon 2016, J. Guid. Control Dyn. 39(3), 10.2514/1.G001490; outer loop:
Smeur, de Croon & Chu 2018, Control Eng. Pract. 73, 10.1016/j.conengprac.2018.01.003; modes, gains
and filters: controller_indi.c and position_controller_indi.c of the firmware.
"""

import math
from typing import NamedTuple

import numpy as np

from crazychoir.numerics.kernels import kernel
from crazychoir.numerics.math3d import Triple, clip, dot
from crazychoir.simulation.onboard.controllers import cascade, pid
from crazychoir.simulation.onboard.controllers.attitude import CONTROL_PERIOD, clamp
from crazychoir.simulation.onboard.record import AXIS_MODES, OUTPUT_KINDS, Record
from crazychoir.simulation.onboard.units import FIRMWARE_GRAVITY


class IndiSettings(NamedTuple):
    """Figures of the controller that are not parameters."""

    thrust_effectiveness: float = 0.00024730
    """m/s2 a unit of the thrust command."""
    most_thrust: float = 60000.0
    """Greatest thrust command of the outer loop."""
    outer_cutoff: float = 8.0
    """Hz: cutoff of the filters of the outer loop."""
    thrust_lag: float = 0.03149
    """Share of a new thrust that the rotors reach in one period."""
    quality: float = 0.7071
    """Quality factor of the low-pass filters."""


INDI_SETTINGS = IndiSettings()


class FilterRows(NamedTuple):
    """Rows of the low-pass filters in the memory; a row for each axis follows."""

    rates: int = 0
    """Rates of the body."""
    commands: int = 3
    """Commands that the rotors have reached."""
    accelerations: int = 6
    """Specific forces."""
    angles: int = 9
    """Roll, pitch and yaw."""
    thrust: int = 12
    """Thrust command."""
    end: int = 13
    """Number of the filters."""


FILTER_ROWS = FilterRows()


@kernel()
def _design_filter(n: Record, kind: int, hertz: float) -> None:
    """Write b0, a1 and a2 of a low-pass of order 2 at 500 Hz (b1 = 2 b0, b2 = b0).

    kind: 0: roll and pitch, 1: yaw, 2: outer loop
    """
    k = math.tan(math.pi * hertz * CONTROL_PERIOD)
    damped = k / INDI_SETTINGS.quality
    scale = 1.0 / (k * k + damped + 1.0)
    n.filters[kind, 0] = k * k * scale
    n.filters[kind, 1] = 2.0 * (k * k - 1.0) * scale
    n.filters[kind, 2] = (k * k - damped + 1.0) * scale


@kernel()
def _filter(n: Record, row: int, kind: int, value: float) -> float:
    """Return the value of row `row` through its low-pass."""
    b = n.filters[kind, 0] * value
    d = n.delays
    y: float = b + d[row, 0]
    d[row, 0] = 2.0 * b - n.filters[kind, 1] * y + d[row, 1]
    d[row, 1] = b - n.filters[kind, 2] * y
    return y


@kernel()
def reset(fw: Record) -> None:
    """Reset the filters and the inner commands, as when the controller is chosen.

    The cutoffs of the filters act from here on. The increments, the thrust of the outer loop and
    the wanted angles stay.
    """
    n = fw.indi
    _design_filter(n, 0, n.filt_cutoff)
    _design_filter(n, 1, n.filt_cutoff_r)
    _design_filter(n, 2, INDI_SETTINGS.outer_cutoff)
    for row in range(FILTER_ROWS.end):
        n.delays[row, 0] = 0.0
        n.delays[row, 1] = 0.0
    n.rate_p = n.rate_q = n.rate_r = 0.0
    _release_commands(n)


@kernel()
def _release_commands(n: Record) -> None:
    n.u_p = n.u_q = n.u_r = 0.0
    n.reached_p = n.reached_q = n.reached_r = 0.0


@kernel()
def _compute_wanted_acceleration(fw: Record, sp: Record) -> Triple:
    """Return a = K_dxi (K_xi (p_d - p) - v), or K_dxi (v_d - v) without a place, m/s2."""
    n = fw.indi
    vx = sp.vx
    vy = -sp.vy
    vz = -sp.vz
    if sp.mode_x == AXIS_MODES.absolute:
        vx = n.K_xi_x * (sp.x - fw.x)
    if sp.mode_y == AXIS_MODES.absolute:
        vy = n.K_xi_y * (fw.y - sp.y)
    if sp.mode_z == AXIS_MODES.absolute:
        vz = n.K_xi_z * (fw.z - sp.z)
    return (
        n.K_dxi_x * (vx - fw.vx),
        n.K_dxi_y * (vy + fw.vy),
        n.K_dxi_z * (vz + fw.vz),
    )


@kernel()
def _filter_triple(n: Record, row: int, v: Triple) -> Triple:
    return (
        _filter(n, row, 2, v[0]),
        _filter(n, row + 1, 2, v[1]),
        _filter(n, row + 2, 2, v[2]),
    )


@kernel()
def _compute_columns(angles: Triple) -> tuple[Triple, Triple, Triple]:
    """Return the body axes for roll, pitch and yaw in rad: the columns of Rz Ry Rx."""
    cf = math.cos(angles[0])
    sf = math.sin(angles[0])
    ct = math.cos(angles[1])
    st = math.sin(angles[1])
    cp = math.cos(angles[2])
    sn = math.sin(angles[2])
    return (
        (ct * cp, ct * sn, -st),
        (sf * st * cp - cf * sn, sf * st * sn + cf * cp, sf * ct),
        (cf * st * cp + sf * sn, cf * st * sn - sf * cp, cf * ct),
    )


@kernel()
def _invert_thrust(
    angles: Triple, axes: tuple[Triple, Triple, Triple], e: Triple
) -> Triple:
    """Return the changes (phi, theta, T) that change the acceleration by e, m/s2.

        e = -g dz/dphi phi - g dz/dtheta theta + z T,   dz/dphi = -y,   dz/dtheta = cos(phi) x

    axes: x, y, z: forward, right and thrust axis of the body, orthogonal to each other
    The thrust is taken as the weight; T is positive downwards.
    """
    x, y, z = axes
    return (
        dot(e, y) / FIRMWARE_GRAVITY,
        -dot(e, x) / (FIRMWARE_GRAVITY * math.cos(angles[0])),
        dot(e, z),
    )


@kernel()
def _run_outer_loop(fw: Record, sp: Record) -> None:
    """Write roll and pitch in rad and the thrust for the wanted acceleration."""
    n = fw.indi
    g = FIRMWARE_GRAVITY
    a = _compute_wanted_acceleration(fw, sp)
    f = _filter_triple(
        n, FILTER_ROWS.accelerations, (g * fw.ax, -g * fw.ay, -g * fw.az)
    )
    angles = _filter_triple(
        n,
        FILTER_ROWS.angles,
        (math.radians(fw.roll), math.radians(fw.pitch), -math.radians(fw.yaw)),
    )
    axes = _compute_columns(angles)
    x, y, z = axes
    e = (
        a[0] - x[0] * f[0] - y[0] * f[1] - z[0] * f[2],
        a[1] - x[1] * f[0] - y[1] * f[1] - z[1] * f[2],
        a[2] - x[2] * f[0] - y[2] * f[1] - z[2] * f[2] - g,
    )
    roll, pitch, thrust = _invert_thrust(angles, axes, e)
    filtered = _filter(n, FILTER_ROWS.thrust, 2, n.outer_thrust)
    n.reached_thrust += INDI_SETTINGS.thrust_lag * (filtered - n.reached_thrust)
    n.outer_thrust = clip(
        n.reached_thrust - thrust / INDI_SETTINGS.thrust_effectiveness,
        0.0,
        INDI_SETTINGS.most_thrust,
    )
    most = math.radians(n.pq_clamping)
    n.outer_roll = clamp(angles[0] + roll, most)
    n.outer_pitch = clamp(angles[1] + pitch, most)


@kernel()
def _choose_yaw(fw: Record, sp: Record) -> None:
    """Write the wanted yaw, rad, positive to the right.

    As in the firmware, a yaw rate in deg/s is added to the yaw in rad, and the sum is converted as
    if it were deg: the drone holds a yaw near 0. The yaw of a quaternion is not heeded.
    """
    n = fw.indi
    if sp.mode_yaw == AXIS_MODES.velocity:
        n.wanted_yaw = math.radians(
            pid.wrap_degrees(n.wanted_yaw + sp.yaw_rate * CONTROL_PERIOD)
        )
    elif sp.mode_quat == AXIS_MODES.absolute:
        n.wanted_yaw = 0.0
    else:
        n.wanted_yaw = -math.radians(pid.wrap_degrees(sp.yaw))


@kernel()
def _choose_tilt(fw: Record, sp: Record) -> None:
    """Write the wanted roll and pitch, rad, and the thrust: the set-point's or the outer loop's.

    Without the outer loop the PIDs take its place; the inner loop takes their degrees as rad, as
    in the firmware.
    """
    n = fw.indi
    if n.outer_loop:
        _run_outer_loop(fw, sp)
    elif fw.tick % cascade.CASCADE_SETTINGS.position_ticks == 0:
        cascade.run_position_pids(fw, sp)
        n.outer_roll = fw.target_roll
        n.outer_pitch = fw.target_pitch
        n.outer_thrust = fw.position_thrust
    fw.thrust = n.outer_thrust
    n.wanted_roll = n.outer_roll
    n.wanted_pitch = n.outer_pitch
    if sp.mode_z == AXIS_MODES.disabled:
        fw.thrust = sp.thrust
    if sp.mode_x == AXIS_MODES.disabled:
        n.wanted_roll = math.radians(sp.roll)
    if sp.mode_y == AXIS_MODES.disabled:
        n.wanted_pitch = math.radians(sp.pitch)


@kernel()
def _increment_tilt(
    n: Record, axis: int, effect: float, wanted: float, change: float, reached: float
) -> float:
    """Return u = u_f + (nu - w') / G, limited.

    axis: 0: roll, 1: pitch
    effect: G, rad/s2 a unit of the command
    wanted: nu, rad/s2
    change: w', rad/s2: filtered angular acceleration
    reached: command that the rotors have reached; u_f is this through the same filter
    """
    filtered = _filter(n, FILTER_ROWS.commands + axis, 0, reached)
    return clamp(filtered + (wanted - change) / effect, n.bound_ctrl_input)


@kernel()
def _increment_yaw(n: Record, wanted: float, change: float) -> float:
    """Return u = u_f + du, limited, with du <- (nu - w' + G2 du) / (G1 + G2).

    G2 is the effect of the change of the speed of the rotors.
    """
    filtered = _filter(n, FILTER_ROWS.commands + 2, 1, n.reached_r)
    n.du_r = (wanted - change + n.g2 * n.du_r) / (n.g1_r + n.g2)
    return clamp(filtered + n.du_r, n.bound_ctrl_input)


@kernel()
def _run_inner_loop(fw: Record, wanted: Triple) -> None:
    """Write the commands of roll, pitch and yaw for the wanted rates, rad/s."""
    n = fw.indi
    w = (math.radians(fw.gx), -math.radians(fw.gy), -math.radians(fw.gz))
    p = _filter(n, FILTER_ROWS.rates, 0, w[0])
    q = _filter(n, FILTER_ROWS.rates + 1, 0, w[1])
    r = _filter(n, FILTER_ROWS.rates + 2, 1, w[2])
    n.u_p = _increment_tilt(
        n,
        0,
        n.g1_p,
        n.ref_rate_p * (wanted[0] - w[0]),
        (p - n.rate_p) / CONTROL_PERIOD,
        n.reached_p,
    )
    n.u_q = _increment_tilt(
        n,
        1,
        n.g1_q,
        n.ref_rate_q * (wanted[1] - w[1]),
        (q - n.rate_q) / CONTROL_PERIOD,
        n.reached_q,
    )
    n.u_r = _increment_yaw(
        n, n.ref_rate_r * (wanted[2] - w[2]), (r - n.rate_r) / CONTROL_PERIOD
    )
    n.rate_p = p
    n.rate_q = q
    n.rate_r = r
    n.reached_p += n.act_dyn_p * (n.u_p - n.reached_p)
    n.reached_q += n.act_dyn_q * (n.u_q - n.reached_q)
    n.reached_r += n.act_dyn_r * (n.u_r - n.reached_r)


@kernel()
def control(fw: Record, sp: Record) -> None:
    """Make one pass at 500 Hz: write thrust 0..65535 and roll, pitch, yaw as 16-bit integers.

        nu = K_w (K_eta (eta_d - eta) - w),   u = u_f + G^-1 (nu - w'_f)

    eta: roll, pitch, yaw; the set-point may give rates of roll and pitch instead
    w'_f, u_f: angular acceleration and reached command through the same low-pass
    Below a thrust there are no commands; without thrust the present yaw is held.
    """
    n = fw.indi
    _choose_yaw(fw, sp)
    _choose_tilt(fw, sp)
    p = n.ref_err_p * (n.wanted_roll - math.radians(fw.roll))
    q = n.ref_err_q * (n.wanted_pitch - math.radians(fw.pitch))
    r = n.ref_err_r * (n.wanted_yaw + math.radians(fw.yaw))
    if sp.mode_roll == AXIS_MODES.velocity:
        p = math.radians(sp.roll_rate)
    if sp.mode_pitch == AXIS_MODES.velocity:
        q = math.radians(sp.pitch_rate)
    _run_inner_loop(fw, (p, q, r))
    if fw.thrust < n.thrust_threshold:
        _release_commands(n)
        if fw.thrust == 0.0:
            cascade.reset(fw)
            n.wanted_yaw = -fw.yaw
    fw.output = OUTPUT_KINDS.legacy
    fw.roll_out = float(np.trunc(n.u_p))
    fw.pitch_out = float(np.trunc(n.u_q))
    fw.yaw_out = float(np.trunc(n.u_r))
