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


SURE = 0.06
"""s for which poses go on from each other until they are believed again, if the first of them was in reach."""

Seen = tuple[float, Vec, Vec]


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
        self._last: list[Seen] = []
        self._doubted: list[Seen] = []
        self._sure_at = math.inf  # s, when what is doubted is believed

    def believes(self, pose: Pose, now: float, flying: bool) -> bool:
        """Take in a pose of `now`, s; on the ground a drone may be carried about."""
        seen = (now - pose.age, pose.p.copy(), pose.q.copy())
        if flying and self._last:
            if self._doubted and _near(self._doubted, seen):
                self._doubted = [*_lately(self._doubted, seen[0]), seen]
                if seen[0] < self._sure_at:
                    return False
                self._last = self._doubted[:-1]
            elif not _near(self._last, seen):
                self._doubt(seen)
                return False
        self._last = [*_lately(self._last if flying else [], seen[0]), seen]
        self._doubted = []
        return True

    def _doubt(self, seen: Seen) -> None:
        """The first pose that does not go on from those before."""
        (t_0, p_0, q_0), (t, p, q) = self._last[-1], seen
        h, v = max(t - t_0, 0.0), _velocity(self._last)
        speed = UNKNOWN if v is None else float(np.linalg.norm(v))
        reach = min(JUMP + speed * h + 0.5 * HARDEST * h * h, FARTHEST)
        in_reach = float(np.linalg.norm(p - p_0)) <= reach and _turns(q_0, q, h)
        self._doubted, self._sure_at = [seen], t + SURE if in_reach else math.inf


def _lately(seen: list[Seen], now: float) -> list[Seen]:
    return [one for one in seen if one[0] > now - KEPT]


def _near(before: list[Seen], seen: Seen) -> bool:
    """Whether a pose goes on from these."""
    (t_0, p_0, q_0), (t, p, q) = before[-1], seen
    h, v = max(t - t_0, 0.0), _velocity(before)
    gap = float(np.linalg.norm(p - (p_0 if v is None else p_0 + h * v)))
    far = JUMP + (UNKNOWN * h if v is None else 0.5 * HARDEST * h * h)
    return gap <= min(far, FARTHEST) and _turns(q_0, q, h)


def _turns(a: Vec, b: Vec, h: float) -> bool:
    """Whether a body turns so far in h s."""
    return 2.0 * math.acos(min(1.0, abs(float(a @ b)))) <= TURN + FASTEST * h


def _velocity(seen: list[Seen]) -> Vec | None:
    """m/s; None if they are too few."""
    t, p, _ = seen[-1]
    first = next(((s, r) for s, r, _ in reversed(seen) if t - s >= LATELY), None)
    return None if first is None else (p - first[1]) / (t - first[0])
