"""Control barrier: two drones together can always stop before they meet."""

import math

from crazychoir.numerics.kernels import kernel
from crazychoir.numerics.math3d import Triple, dot

EVEN = 0.05
"""m/s: of drones that hardly move each takes half."""


@kernel()
def approach(gap: float, brake: float, stiff: float) -> tuple[float, float]:
    """How fast a gap may close from which one must be able to brake, m/s, and how that changes with it, 1/s.

        s(g) = k g  up to g0 = alpha / k^2,   sqrt(2 alpha (g - g0 / 2))  beyond

    The braking curve, with its infinite slope cut off: a drone that obeys late would shake there. Continuous, and so is
    its slope. A gap that is negative opens.  gap: m;  alpha: `brake`, m/s2;  k: `stiff`, 1/s.
    """
    knee = brake / (stiff * stiff)
    if gap < knee:
        return stiff * gap, stiff
    speed = math.sqrt(2.0 * brake * (gap - 0.5 * knee))
    return speed, brake / speed


@kernel()
def barrier(
    r: Triple,
    w: Triple,
    gap: float,
    unsure: float,
    brake: float,
    stiff: float,
    gamma: float,
) -> float:
    """What both together must accelerate apart: n . r'' >= the value, m/s2.

        h = s(|r| - D) + n . w - unsure >= 0,   n = r / |r|,   r'' = S (u_i - u_j)
        h' + gamma h >= 0:   n . r'' >= - gamma h - s' n . w - (|w|^2 - (n . w)^2) / |r|

    r, w: relative place m and velocity m/s, scaled by S;  gap: |r| - D, m;  s: of `approach`, brake: m/s2, of both
    together;  unsure: m/s, by which they may come nearer faster than is known;  gamma: 1/s.
    Source: Borrmann, Wang, Ames & Egerstedt 2015, ADHS: the barrier; its derivative is this one's own.
    """
    d = math.sqrt(dot(r, r))
    away = dot(r, w) / d
    speed, slope = approach(gap, brake, stiff)
    return (
        -gamma * (speed + away - unsure) - slope * away - (dot(w, w) - away * away) / d
    )


@kernel()
def part(own: float, others: float) -> float:
    """The share of a barrier's acceleration that a drone takes: that of its speed towards the other, in both of theirs.

        c_i / (c_i + c_j),   c = EVEN + max(-speed, 0)

    Who stands between two that come nearer could not give way to both. The shares of both add up to 1.  own, others:
    m/s, apart.
    """
    mine = EVEN + max(-own, 0.0)
    theirs = EVEN + max(-others, 0.0)
    return mine / (mine + theirs)
