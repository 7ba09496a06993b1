"""Velocities from the poses of motion capture, by a derivative and a low-pass."""

import math
from typing import NamedTuple

import numpy as np

from crazychoir.filters.motion import ConstantVelocity, MotionModel, predict_coasting
from crazychoir.numerics.kernels import kernel, memory, real, vector
from crazychoir.numerics.math3d import (
    normalize_quaternion,
    quaternion_conjugate,
    quaternion_product,
    rotation_logarithm,
)
from crazychoir.types import Pose, State, Vec


@kernel(vector)
def is_readable(pose: Vec) -> bool:
    """Return whether a pose (7,) is finite and its quaternion needs no more than normalising."""
    for c in range(7):
        if not math.isfinite(pose[c]):
            return False
    squared = pose[3] ** 2 + pose[4] ** 2 + pose[5] ** 2 + pose[6] ** 2
    return bool(0.25 <= squared <= 4.0)


@kernel(vector, memory, real, real, real, memory)
def _differentiate_pose(
    pose: Vec, mem: Vec, h: float, cutoff: float, t: float, out: Vec
) -> float:
    """Take in a pose measured h seconds after the last one, and return the speed in m/s.

    pose: (7,)
    mem: (13,): p, v, q, w of the last pose, replaced by those of this one
    h: s
    cutoff: rad/s
    t: s
    out: (13,): the state t s after the pose
    Returns -1, and changes nothing, for a pose that is not readable.
    """
    if not is_readable(pose):
        return -1.0
    keep = math.exp(-cutoff * h)
    gain = (1.0 - keep) / h
    q = normalize_quaternion((pose[3], pose[4], pose[5], pose[6]))
    turn = rotation_logarithm(
        quaternion_product(quaternion_conjugate((mem[6], mem[7], mem[8], mem[9])), q)
    )
    for c in range(3):
        mem[3 + c] = keep * mem[3 + c] + gain * (pose[c] - mem[c])
        mem[10 + c] = keep * mem[10 + c] + gain * turn[c]
        mem[c] = pose[c]
    mem[6], mem[7], mem[8], mem[9] = q
    predict_coasting(mem, t, out)
    return math.sqrt(mem[3] ** 2 + mem[4] ** 2 + mem[5] ** 2)


class PoseTiming(NamedTuple):
    """How the times of poses follow the steady rate of the cameras."""

    seen_time_weight: float = 0.002
    """Weight of the arrival in the time of a measurement; the rest comes from the rate of the
    cameras.
    """
    rounding: float = 1e-9
    """s, differences below it are rounding."""
    early_share: float = 0.25
    """Share of a period by which a pose may seem early; by the rest of the period it may seem
    late.
    """
    least_period_share: float = 0.2
    """Least share of a period between two poses that are on time.

    Poses that come sooner were late and arrive together, for example after the program stood still.
    Their delays are unknown, but the cameras saw them one period apart. With the times of arrival, a
    drone at 1 m/s would seem to fly at 50 m/s.
    """


POSE_TIMING = PoseTiming()


def compute_lateness(h: float, period: float) -> float:
    """Return by how many s a pose is late.

    h: s since the last pose
    period: s, between two poses of the cameras
    """
    whole = period * int(h / period + POSE_TIMING.early_share)
    late = h - whole
    return (
        (1.0 - POSE_TIMING.seen_time_weight) * late
        if whole and abs(late) > POSE_TIMING.rounding
        else 0.0
    )


class VelocityFilter:
    """Derivative and first-order low-pass of position and attitude, for poses at any rate.

        v' = cutoff (p' - v),   w' = cutoff (log(q_k^-1 q_k+1) / h - w)

    It is integrated exactly for a p that is linear between two samples:

        v_k = e v_k-1 + (1 - e) (p_k - p_k-1) / h,   e = exp(-cutoff h)

    h is the measured time between the samples. w is in body axes; no angle wraps.

    The state is extrapolated from the time of the measurement to `now` at constant velocity. Without
    poses it continues from there by the model `motion` under `commanded`. Its arrays are read-only:
    many readers share them.

    Cameras have a steady rate, but their poses arrive some 0.1 ms late, and sometimes later. So the
    time of a measurement follows the rate of the cameras, and is corrected slowly by the times at
    which poses arrive. Then h does not jitter.

    Poses that are not finite count as missing, and so do poses with a quaternion length outside
    0.5 to 2.

    cutoff: rad/s
    horizon: s, longest prediction
    period: s, of the cameras; 0 if they have no steady rate
    motion: model without poses; None for constant velocity
    """

    def __init__(
        self,
        cutoff: float = 50.0,
        horizon: float = 0.5,
        period: float = 0.0,
        motion: MotionModel | None = None,
    ) -> None:
        self.cutoff = cutoff
        self.horizon = horizon
        self.period = period
        self.motion = ConstantVelocity() if motion is None else motion
        self.commanded: Vec = np.zeros(4)
        """(4,): thrust N, body rates rad/s; the sender of the commands sets it."""
        self.refused = 0
        """Number of poses that were not used."""
        self.speed = 0.0
        """m/s, of the newest state."""
        self._memory = np.zeros(13)
        self.measured = -math.inf
        """Time in s of the last measurement."""
        self._state: State | None = None

    def update(self, pose: Pose, now: float) -> State | None:
        """Return the state at `now` with a new pose; None only before the first valid pose."""
        age = pose.age
        h = now - age - self.measured
        if h <= 1e-6:  # a repeated or an older pose says nothing new
            return self.predict(now)
        if self._state is None:
            return self._start(pose, now)
        if self.period > 0.0:  # the rate of the cameras tells it better than a clock
            late = compute_lateness(h, self.period)
            age = age + late
            h = h - late
            if h < POSE_TIMING.least_period_share * self.period:
                h = self.period
        out = np.empty(13)
        t = age if age < self.horizon else self.horizon
        speed = _differentiate_pose(pose.flat, self._memory, h, self.cutoff, t, out)
        if speed >= 0.0:
            out.setflags(False)  # type: ignore[call-arg]  # faster by position than by name, in each tick
            self.speed = speed
            self.measured = now - age
            self._state = state = State(out, age)
            return state
        self.refused += 1
        return self.predict(now)

    def predict(self, now: float) -> State | None:
        """Return the state at `now` without a new pose, by the model of motion.

        Returns None before the first pose.
        """
        last = self._state
        if last is None:
            return None
        age = now - self.measured
        further = min(age, self.horizon) - min(last.age, self.horizon)
        out = self.motion.after(last.flat, self.commanded, max(further, 0.0))
        out.setflags(write=False)
        self.speed = math.sqrt(out[3] * out[3] + out[4] * out[4] + out[5] * out[5])
        self._state = state = State(out, age)
        return state

    def _start(self, pose: Pose, now: float) -> State | None:
        """Take the first pose, at rest."""
        if not is_readable(pose.flat):
            self.refused += 1
            return None
        self._memory[0:3] = pose.p
        self._memory[6:10] = normalize_quaternion(tuple(pose.q))
        self.measured = now - pose.age
        self._state = State(self._memory.copy(), pose.age)
        return self.predict(now)
