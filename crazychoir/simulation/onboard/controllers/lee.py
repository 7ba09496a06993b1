"""Controller 5 of the firmware: Lee's geometric controller on SE(3), in N and N m."""

import math

from crazychoir.numerics.kernels import kernel
from crazychoir.numerics.math3d import Triple, dot, flat_attitude, rotation_columns
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
from crazychoir.simulation.onboard.units import (
    FIRMWARE_GRAVITY,
    FULL_THRUST_COMMAND,
)

LEE_LEAST_THRUST = (
    1000.0  # thrust command; below it the motors stop and the integrals are reset
)
LEE_LEAST_FORCE = 0.01  # N; below it the integrals are reset, as on the ground


@kernel()
def reset(fw: Record) -> None:
    """Reset the integrals."""
    m = fw.lee
    m.ix = m.iy = m.iz = m.irx = m.iry = m.irz = 0.0


@kernel()
def _compute_lee_force(fw: Record, sp: Record) -> Triple:
    """Return F = m (a + KP e_p + KD e_v + KI int e_p + g e3), N, world.

    The components of e_p and e_v are limited; the integral, of the limited e_p, is not.
    """
    m = fw.lee
    p, v = compute_tracking_errors(fw, sp)
    p = (
        clamp(p[0], m.Kpos_P_limit),
        clamp(p[1], m.Kpos_P_limit),
        clamp(p[2], m.Kpos_P_limit),
    )
    v = (
        clamp(v[0], m.Kpos_D_limit),
        clamp(v[1], m.Kpos_D_limit),
        clamp(v[2], m.Kpos_D_limit),
    )
    m.ix += p[0] * CONTROL_PERIOD
    m.iy += p[1] * CONTROL_PERIOD
    m.iz += p[2] * CONTROL_PERIOD
    return (
        m.mass * (sp.ax + m.Kpos_Px * p[0] + m.Kpos_Dx * v[0] + m.Kpos_Ix * m.ix),
        m.mass * (sp.ay + m.Kpos_Py * p[1] + m.Kpos_Dy * v[1] + m.Kpos_Iy * m.iy),
        m.mass
        * (
            sp.az
            + FIRMWARE_GRAVITY
            + m.Kpos_Pz * p[2]
            + m.Kpos_Dz * v[2]
            + m.Kpos_Iz * m.iz
        ),
    )


@kernel()
def _turn_rates(fw: Record, d: Axes, w: Triple) -> Triple:
    """Return R^T Rd w: the rates w of the wanted attitude in the present body axes."""
    x, y, z = rotation_columns((fw.qx, fw.qy, fw.qz, fw.qw))
    u = (
        d[0][0] * w[0] + d[1][0] * w[1] + d[2][0] * w[2],
        d[0][1] * w[0] + d[1][1] * w[1] + d[2][1] * w[2],
        d[0][2] * w[0] + d[1][2] * w[1] + d[2][2] * w[2],
    )
    return dot(x, u), dot(y, u), dot(z, u)


@kernel()
def _compute_wanted_rates(fw: Record, sp: Record, d: Axes, f: float) -> Triple:
    """Return the rates of the wanted attitude in its own axes, rad/s.

        h = m/f (j - (j . z_d) z_d),   w_d = (-h . y_d, h . x_d, z_d_z yaw')

    d: columns x_d, y_d, z_d of Rd
    f: N: force
    """
    j = (sp.jx, sp.jy, sp.jz)
    along = dot(j, d[2])
    scale = fw.lee.mass / f if f != 0.0 else 0.0
    h = (
        scale * (j[0] - along * d[2][0]),
        scale * (j[1] - along * d[2][1]),
        scale * (j[2] - along * d[2][2]),
    )
    return -dot(h, d[1]), dot(h, d[0]), d[2][2] * math.radians(sp.yaw_rate)


@kernel()
def _has_place(sp: Record) -> bool:
    """Return True if a set-point has a place on any axis."""
    has: bool = (
        sp.mode_x == AXIS_MODES.absolute
        or sp.mode_y == AXIS_MODES.absolute
        or sp.mode_z == AXIS_MODES.absolute
    )
    return has


@kernel()
def _compute_wanted_attitude(fw: Record, sp: Record) -> tuple[Axes, float]:
    """Return the wanted body axes, and the force in N along the present thrust axis.

    A set-point with a place on any axis is followed on all axes. Any other holds its roll and
    pitch, and its thrust, which is 0 for velocities.
    """
    if not _has_place(sp):
        f = sp.thrust / FULL_THRUST_COMMAND * 4.0 * fw.thrust_max
        return compute_axes_by_angles(sp, choose_heading(fw, sp)), f
    force = _compute_lee_force(fw, sp)
    f = dot(force, rotation_columns((fw.qx, fw.qy, fw.qz, fw.qw))[2])
    if f < LEE_LEAST_FORCE:
        reset(fw)
    up = force if f > 0.0 else (0.0, 0.0, 1.0)
    return flat_attitude(up, choose_heading(fw, sp)), f


@kernel()
def control(fw: Record, sp: Record) -> None:
    """Make one pass at 500 Hz: write force N and torque N m.

        f = F . z_b,  tau = -KR e_R - Kw e_w - KI int e_R + w x J w
        e_R = 1/2 (Rd^T R - R^T Rd)^v,  e_w = w - R^T Rd w_d

    The integral of e_R is unbounded. w_d follows from the jerk and the yaw rate of the set-point;
    there is no feed-forward of its derivative.
    Choice of this model, which may differ from the firmware: a thrust command of 65535 means
    4 thrust_max.
    Source: Lee, Leok & McClamroch 2010, CDC; modes and gains: controller_lee of the firmware.
    """
    m = fw.lee
    fw.output = OUTPUT_KINDS.force_torque
    if (
        not _has_place(sp)
        and sp.mode_z == AXIS_MODES.disabled
        and sp.thrust < LEE_LEAST_THRUST
    ):
        fw.force = fw.torque_x = fw.torque_y = fw.torque_z = 0.0
        reset(fw)
        return
    d, f = _compute_wanted_attitude(fw, sp)
    fw.force = f
    e = compute_attitude_error(d, fw)
    w = (math.radians(fw.gx), math.radians(fw.gy), math.radians(fw.gz))
    wd = _turn_rates(fw, d, _compute_wanted_rates(fw, sp, d, f))
    m.ahead_x = d[0][0]
    m.ahead_y = d[0][1]
    m.ahead_z = d[0][2]
    m.left_z = d[1][2]
    m.up_z = d[2][2]
    m.wdx = wd[0]
    m.wdy = wd[1]
    m.wdz = wd[2]
    ew = (w[0] - wd[0], w[1] - wd[1], w[2] - wd[2])
    m.irx = m.irx + 0.5 * e[0] * CONTROL_PERIOD
    m.iry = m.iry + 0.5 * e[1] * CONTROL_PERIOD
    m.irz = m.irz + 0.5 * e[2] * CONTROL_PERIOD
    j = (m.J_x * w[0], m.J_y * w[1], m.J_z * w[2])
    fw.torque_x = (
        -0.5 * m.KR_x * e[0]
        - m.Kw_x * ew[0]
        - m.KI_x * m.irx
        + w[1] * j[2]
        - w[2] * j[1]
    )
    fw.torque_y = (
        -0.5 * m.KR_y * e[1]
        - m.Kw_y * ew[1]
        - m.KI_y * m.iry
        + w[2] * j[0]
        - w[0] * j[2]
    )
    fw.torque_z = (
        -0.5 * m.KR_z * e[2]
        - m.Kw_z * ew[2]
        - m.KI_z * m.irz
        + w[0] * j[1]
        - w[1] * j[0]
    )
