"""Projector, rotations and saturation that several rooms share.

The world is ENU, z up. Quaternions are [x, y, z, w], body to world. Compiled functions take
quaternions and vectors as tuples or arrays of floats; they return tuples, so that a kernel
allocates no small arrays.
"""

import math

import numpy as np

from crazychoir.numerics.kernels import kernel
from crazychoir.types import Mat, Vec

Triple = tuple[float, float, float]
"""A vector (x, y, z)."""
Quaternion = tuple[float, float, float, float]
"""A quaternion (x, y, z, w)."""

STANDARD_GRAVITY = 9.80665  # m/s2, standard gravity
UPWARD_AXIS = np.array([0.0, 0.0, 1.0])
"""The unit vector upwards, world."""


def projector(d: Vec) -> Mat:
    """Return the orthogonal projector onto the plane normal to d.

        P = I - d d^T / |d|^2

    d: (3,) m, not zero
    Returns (3, 3), symmetric: P d = 0, P P = P.
    Source: Zhao & Zelazo 2017, IEEE TCNS 4(3).
    """
    return np.eye(3) - np.outer(d, d) / (d @ d)


def skew(w: Vec) -> Mat:
    """Return the matrix S (3, 3) with S v = w x v."""
    return np.array([[0.0, -w[2], w[1]], [w[2], 0.0, -w[0]], [-w[1], w[0], 0.0]])


def saturate(v: Vec, limit: float) -> Vec:
    """Return v shortened to the length `limit` if it is longer, with the same direction."""
    length = float(np.linalg.norm(v))
    return v if length <= limit else v * (limit / length)


@kernel()
def clip(value: float, low: float, high: float) -> float:
    """Return the value limited to the range from low to high."""
    return min(max(value, low), high)


@kernel()
def is_finite(x: Vec) -> bool:
    """Return whether all elements of x (n,) are finite numbers."""
    nothing = 0.0
    for c in range(x.shape[0]):
        nothing += 0.0 * x[c]
    return nothing == 0.0


@kernel()
def wrap_angle(angle: float) -> float:
    """Return the equal angle in [-pi, pi), rad."""
    return angle - 2.0 * math.pi * math.floor((angle + math.pi) / (2.0 * math.pi))


@kernel()
def quaternion_product(a: Quaternion, b: Quaternion) -> Quaternion:
    """Return the quaternion product a b: first the rotation b, then the rotation a."""
    return (
        a[3] * b[0] + a[0] * b[3] + a[1] * b[2] - a[2] * b[1],
        a[3] * b[1] - a[0] * b[2] + a[1] * b[3] + a[2] * b[0],
        a[3] * b[2] + a[0] * b[1] - a[1] * b[0] + a[2] * b[3],
        a[3] * b[3] - a[0] * b[0] - a[1] * b[1] - a[2] * b[2],
    )


@kernel()
def quaternion_conjugate(q: Quaternion) -> Quaternion:
    """Return the inverse rotation of a unit quaternion."""
    return (-q[0], -q[1], -q[2], q[3])


@kernel()
def normalize_quaternion(q: Quaternion) -> Quaternion:
    """Return q scaled to length 1."""
    n = 1.0 / math.sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3])
    return (q[0] * n, q[1] * n, q[2] * n, q[3] * n)


@kernel()
def rotation_exponential(x: float, y: float, z: float) -> Quaternion:
    """Return the unit quaternion of the rotation vector (x, y, z), rad.

    q = (sin(a/2) r/a, cos(a/2)),  a = |r|
    """
    a = math.sqrt(x * x + y * y + z * z)
    s = 0.5 - a * a / 48.0 if a < 1e-4 else math.sin(0.5 * a) / a
    return (s * x, s * y, s * z, math.cos(0.5 * a))


@kernel()
def rotation_logarithm(q: Quaternion) -> Triple:
    """Return the rotation vector of a unit quaternion, rad, for the shorter rotation: |r| <= pi."""
    sign = 1.0 if q[3] >= 0.0 else -1.0
    s = math.sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2])
    f = 2.0 * sign if s < 1e-9 else sign * 2.0 * math.atan2(s, abs(q[3])) / s
    return (f * q[0], f * q[1], f * q[2])


@kernel()
def rotation_columns(q: Quaternion) -> tuple[Triple, Triple, Triple]:
    """Return the body axes x_b, y_b, z_b in the world: the columns of R(q) for q of length 1."""
    x = q[0]
    y = q[1]
    z = q[2]
    w = q[3]
    return (
        (1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y + z * w), 2.0 * (x * z - y * w)),
        (2.0 * (x * y - z * w), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z + x * w)),
        (2.0 * (x * z + y * w), 2.0 * (y * z - x * w), 1.0 - 2.0 * (x * x + y * y)),
    )


@kernel()
def dot(a: Triple, b: Triple) -> float:
    """Return the scalar product a . b."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@kernel()
def cross(a: Triple, b: Triple) -> Triple:
    """Return the vector product a x b."""
    return (
        a[1] * b[2] - a[2] * b[1],
        a[2] * b[0] - a[0] * b[2],
        a[0] * b[1] - a[1] * b[0],
    )


@kernel()
def flat_attitude(f: Triple, yaw: float) -> tuple[Triple, Triple, Triple]:
    """Return the body axes (x_b, y_b, z_b) that push along f and point the nose towards yaw.

        z_b = f / |f|,  y_b = (z_b x x_c) / |z_b x x_c|,  x_b = y_b x z_b
        x_c = (cos yaw, sin yaw, 0)

    f = 0 gives the level attitude. For z_b along x_c, y_b = (-sin yaw, cos yaw, 0).

    f: (3,) m/s2 or N, world
    yaw: rad
    Source: Mellinger & Kumar 2011, ICRA.
    """
    c = math.cos(yaw)
    s = math.sin(yaw)
    n = math.sqrt(dot(f, f))
    z = (f[0] / n, f[1] / n, f[2] / n) if n > 1e-9 else (0.0, 0.0, 1.0)
    y = (-z[2] * s, z[2] * c, z[0] * s - z[1] * c)
    m = math.sqrt(dot(y, y))
    y = (y[0] / m, y[1] / m, y[2] / m) if m > 1e-6 else (-s, c, 0.0)
    x = (
        y[1] * z[2] - y[2] * z[1],
        y[2] * z[0] - y[0] * z[2],
        y[0] * z[1] - y[1] * z[0],
    )
    return x, y, z


@kernel()
def flat_rates(
    f: Triple,
    j: Triple,
    axes: tuple[Triple, Triple, Triple],
    yaw: float,
    yaw_rate: float,
) -> Triple:
    """Return the body rates (p, q, r) of `flat_attitude` in rad/s while f and yaw change.

        h = (j - (z_b . j) z_b) / |f|,  p = - h . y_b,  q = h . x_b
        r = (p z_b . x_c + yaw' y_b . y_c) / (x_b . x_c)

    The equation for r is the time derivative of y_b . x_c = 0.

    f: (3,) m/s2 or N, world
    j: (3,) change of f in a second
    axes: x_b, y_b, z_b from `flat_attitude`
    yaw: rad
    yaw_rate: rad/s, change of yaw
    """
    x, y, z = axes
    length = math.sqrt(dot(f, f))
    p = -dot(j, y) / length
    q = dot(j, x) / length
    c = math.cos(yaw)
    s = math.sin(yaw)
    return (
        p,
        q,
        (p * (z[0] * c + z[1] * s) + yaw_rate * (y[1] * c - y[0] * s))
        / (x[0] * c + x[1] * s),
    )


def rotation(q: Vec) -> Mat:
    """Return R (3, 3), body to world, of the unit quaternion q (4,)."""
    return np.array(rotation_columns(tuple(q))).T


def rotation_from_flat(f: Vec, yaw: float) -> Mat:
    """Return R (3, 3) of `flat_attitude`: thrust along f (3,), heading yaw in rad."""
    return np.array(flat_attitude(tuple(f), yaw)).T


def quaternion(r: Mat) -> Vec:
    """Return the unit quaternion (4,), w >= 0, of the rotation matrix r (3, 3), body to world.

    Source: Shepperd 1978: divide by the largest of the four squares.
    """
    trace = float(np.trace(r))
    squares = np.array([r[0, 0], r[1, 1], r[2, 2], trace])
    i = int(np.argmax(squares))
    if i == 3:
        q = np.array(
            [r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1], 1.0 + trace]
        )
    else:
        j = (i + 1) % 3
        k = (i + 2) % 3
        q = np.empty(4)
        q[i] = 1.0 + 2.0 * r[i, i] - trace
        q[j] = r[j, i] + r[i, j]
        q[k] = r[k, i] + r[i, k]
        q[3] = r[k, j] - r[j, k]
    q /= np.linalg.norm(q)
    return q if q[3] >= 0.0 else -q


def quaternion_of_yaw(yaw: float) -> Vec:
    """Return the unit quaternion (4,) of the level attitude with heading yaw in rad."""
    return np.array([0.0, 0.0, math.sin(0.5 * yaw), math.cos(0.5 * yaw)])


@kernel()
def compute_yaw(q: Quaternion) -> float:
    """Return the heading of the body's x axis in the world, rad, in (-pi, pi], in compiled code."""
    return math.atan2(
        2.0 * (q[0] * q[1] + q[2] * q[3]),
        1.0 - 2.0 * (q[1] * q[1] + q[2] * q[2]),
    )


def yaw_of(q: Vec) -> float:
    """Return the heading of the body's x axis in the world, rad, in (-pi, pi]."""
    x, y, z, w = (float(c) for c in q)
    return math.atan2(2.0 * (x * y + z * w), 1.0 - 2.0 * (y * y + z * z))
