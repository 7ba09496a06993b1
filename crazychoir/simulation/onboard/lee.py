"""Controller 5 of the firmware: Lee's geometric controller on SE(3), in N and N m."""

import math

from crazychoir.numerics.kernels import kernel
from crazychoir.numerics.math3d import Triple, dot, rotation_columns
from crazychoir.simulation.onboard.attitude import (
    CONTROL_PERIOD,
    Axes,
    compute_attitude_error,
    compute_tracking_errors,
    compute_wanted_attitude,
    compute_wanted_rates,
    shorten_vector,
)
from crazychoir.simulation.onboard.record import AXIS_MODES, OUTPUT_KINDS, Record
from crazychoir.simulation.onboard.units import FIRMWARE_GRAVITY

LEE_LEAST_THRUST = (
    1000.0  # thrust command; below it the motors stop and the integrals are reset
)


@kernel()
def reset(fw: Record) -> None:
    """Reset the integrals."""
    m = fw.lee
    m.ix = m.iy = m.iz = m.irx = m.iry = m.irz = 0.0


@kernel()
def _compute_lee_force(fw: Record, sp: Record) -> Triple:
    """Return F = m (a + KP e_p + KD e_v + KI int e_p + g e3), N, world.

    Each vector is shortened to its limit.
    """
    m = fw.lee
    p, v = compute_tracking_errors(fw, sp)
    m.ix, m.iy, m.iz = shorten_vector(
        m.ix + p[0] * CONTROL_PERIOD,
        m.iy + p[1] * CONTROL_PERIOD,
        m.iz + p[2] * CONTROL_PERIOD,
        m.Kpos_I_limit,
    )
    p = shorten_vector(p[0], p[1], p[2], m.Kpos_P_limit)
    v = shorten_vector(v[0], v[1], v[2], m.Kpos_D_limit)
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
def control(fw: Record, sp: Record) -> None:
    """Make one pass at 500 Hz: write force N and torque N m.

        f = F . z_b,  tau = -KR e_R - Kw e_w - KI int e_R + w x J w
        e_R = 1/2 (Rd^T R - R^T Rd)^v,  e_w = w - R^T Rd w_d

    The integral of e_R is unbounded.
    Choices of this model, which may differ from the firmware: w_d is the body rate of the
    set-point, which the planner computes from the jerk; there is no feed-forward of the derivative
    of w_d; a thrust command of 65535 means 4 thrust_max.
    Source: Lee, Leok & McClamroch 2010, CDC; gains: controller_lee of the firmware.
    """
    m = fw.lee
    fw.output = OUTPUT_KINDS.force_torque
    d, f = compute_wanted_attitude(fw, sp, _compute_lee_force(fw, sp))
    if sp.mode_z == AXIS_MODES.disabled:
        f = sp.thrust / 65535.0 * 4.0 * fw.thrust_max
        if sp.thrust < LEE_LEAST_THRUST:
            fw.force = fw.torque_x = fw.torque_y = fw.torque_z = 0.0
            reset(fw)
            return
    fw.force = max(f, 0.0)
    e = compute_attitude_error(d, fw)
    w = (math.radians(fw.gx), math.radians(fw.gy), math.radians(fw.gz))
    wd = _turn_rates(fw, d, compute_wanted_rates(sp))
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
