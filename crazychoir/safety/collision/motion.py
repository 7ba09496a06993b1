"""How two drones move relative to each other, in a space in which both are balls, and as late as they obey."""

import math

from crazychoir.numerics.kernels import kernel
from crazychoir.numerics.math3d import GRAVITY, Triple, columns
from crazychoir.types import Vec

STEEPEST = 0.3
"""Of z_b along the vertical, at least: a drone on its side accelerates sideways by no more than this says."""

Motion = tuple[Triple, Triple]


@kernel()
def tilted(q: Vec, a: Vec) -> Triple:
    """The acceleration m/s2 of a drone: sideways by its attitude, g z_b,xy / z_b,z; upwards what it has commanded."""
    _, _, z = columns((q[0], q[1], q[2], q[3]))
    s = GRAVITY / max(z[2], STEEPEST)
    return (s * z[0], s * z[1], a[2])


@kernel()
def late(x: Vec, a: Vec, lag: float, t: float, lasts: float) -> Motion:
    """Place m and velocity m/s in which a drone that obeys late is a double integrator, moved on by t s.

        p~ = p + T v,   v~ = v + T a_t,   p~' = v~,   v~' = u      since  a_t' = (u - a_t) / T

    so that what it commands now acts on p~ and v~ at once, and p follows p~ by the lag T.  x: (13,) state;  u: a (3,),
    what it commands, for `lasts` s at most: then nothing;  a_t: of `tilted`;  lag: T, s.
    """
    now = tilted(x[6:10], a)
    v = (x[3] + lag * now[0], x[4] + lag * now[1], x[5] + lag * now[2])
    held = min(t, lasts)
    h = held * (t - 0.5 * held)
    p = (
        x[0] + lag * x[3] + t * v[0] + h * a[0],
        x[1] + lag * x[4] + t * v[1] + h * a[1],
        x[2] + lag * x[5] + t * v[2] + h * a[2],
    )
    return p, (v[0] + held * a[0], v[1] + held * a[1], v[2] + held * a[2])


@kernel()
def resting(p: Triple, v: Triple, k: float, t: float) -> Motion:
    """Where one is, and how fast, that has braked for t s by -k v."""
    left = math.exp(-k * t)
    far = (1.0 - left) / k
    return (p[0] + far * v[0], p[1] + far * v[1], p[2] + far * v[2]), (
        left * v[0],
        left * v[1],
        left * v[2],
    )


@kernel()
def scaled(a: Triple, b: Triple, scale: Triple) -> Triple:
    """S (a - b), S = diag(scale)."""
    return (
        scale[0] * (a[0] - b[0]),
        scale[1] * (a[1] - b[1]),
        scale[2] * (a[2] - b[2]),
    )


@kernel()
def length(a: Triple) -> float:
    """|a|."""
    return math.sqrt(a[0] * a[0] + a[1] * a[1] + a[2] * a[2])


@kernel()
def shrunk(a: Triple, limit: float) -> Triple:
    """a, no longer than `limit`."""
    s = limit / max(length(a), limit)
    return (s * a[0], s * a[1], s * a[2])
