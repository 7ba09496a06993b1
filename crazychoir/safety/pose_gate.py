"""Whether a pose can be that of the body that was seen last: one that jumps is another body's, or a mistake."""

import math

import numpy as np

from crazychoir.math3d import Vec
from crazychoir.types import Pose

JUMP, HARDEST, FARTHEST = 0.12, 6.0, 0.5
"""m, m/s2, m: noise, markers and delays; what no drone of ours accelerates by; and what no gap excuses."""
TURN, FASTEST = math.radians(40.0), 10.0
"""rad, and rad/s beyond."""
LATELY, KEPT = 0.03, 0.5
"""s, at least, over which the velocity is taken; and for which poses are kept for it."""
UNKNOWN = 3.0
"""m/s, with which one may fly whose velocity is not known yet."""


class PoseGate:
    """Judges the poses of one body in flight.

        |p - (p_0 + v_0 h)| <= min(JUMP + HARDEST h^2 / 2, FARTHEST),   angle(q_0, q) <= TURN + FASTEST h

    p_0, v_0, q_0: m, m/s, and the attitude, of the last pose that was believed;  h: s since then.  Before v_0 is known,
    |p - p_0| <= min(JUMP + UNKNOWN h, FARTHEST).
    """

    def __init__(self) -> None:
        self._last: list[tuple[float, Vec, Vec]] = []

    def believes(self, pose: Pose, now: float, flying: bool) -> bool:
        """Take in a pose of `now`, s; on the ground a drone may be carried about."""
        born = now - pose.age
        if flying and self._last and not self._near(pose, born):
            return False
        self._last = [one for one in self._last if flying and one[0] > born - KEPT]
        self._last.append((born, pose.p.copy(), pose.q.copy()))
        return True

    def _near(self, pose: Pose, born: float) -> bool:
        t, p, q = self._last[-1]
        h = max(born - t, 0.0)
        v = self._velocity()
        gap = float(np.linalg.norm(pose.p - (p if v is None else p + h * v)))
        far = JUMP + (UNKNOWN * h if v is None else 0.5 * HARDEST * h * h)
        angle = 2.0 * math.acos(min(1.0, abs(float(q @ pose.q))))
        return gap <= min(far, FARTHEST) and angle <= TURN + FASTEST * h

    def _velocity(self) -> Vec | None:
        t, p, _ = self._last[-1]
        first = next(((s, r) for s, r, _ in reversed(self._last) if t - s >= LATELY), None)
        return None if first is None else (p - first[1]) / (t - first[0])
