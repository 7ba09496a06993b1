"""Whether a pose can be that of the body that was seen last: one that jumps is another body's, or a mistake."""

import math
from collections import deque

from crazychoir.types import Pose

JUMP, HARDEST, FARTHEST = 0.12, 6.0, 0.5
"""m, m/s2, m: noise, markers and delays; what no drone of ours accelerates by; and what no gap excuses."""
TURN, FASTEST = math.radians(40.0), 10.0
"""rad, and rad/s beyond."""
LATELY, KEPT = 0.03, 0.5
"""s, at least, over which the velocity is taken; and for which poses are kept for it."""
UNKNOWN = 3.0
"""m/s, with which one may fly whose velocity is not known yet."""


SURE = 0.06
"""s for which poses go on from each other until they are believed again, if the first of them was in reach."""

Triple = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]
Seen = tuple[float, Triple, Quaternion]


class PoseGate:
    """Judges the poses of one body in flight.

        |p - (p_0 + v_0 h)| <= min(JUMP + HARDEST h^2 / 2, FARTHEST),   angle(q_0, q) <= TURN + FASTEST h

    p_0, v_0, q_0: m, m/s, and the attitude, of the last pose that was believed;  h: s since then.  Before v_0 is known,
    |p - p_0| <= min(JUMP + UNKNOWN h, FARTHEST).

    Poses that go on from one that was not believed are not either, however long, unless that one was within
    min(JUMP + |v_0| h + HARDEST h^2 / 2, FARTHEST) of p_0: then they are after SURE. v_0 may have been wrong: poses
    that were late come together.
    """

    def __init__(self) -> None:
        self._last: deque[Seen] = deque()
        self._doubted: deque[Seen] = deque()
        self._sure_at = math.inf  # s, when what is doubted is believed

    def believes(self, pose: Pose, now: float, flying: bool) -> bool:
        """Take in a pose of `now`, s; on the ground a drone may be carried about."""
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
        """The first pose that does not go on from those before."""
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
    """Whether a pose goes on from these."""
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
    """Whether a body turns so far in h s."""
    cosine = abs(a[0] * b[0] + a[1] * b[1] + a[2] * b[2] + a[3] * b[3])
    return 2.0 * math.acos(min(1.0, cosine)) <= TURN + FASTEST * h


def _velocity(seen: deque[Seen]) -> Triple | None:
    """m/s; None if they are too few."""
    t, p, _ = seen[-1]
    for s, r, _ in reversed(seen):
        if t - s >= LATELY:
            h = t - s
            return (p[0] - r[0]) / h, (p[1] - r[1]) / h, (p[2] - r[2]) / h
    return None
