"""Controller 2 of the firmware: Mellinger's, with integrals, in the firmware's thrust units."""

import math

from crazychoir.numerics.kernels import kernel
from crazychoir.numerics.math3d import dot, flat_attitude, rotation_columns
from crazychoir.simulation.onboard.controllers.attitude import (
    CONTROL_PERIOD,
    Axes,
    choose_heading,
    clamp,
    compute_attitude_error,
    compute_axes_by_angles,
    compute_tracking_errors,
)
from crazychoir.simulation.onboard.record import AXIS_MODES, OUTPUT_KINDS, Record
from crazychoir.simulation.onboard.units import FIRMWARE_GRAVITY

MOST_MOMENT = 32000.0  # limit of the roll, pitch and yaw commands


@kernel()
def reset(fw: Record) -> None:
    """Reset the integrals; as in the firmware, the rates of the last pass stay."""
    m = fw.mellinger
    m.ix = m.iy = m.iz = m.imx = m.imy = m.imz = 0.0


@kernel()
def _compute_mellinger_force(fw: Record, sp: Record) -> tuple[float, float, float]:
    """Return F = m (a + g e3) + kp e_p + kd e_v + ki int e_p, N, world."""
    m = fw.mellinger
    p, v = compute_tracking_errors(fw, sp)
    m.ix = clamp(m.ix + p[0] * CONTROL_PERIOD, m.i_range_xy)
    m.iy = clamp(m.iy + p[1] * CONTROL_PERIOD, m.i_range_xy)
    m.iz = clamp(m.iz + p[2] * CONTROL_PERIOD, m.i_range_z)
    return (
        m.mass * sp.ax + m.kp_xy * p[0] + m.kd_xy * v[0] + m.ki_xy * m.ix,
        m.mass * sp.ay + m.kp_xy * p[1] + m.kd_xy * v[1] + m.ki_xy * m.iy,
        m.mass * (sp.az + FIRMWARE_GRAVITY)
        + m.kp_z * p[2]
        + m.kd_z * v[2]
        + m.ki_z * m.iz,
    )


@kernel()
def _compute_wanted_attitude(fw: Record, sp: Record) -> tuple[Axes, float]:
    """Return the wanted body axes, and the force in N along the present thrust axis.

    A set-point with a place is followed. Roll and pitch with a thrust are held; the force is not
    used then. In all other modes the drone stays level, at the height of the set-point, which is 0
    without one.
    """
    force = _compute_mellinger_force(fw, sp)
    z = rotation_columns((fw.qx, fw.qy, fw.qz, fw.qw))[2]
    if sp.mode_x == AXIS_MODES.absolute:
        return flat_attitude(force, choose_heading(fw, sp)), dot(force, z)
    if (
        sp.mode_roll == AXIS_MODES.absolute
        and sp.mode_pitch == AXIS_MODES.absolute
        and sp.mode_z == AXIS_MODES.disabled
    ):
        return compute_axes_by_angles(sp, choose_heading(fw, sp)), 0.0
    up = (0.0, 0.0, force[2] - fw.mellinger.mass * sp.az)
    return flat_attitude(up, math.radians(fw.yaw)), dot(up, z)


@kernel()
def _compute_damping(
    m: Record, w: tuple[float, float, float], wd: tuple[float, float, float]
) -> tuple[float, float]:
    """Return d(w_d - w)/dt of roll and pitch, rad/s2; before the first pass the rates are 0."""
    x = ((wd[0] - m.wx_set) - (w[0] - m.wx)) / CONTROL_PERIOD
    y = ((wd[1] - m.wy_set) - (w[1] - m.wy)) / CONTROL_PERIOD
    m.wx = w[0]
    m.wy = w[1]
    m.wx_set = wd[0]
    m.wy_set = wd[1]
    return x, y


@kernel()
def control(fw: Record, sp: Record) -> None:
    """Make one pass at 500 Hz: write thrust 0..65535 and roll, pitch, yaw -32000..32000.

        T = massThrust F . z_b
        M = -kR e_R + kw (w_d - w) - ki_m int e_R + kd_omega d(w_d - w)/dt

    e_R = (Rd^T R - R^T Rd)^v, not halved. A thrust of 0 or less is kept; it resets the integrals and
    gives no moments. w_d is the body rate of the set-point, not rotated; the pitch rate of an RPYT
    set-point has the wrong sign, as in the firmware.
    Source: Mellinger & Kumar 2011, ICRA; modes, gains and integrals: controller_mellinger of the
    firmware.
    """
    m = fw.mellinger
    axes, force = _compute_wanted_attitude(fw, sp)
    m.zdx = axes[2][0]
    m.zdy = axes[2][1]
    m.zdz = axes[2][2]
    fw.output = OUTPUT_KINDS.legacy
    fw.thrust = sp.thrust if sp.mode_z == AXIS_MODES.disabled else m.massThrust * force
    w = (math.radians(fw.gx), math.radians(fw.gy), math.radians(fw.gz))
    wd = (
        math.radians(sp.roll_rate),
        math.radians(sp.pitch_rate),
        math.radians(sp.yaw_rate),
    )
    dx, dy = _compute_damping(m, w, wd)
    if fw.thrust <= 0.0:
        fw.roll_out = fw.pitch_out = fw.yaw_out = 0.0
        reset(fw)
        return
    e = compute_attitude_error(axes, fw)
    m.imx = clamp(m.imx - e[0] * CONTROL_PERIOD, m.i_range_m_xy)
    m.imy = clamp(m.imy - e[1] * CONTROL_PERIOD, m.i_range_m_xy)
    m.imz = clamp(m.imz - e[2] * CONTROL_PERIOD, m.i_range_m_z)
    mx = (
        -m.kR_xy * e[0]
        + m.kw_xy * (wd[0] - w[0])
        + m.ki_m_xy * m.imx
        + m.kd_omega_rp * dx
    )
    my = (
        -m.kR_xy * e[1]
        + m.kw_xy * (wd[1] - w[1])
        + m.ki_m_xy * m.imy
        + m.kd_omega_rp * dy
    )
    mz = -m.kR_z * e[2] + m.kw_z * (wd[2] - w[2]) + m.ki_m_z * m.imz
    fw.roll_out = float(math.trunc(clamp(mx, MOST_MOMENT)))
    fw.pitch_out = float(math.trunc(clamp(-my, MOST_MOMENT)))
    fw.yaw_out = float(math.trunc(clamp(-mz, MOST_MOMENT)))
