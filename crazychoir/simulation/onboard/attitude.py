"""Common parts of the geometric controllers: errors of a set-point, wanted attitude and rates."""

import math

from crazychoir.numerics.kernels import kernel
from crazychoir.numerics.math3d import (
    Triple,
    clip,
    dot,
    flat_attitude,
    rotation_columns,
)
from crazychoir.simulation.onboard.record import AXIS_MODES, Record

Axes = tuple[Triple, Triple, Triple]
LEAST_TILT_COSINE = (
    0.2  # lower bound of the tilt's cosine, by which the vertical force is divided
)
CONTROL_PERIOD = 0.002  # s: period of the controllers at 500 Hz


@kernel()
def clamp(value: float, limit: float) -> float:
    """Return the value limited to -limit..limit."""
    return clip(value, -limit, limit)


@kernel()
def shorten_vector(x: float, y: float, z: float, limit: float) -> Triple:
    """Return the vector, shortened to the limit if it is longer."""
    n = math.sqrt(x * x + y * y + z * z)
    f = 1.0 if n <= limit else limit / n
    return x * f, y * f, z * f


@kernel()
def compute_tracking_errors(fw: Record, sp: Record) -> tuple[Triple, Triple]:
    """Return the position and velocity errors, world; 0 on an axis without such a mode."""
    c = math.cos(math.radians(fw.yaw))
    s = math.sin(math.radians(fw.yaw))
    vx = sp.vx * c - sp.vy * s if sp.body_velocity else sp.vx
    vy = sp.vx * s + sp.vy * c if sp.body_velocity else sp.vy
    p = (
        sp.x - fw.x if sp.mode_x == AXIS_MODES.absolute else 0.0,
        sp.y - fw.y if sp.mode_y == AXIS_MODES.absolute else 0.0,
        sp.z - fw.z if sp.mode_z == AXIS_MODES.absolute else 0.0,
    )
    v = (
        vx - fw.vx if sp.mode_x != AXIS_MODES.disabled else 0.0,
        vy - fw.vy if sp.mode_y != AXIS_MODES.disabled else 0.0,
        sp.vz - fw.vz if sp.mode_z != AXIS_MODES.disabled else 0.0,
    )
    return p, v


@kernel()
def choose_heading(fw: Record, sp: Record) -> float:
    """Return the wanted yaw in rad; in rate mode it is the present yaw."""
    if sp.mode_yaw == AXIS_MODES.absolute or sp.mode_quat == AXIS_MODES.absolute:
        return math.radians(sp.yaw)
    return math.radians(fw.yaw)


@kernel()
def compute_axes_by_angles(fw: Record, sp: Record) -> Axes:
    """Return the body axes of the wanted roll and pitch; an axis in rate mode keeps its angle."""
    roll = fw.roll if sp.mode_roll == AXIS_MODES.velocity else sp.roll
    pitch = fw.pitch if sp.mode_pitch == AXIS_MODES.velocity else sp.pitch
    phi = 0.5 * math.radians(roll)
    theta = -0.5 * math.radians(pitch)
    psi = 0.5 * choose_heading(fw, sp)
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
def compute_wanted_attitude(fw: Record, sp: Record, f: Triple) -> tuple[Axes, float]:
    """Return the wanted body axes, and the force along the present thrust axis.

    If x and y are disabled, the angles of the set-point count, and the force is as long as its
    vertical part needs.
    f: N, world: wanted force
    """
    z = rotation_columns((fw.qx, fw.qy, fw.qz, fw.qw))[2]
    if sp.mode_x == AXIS_MODES.disabled and sp.mode_y == AXIS_MODES.disabled:
        axes = compute_axes_by_angles(fw, sp)
        return axes, f[2] / max(axes[2][2], LEAST_TILT_COSINE) * dot(axes[2], z)
    return flat_attitude(f, choose_heading(fw, sp)), dot(f, z)


@kernel()
def compute_wanted_rates(sp: Record) -> Triple:
    """Return the wanted body rates in rad/s.

    A commanded pitch rate is positive nose up; the rates of full states and of the planner are
    not.
    """
    q = -sp.pitch_rate if sp.mode_pitch == AXIS_MODES.velocity else sp.pitch_rate
    return math.radians(sp.roll_rate), math.radians(q), math.radians(sp.yaw_rate)


@kernel()
def compute_attitude_error(d: Axes, fw: Record) -> Triple:
    """Return e = (Rd^T R - R^T Rd)^v, not halved; d: columns of Rd."""
    x, y, z = rotation_columns((fw.qx, fw.qy, fw.qz, fw.qw))
    return (
        dot(d[2], y) - dot(z, d[1]),
        dot(d[0], z) - dot(x, d[2]),
        dot(d[1], x) - dot(y, d[0]),
    )
