"""The pose gate: a pose that jumps is that of another body, or a mistake of the cameras."""

import math
from collections import deque
from dataclasses import dataclass

from crazychoir.types import Pose


@dataclass(frozen=True, slots=True)
class PoseGateLimits:
    """What a body can do between two poses, and when doubted poses are believed after all."""

    jump: float = 0.12
    """Distance in m that noise, markers and delays may add between two poses."""
    acceleration: float = 6.0
    """Acceleration in m/s2 that no drone exceeds."""
    largest_jump: float = 0.5
    """Distance in m that no gap in the poses can explain."""
    turn: float = math.radians(40.0)
    """Angle in rad that noise may add between two poses."""
    turn_rate: float = 10.0
    """Turn rate in rad/s that is allowed beyond."""
    velocity_time: float = 0.03
    """Least time in s over which the velocity is taken."""
    kept_time: float = 0.5
    """Seconds for which poses are kept for the velocity."""
    unknown_speed: float = 3.0
    """Speed in m/s that is allowed while the velocity is not known yet."""
    believing_time: float = 0.06
    """Seconds for which doubted poses must continue each other until they are believed.

    This holds if the first of them was in reach.
    """


POSE_GATE_LIMITS = PoseGateLimits()


Triple = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]
SeenPose = tuple[float, Triple, Quaternion]
"""Time in s, place (3,) m, attitude (4,)."""


class PoseGate:
    """Judges the poses of one body in flight.

        |p - (p_0 + v_0 h)| <= min(jump + acceleration h^2 / 2, largest_jump)
        angle(q_0, q) <= turn + turn_rate h

    p_0 m, v_0 m/s and the attitude q_0 are those of the last believed pose, h s ago. Before v_0 is
    known, |p - p_0| <= min(jump + unknown_speed h, largest_jump). The limits are those of POSE_GATE_LIMITS.

    Poses that continue a doubted pose are doubted too, however long. There is one exception: if the
    first doubted pose was within min(jump + |v_0| h + acceleration h^2 / 2, largest_jump) of p_0, they are
    believed after POSE_GATE_LIMITS.believing_time s. v_0 may have been wrong, because late poses arrive together.
    """

    def __init__(self) -> None:
        self._last: deque[SeenPose] = deque()
        self._doubted: deque[SeenPose] = deque()
        self._sure_at = math.inf  # s, when the doubted poses are believed

    def believes(self, pose: Pose, now: float, flying: bool) -> bool:
        """Take in a pose at the time `now` in s, and return whether it is believed.

        On the ground all poses are believed: a drone may be carried about.
        """
        x, y, z, *turn = pose.flat.tolist()
        seen = (now - pose.age, (x, y, z), (turn[0], turn[1], turn[2], turn[3]))
        if flying and self._last:
            if self._doubted and _is_continuation(self._doubted, seen):
                if seen[0] < self._sure_at:
                    _keep_recent(self._doubted, seen)
                    return False
                self._last = self._doubted
            elif not _is_continuation(self._last, seen):
                self._doubt(seen)
                return False
        elif not flying:
            self._last.clear()
        _keep_recent(self._last, seen)
        self._doubted = deque()
        return True

    def _doubt(self, seen: SeenPose) -> None:
        """Keep the first pose that does not continue the earlier ones."""
        (t_0, p_0, q_0), (t, p, q) = self._last[-1], seen
        h = max(t - t_0, 0.0)
        v = _estimate_velocity(self._last)
        speed = POSE_GATE_LIMITS.unknown_speed if v is None else math.hypot(*v)
        reach = min(
            POSE_GATE_LIMITS.jump
            + speed * h
            + 0.5 * POSE_GATE_LIMITS.acceleration * h * h,
            POSE_GATE_LIMITS.largest_jump,
        )
        in_reach = math.dist(p, p_0) <= reach and _may_turn(q_0, q, h)
        self._doubted = deque([seen])
        self._sure_at = t + POSE_GATE_LIMITS.believing_time if in_reach else math.inf


def _keep_recent(before: deque[SeenPose], seen: SeenPose) -> None:
    """Add a pose to those of the last POSE_GATE_LIMITS.kept_time s."""
    while before and before[0][0] <= seen[0] - POSE_GATE_LIMITS.kept_time:
        before.popleft()
    before.append(seen)


def _is_continuation(before: deque[SeenPose], seen: SeenPose) -> bool:
    """Return whether a pose continues these."""
    (t_0, p_0, q_0), (t, p, q) = before[-1], seen
    h = max(t - t_0, 0.0)
    v = _estimate_velocity(before)
    if v is None:
        far = POSE_GATE_LIMITS.jump + POSE_GATE_LIMITS.unknown_speed * h
        ahead = p_0
    else:
        far = POSE_GATE_LIMITS.jump + 0.5 * POSE_GATE_LIMITS.acceleration * h * h
        ahead = (p_0[0] + h * v[0], p_0[1] + h * v[1], p_0[2] + h * v[2])
    return math.dist(p, ahead) <= min(far, POSE_GATE_LIMITS.largest_jump) and _may_turn(
        q_0, q, h
    )


def _may_turn(a: Quaternion, b: Quaternion, h: float) -> bool:
    """Return whether a body can turn from one attitude to the other in h s."""
    cosine = abs(a[0] * b[0] + a[1] * b[1] + a[2] * b[2] + a[3] * b[3])
    return (
        2.0 * math.acos(min(1.0, cosine))
        <= POSE_GATE_LIMITS.turn + POSE_GATE_LIMITS.turn_rate * h
    )


def _estimate_velocity(seen: deque[SeenPose]) -> Triple | None:
    """Return the velocity in m/s; None if there are too few poses."""
    t, p, _ = seen[-1]
    for s, r, _ in reversed(seen):
        if t - s >= POSE_GATE_LIMITS.velocity_time:
            h = t - s
            return (p[0] - r[0]) / h, (p[1] - r[1]) / h, (p[2] - r[2]) / h
    return None
