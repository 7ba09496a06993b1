"""Buffered Voronoi cells: each drone can always stop on its own side of the plane midway."""

import math

from crazychoir.numerics.kernels import kernel
from crazychoir.numerics.math3d import Triple, dot
from crazychoir.safety.collision.barrier import compute_closing_speed


@kernel()
def compute_cell_acceleration(
    r: Triple,
    w: Triple,
    own: Triple,
    gap: float,
    unsure: float,
    brake: float,
    stiff: float,
    gamma: float,
) -> float:
    """Return the least acceleration of this drone away from its border, n . S u_i, m/s2.

        h = s(d) + n . S v_i - unsure >= 0,   d = (|r| - D) / 2,   n = r / |r|
        h' + gamma h >= 0:   n . S u_i >= - gamma h - s' n . w / 2 - n' . S v_i,
        n' = (w - n (n . w)) / |r|

    The point where the drone stops stays in its cell, which ends D / 2 before the plane midway.

    r: m, relative place, scaled by S
    w: m/s, relative velocity, scaled by S
    own: m/s, S v_i
    gap: m, |r| - D
    unsure: m/s
    brake: m/s2, of this drone, in s of `compute_closing_speed`
    stiff: 1/s, in s of `compute_closing_speed`
    gamma: 1/s
    Source: Zhou, Wang, Bandyopadhyay & Schwager 2017, IEEE RA-L 2(2): the cells, there for places
        only.
    """
    d = math.sqrt(dot(r, r))
    closing = dot(r, w) / d
    away = dot(r, own) / d
    speed, slope = compute_closing_speed(0.5 * gap, brake, stiff)
    return (
        -gamma * (speed + away - unsure)
        - 0.5 * slope * closing
        - (dot(w, own) - closing * away) / d
    )
