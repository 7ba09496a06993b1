"""Buffered Voronoi cells: each drone can always stop on its own side of the plane midway to the other."""

import math

from crazychoir.math3d import Triple, dot, kernel
from crazychoir.safety.collision.barrier import PART, THIN


@kernel()
def cell(r: Triple, w: Triple, own: Triple, gap: float, unsure: float, brake: float, gamma: float) -> float:
    """What the drone itself must accelerate away from its side's border: n . S u_i >= the value, m/s2.

        h = sqrt(2 alpha d) + n . S v_i - unsure >= 0,   d = (|r| - D) / 2,   n = r / |r|
        h' + gamma h >= 0:   n . S u_i >= - gamma h - alpha d' / sqrt(2 alpha d) - n' . S v_i
        d' = n . w / 2,   n' = (w - n (n . w)) / |r|

    The point where it stops stays in its cell, which ends D / 2 before the plane midway.  r, w: relative place m and
    velocity m/s, scaled by S;  own: S v_i;  gap: |r| - D, m;  alpha: `brake`, m/s2, of this drone;  unsure: m/s;
    gamma: 1/s.  Outside its cell, h = PART d + n . S v_i.
    Source: Zhou, Wang, Bandyopadhyay & Schwager 2017, IEEE RA-L 2(2): the cells, there for places alone.
    """
    d = math.sqrt(dot(r, r))
    closing, side = dot(r, w) / d, 0.5 * gap
    away = dot(r, own) / d
    turning = (dot(w, own) - closing * away) / d
    if side < THIN:
        return -gamma * (PART * side + away - unsure) - PART * 0.5 * closing - turning
    root = math.sqrt(2.0 * brake * side)
    return -gamma * (root + away - unsure) - brake * 0.5 * closing / root - turning
