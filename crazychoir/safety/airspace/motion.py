"""Relative motion of two drones that follow their commands with a lag.

Drones keep clear of each other in an ellipsoid. Space is scaled so that the ellipsoid is a ball.
"""

import math

from crazychoir.numerics.kernels import kernel
from crazychoir.numerics.math3d import STANDARD_GRAVITY, Triple, rotation_columns
from crazychoir.types import Vec

LEAST_VERTICAL_AXIS = 0.3
"""Least vertical component of z_b: limits the sideways acceleration of a drone on its side."""

PlaceAndVelocity = tuple[Triple, Triple]
"""Place m and velocity m/s."""


@kernel()
def compute_tilt_acceleration(q: Vec, a: Vec) -> Triple:
    """Return the acceleration of a drone, (3,) m/s2.

    Horizontally it follows from the attitude, g z_b,xy / z_b,z. Vertically it is the command.

    q: (4,): attitude
    a: (3,) m/s2: commanded acceleration
    """
    _, _, z = rotation_columns((q[0], q[1], q[2], q[3]))
    s = STANDARD_GRAVITY / max(z[2], LEAST_VERTICAL_AXIS)
    return (s * z[0], s * z[1], a[2])


@kernel()
def compute_late_motion(x: Vec, a: Vec, lag: float) -> PlaceAndVelocity:
    """Return p~ in m and v~ in m/s of a drone with lag, see predict_late_motion.

    x: (13,): state
    a: (3,) m/s2: u, the command
    lag: T, s
    """
    now = compute_tilt_acceleration(x[6:10], a)
    return (
        (x[0] + lag * x[3], x[1] + lag * x[4], x[2] + lag * x[5]),
        (x[3] + lag * now[0], x[4] + lag * now[1], x[5] + lag * now[2]),
    )


@kernel()
def move_late(
    p: Triple, v: Triple, a: Triple, t: float, lasts: float
) -> PlaceAndVelocity:
    """Return p~ in m and v~ in m/s after t s.

    p: m, p~ now
    v: m/s, v~ now
    a: (3,) m/s2: u, the command
    t: s
    lasts: s for which the command is valid; after this it is zero
    """
    held = min(t, lasts)
    h = held * (t - 0.5 * held)
    return (
        (
            p[0] + t * v[0] + h * a[0],
            p[1] + t * v[1] + h * a[1],
            p[2] + t * v[2] + h * a[2],
        ),
        (v[0] + held * a[0], v[1] + held * a[1], v[2] + held * a[2]),
    )


@kernel()
def predict_late_motion(
    x: Vec, a: Vec, lag: float, t: float, lasts: float
) -> PlaceAndVelocity:
    """Return p~ in m and v~ in m/s of a drone with lag, t s from now.

        p~ = p + T v,   v~ = v + T a_t,   p~' = v~,   v~' = u      because  a_t' = (u - a_t) / T

    A command u acts on p~ and v~ at once (a double integrator), and p follows p~ with the lag T. The
    acceleration a_t is the result of `compute_tilt_acceleration`.

    x: (13,): state
    a: (3,) m/s2: u, the command
    lag: T, s
    t: s from now
    lasts: s for which the command is valid; after this it is zero
    """
    p, v = compute_late_motion(x, a, lag)
    return move_late(p, v, (a[0], a[1], a[2]), t, lasts)


@kernel()
def predict_braking(p: Triple, v: Triple, k: float, t: float) -> PlaceAndVelocity:
    """Return position and velocity after t s of braking with the acceleration -k v.

    p: m
    v: m/s
    k: 1/s
    t: s
    """
    left = math.exp(-k * t)
    far = (1.0 - left) / k
    return (p[0] + far * v[0], p[1] + far * v[1], p[2] + far * v[2]), (
        left * v[0],
        left * v[1],
        left * v[2],
    )


@kernel()
def scale_difference(a: Triple, b: Triple, scale: Triple) -> Triple:
    """Return S (a - b), S = diag(scale)."""
    return (
        scale[0] * (a[0] - b[0]),
        scale[1] * (a[1] - b[1]),
        scale[2] * (a[2] - b[2]),
    )


@kernel()
def compute_norm(a: Triple) -> float:
    """Return |a|."""
    return math.sqrt(a[0] * a[0] + a[1] * a[1] + a[2] * a[2])


@kernel()
def limit_norm(a: Triple, limit: float) -> Triple:
    """Return a, shortened to the length `limit` if it is longer."""
    s = limit / max(compute_norm(a), limit)
    return (s * a[0], s * a[1], s * a[2])
