"""Common parts of the geometric controllers: errors of a set-point, wanted axes, attitude error."""

import math

from crazychoir.numerics.kernels import kernel
from crazychoir.numerics.math3d import (
    Triple,
    clip,
    dot,
    rotation_columns,
)
from crazychoir.simulation.onboard.record import AXIS_MODES, Record

Axes = tuple[Triple, Triple, Triple]
CONTROL_PERIOD = 0.002  # s: period of the controllers at 500 Hz


@kernel()
def clamp(value: float, limit: float) -> float:
    """Return the value limited to -limit..limit."""
    return clip(value, -limit, limit)


@kernel()
def compute_tracking_errors(fw: Record, sp: Record) -> tuple[Triple, Triple]:
    """Return the errors of position m and velocity m/s, world.

    As in the firmware, fields that a set-point does not use count too; they are 0.
    """
    p = (sp.x - fw.x, sp.y - fw.y, sp.z - fw.z)
    v = (sp.vx - fw.vx, sp.vy - fw.vy, sp.vz - fw.vz)
    return p, v


@kernel()
def choose_heading(fw: Record, sp: Record) -> float:
    """Return the wanted yaw in rad; in rate mode it is the present yaw, one period on."""
    if sp.mode_yaw == AXIS_MODES.velocity:
        return math.radians(fw.yaw + sp.yaw_rate * CONTROL_PERIOD)
    if sp.mode_yaw == AXIS_MODES.absolute or sp.mode_quat == AXIS_MODES.absolute:
        return math.radians(sp.yaw)
    return 0.0


@kernel()
def compute_axes_by_angles(sp: Record, yaw: float) -> Axes:
    """Return the body axes of the set-point's roll and pitch.

    yaw: rad
    """
    phi = 0.5 * math.radians(sp.roll)
    theta = -0.5 * math.radians(sp.pitch)
    psi = 0.5 * yaw
    cf = math.cos(phi)
    sf = math.sin(phi)
    ct = math.cos(theta)
    st = math.sin(theta)
    cp = math.cos(psi)
    sn = math.sin(psi)
    return rotation_columns(
        (
            sf * ct * cp - cf * st * sn,
            cf * st * cp + sf * ct * sn,
            cf * ct * sn - sf * st * cp,
            cf * ct * cp + sf * st * sn,
        )
    )


@kernel()
def compute_attitude_error(d: Axes, fw: Record) -> Triple:
    """Return e = (Rd^T R - R^T Rd)^v, not halved; d: columns of Rd."""
    x, y, z = rotation_columns((fw.qx, fw.qy, fw.qz, fw.qw))
    return (
        dot(d[2], y) - dot(z, d[1]),
        dot(d[0], z) - dot(x, d[2]),
        dot(d[1], x) - dot(y, d[0]),
    )
