"""The pose gate: a pose that jumps is that of another body, or a mistake of the cameras."""

import math
from collections import deque

from crazychoir.types import Pose

JUMP = 0.12
"""Distance in m that noise, markers and delays may add between two poses."""
HARDEST = 6.0
"""Acceleration in m/s2 that no drone exceeds."""
FARTHEST = 0.5
"""Distance in m that no gap in the poses can explain."""
TURN = math.radians(40.0)
"""Angle in rad that noise may add between two poses."""
FASTEST = 10.0
"""Turn rate in rad/s that is allowed beyond."""
LATELY = 0.03
"""Least time in s over which the velocity is taken."""
KEPT = 0.5
"""Seconds for which poses are kept for the velocity."""
UNKNOWN = 3.0
"""Speed in m/s that is allowed while the velocity is not known yet."""


SURE = 0.06
"""Seconds for which doubted poses must continue each other until they are believed.

This holds if the first of them was in reach.
"""

Triple = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]
Seen = tuple[float, Triple, Quaternion]
"""Time in s, place (3,) m, attitude (4,)."""


class PoseGate:
    """Judges the poses of one body in flight.

        |p - (p_0 + v_0 h)| <= min(JUMP + HARDEST h^2 / 2, FARTHEST)
        angle(q_0, q) <= TURN + FASTEST h

    p_0 m, v_0 m/s and the attitude q_0 are those of the last believed pose, h s ago. Before v_0 is
    known, |p - p_0| <= min(JUMP + UNKNOWN h, FARTHEST).

    Poses that continue a doubted pose are doubted too, however long. There is one exception: if the
    first doubted pose was within min(JUMP + |v_0| h + HARDEST h^2 / 2, FARTHEST) of p_0, they are
    believed after SURE s. v_0 may have been wrong, because late poses arrive together.
    """

    def __init__(self) -> None:
        self._last: deque[Seen] = deque()
        self._doubted: deque[Seen] = deque()
        self._sure_at = math.inf  # s, when the doubted poses are believed

    def believes(self, pose: Pose, now: float, flying: bool) -> bool:
        """Take in a pose at the time `now` in s, and return whether it is believed.

        On the ground all poses are believed: a drone may be carried about.
        """
        x, y, z, *turn = pose.flat.tolist()
        seen = (now - pose.age, (x, y, z), (turn[0], turn[1], turn[2], turn[3]))
        if flying and self._last:
            if self._doubted and _near(self._doubted, seen):
                if seen[0] < self._sure_at:
                    _keep(self._doubted, seen)
                    return False
                self._last = self._doubted
            elif not _near(self._last, seen):
                self._doubt(seen)
                return False
        elif not flying:
            self._last.clear()
        _keep(self._last, seen)
        self._doubted = deque()
        return True

    def _doubt(self, seen: Seen) -> None:
        """Keep the first pose that does not continue the earlier ones."""
        (t_0, p_0, q_0), (t, p, q) = self._last[-1], seen
        h = max(t - t_0, 0.0)
        v = _velocity(self._last)
        speed = UNKNOWN if v is None else math.hypot(*v)
        reach = min(JUMP + speed * h + 0.5 * HARDEST * h * h, FARTHEST)
        in_reach = math.dist(p, p_0) <= reach and _turns(q_0, q, h)
        self._doubted = deque([seen])
        self._sure_at = t + SURE if in_reach else math.inf


def _keep(before: deque[Seen], seen: Seen) -> None:
    """Add a pose to those of the last KEPT s."""
    while before and before[0][0] <= seen[0] - KEPT:
        before.popleft()
    before.append(seen)


def _near(before: deque[Seen], seen: Seen) -> bool:
    """Return whether a pose continues these."""
    (t_0, p_0, q_0), (t, p, q) = before[-1], seen
    h = max(t - t_0, 0.0)
    v = _velocity(before)
    if v is None:
        far = JUMP + UNKNOWN * h
        ahead = p_0
    else:
        far = JUMP + 0.5 * HARDEST * h * h
        ahead = (p_0[0] + h * v[0], p_0[1] + h * v[1], p_0[2] + h * v[2])
    return math.dist(p, ahead) <= min(far, FARTHEST) and _turns(q_0, q, h)


def _turns(a: Quaternion, b: Quaternion, h: float) -> bool:
    """Return whether a body can turn from one attitude to the other in h s."""
    cosine = abs(a[0] * b[0] + a[1] * b[1] + a[2] * b[2] + a[3] * b[3])
    return 2.0 * math.acos(min(1.0, cosine)) <= TURN + FASTEST * h


def _velocity(seen: deque[Seen]) -> Triple | None:
    """Return the velocity in m/s; None if there are too few poses."""
    t, p, _ = seen[-1]
    for s, r, _ in reversed(seen):
        if t - s >= LATELY:
            h = t - s
            return (p[0] - r[0]) / h, (p[1] - r[1]) / h, (p[2] - r[2]) / h
    return None
