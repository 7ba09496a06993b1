"""Control barrier: two drones together can always stop before they meet."""

import math

from crazychoir.numerics.kernels import kernel
from crazychoir.numerics.math3d import Triple, dot

EVEN_SHARE_SPEED = 0.05
"""m/s, added to both speeds in `compute_yield_share`: drones that hardly move take half each."""


@kernel()
def compute_closing_speed(
    gap: float, brake: float, stiff: float
) -> tuple[float, float]:
    """Return how fast a gap may close, m/s, and the slope of this speed over the gap, 1/s.

        s(g) = k g  up to g0 = alpha / k^2,   sqrt(2 alpha (g - g0 / 2))  beyond

    At this speed the drone can still brake. The braking curve alone has an infinite slope at g = 0,
    at which a drone with a lag would shake, so it is replaced by a line there. Speed and slope are
    continuous. At a negative gap the speed is negative: the gap must open.

    gap: m, g
    brake: m/s2, alpha
    stiff: 1/s, k
    """
    knee = brake / (stiff * stiff)
    if gap < knee:
        return stiff * gap, stiff
    speed = math.sqrt(2.0 * brake * (gap - 0.5 * knee))
    return speed, brake / speed


@kernel()
def compute_barrier_acceleration(
    r: Triple,
    w: Triple,
    gap: float,
    unsure: float,
    brake: float,
    stiff: float,
    gamma: float,
) -> float:
    """Return the least relative acceleration n . r'', m/s2, that keeps two drones apart.

        h = s(|r| - D) + n . w - unsure >= 0,   n = r / |r|,   r'' = S (u_i - u_j)
        h' + gamma h >= 0:   n . r'' >= - gamma h - s' n . w - (|w|^2 - (n . w)^2) / |r|

    r: m, relative place, scaled by S
    w: m/s, relative velocity, scaled by S
    gap: m, |r| - D
    unsure: m/s by which the drones may approach faster than is known
    brake: m/s2, braking of both drones together: alpha of `compute_closing_speed`, which is s
    stiff: 1/s, k of `compute_closing_speed`
    gamma: 1/s, rate of the barrier
    Source: Borrmann, Wang, Ames & Egerstedt 2015, ADHS: the barrier; its derivative is derived
        here.
    """
    d = math.sqrt(dot(r, r))
    away = dot(r, w) / d
    speed, slope = compute_closing_speed(gap, brake, stiff)
    return (
        -gamma * (speed + away - unsure) - slope * away - (dot(w, w) - away * away) / d
    )


@kernel()
def compute_yield_share(own: float, others: float) -> float:
    """Return the share of a barrier's acceleration that one drone takes.

        c_i / (c_i + c_j),   c = EVEN_SHARE_SPEED + max(-speed, 0)

    The faster a drone approaches, the larger is its share: a drone at rest between two that approach
    it could not give way to both. The shares of both drones add up to 1.

    own: m/s, speed of this drone away from the other
    others: m/s, speed of the other away from this one
    """
    mine = EVEN_SHARE_SPEED + max(-own, 0.0)
    theirs = EVEN_SHARE_SPEED + max(-others, 0.0)
    return mine / (mine + theirs)
