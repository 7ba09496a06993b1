"""Control barrier: two drones together can always stop before they meet."""

import math

from crazychoir.math3d import Triple, dot, kernel

THIN = 1e-4
"""m: below this gap the braking curve counts as ended: drones that are too near part again."""
PART = 3.0
"""1/s, with which a gap that is negative closes."""


@kernel()
def barrier(r: Triple, w: Triple, gap: float, unsure: float, brake: float, gamma: float) -> float:
    """What both together must accelerate apart: n . r'' >= the value, m/s2.

        h = sqrt(2 alpha (|r| - D)) + n . w - unsure >= 0,   n = r / |r|,   r'' = S (u_i - u_j)
        h' + gamma h >= 0:   n . r'' >= - gamma h - alpha n . w / sqrt(2 alpha (|r| - D)) - (|w|^2 - (n . w)^2) / |r|

    r, w: relative place m and velocity m/s, scaled by S;  gap: |r| - D, m;  alpha: `brake`, m/s2, of both together;
    unsure: m/s, by which they may come nearer faster than is known;  gamma: 1/s.  Within D, h = PART (|r| - D) + n . w.
    Source: Borrmann, Wang, Ames & Egerstedt 2015, ADHS: the barrier; its derivative is this one's own.
    """
    d = math.sqrt(dot(r, r))
    closing = dot(r, w) / d
    turning = (dot(w, w) - closing * closing) / d
    if gap < THIN:
        return -gamma * (PART * gap + closing - unsure) - PART * closing - turning
    root = math.sqrt(2.0 * brake * gap)
    return -gamma * (root + closing - unsure) - brake * closing / root - turning
