"""Velocities from the poses of motion capture."""

import math

import numpy as np

from crazychoir.math3d import Vec, conjugate, exponential, kernel, logarithm, memory, product, real, unit, vector
from crazychoir.types import Pose, State


@kernel(vector, real, memory)
def _extrapolate(mem: Vec, t: float, out: Vec) -> None:
    """The state t seconds after mem at constant velocity and body rate, into out (13,)."""
    out[:] = mem
    for c in range(3):
        out[c] += t * mem[3 + c]
    q = product((mem[6], mem[7], mem[8], mem[9]), exponential(t * mem[10], t * mem[11], t * mem[12]))
    out[6], out[7], out[8], out[9] = q


@kernel(vector, memory, real, real, real, memory)
def _measure(pose: Vec, mem: Vec, h: float, cutoff: float, t: float, out: Vec) -> bool:
    """Take in a pose measured h seconds after the last one: mem (13,) = p, v, q, w is replaced; out as _extrapolate."""
    for c in range(7):
        if not math.isfinite(pose[c]):
            return False
    keep = math.exp(-cutoff * h)
    gain = (1.0 - keep) / h
    q = unit((pose[3], pose[4], pose[5], pose[6]))
    turn = logarithm(product(conjugate((mem[6], mem[7], mem[8], mem[9])), q))
    for c in range(3):
        mem[3 + c] = keep * mem[3 + c] + gain * (pose[c] - mem[c])
        mem[10 + c] = keep * mem[10 + c] + gain * turn[c]
        mem[c] = pose[c]
    mem[6], mem[7], mem[8], mem[9] = q
    _extrapolate(mem, t, out)
    return True


TRUST = 0.002  # in the instant at which a pose seems to be measured; the rest in the rate of the cameras
ROUNDING = 1e-9  # s
EARLY = 0.25  # of a period that a pose may seem to be early; it may seem to be later by what is left


class VelocityFilter:
    """Derivative and first-order low-pass of position and attitude, right at any rate.

        v' = cutoff (p' - v),   w' = cutoff (log(q_k^-1 q_k+1) / h - w)

    integrated exactly for a p that is linear between two samples: v_k = e v_k-1 + (1 - e) (p_k - p_k-1) / h with
    e = exp(-cutoff h) and h the measured time between the samples. w is in body axes and knows no wrap of angles.
    The state is carried from the time of the measurement to `now` at constant velocity.

    Cameras have a steady rate, what tells when they saw a pose is late by some 0.1 ms and sometimes by more: the
    instant of the measurement follows their rate, and what is seen of it slowly, so that h does not jitter.

    cutoff: rad/s;  horizon: s, how far a prediction goes at most;  period: s of the cameras, 0 if they have no rate;
    measured: s, the instant of the last measurement.  Poses that are not finite count as missing.
    """

    def __init__(self, cutoff: float = 50.0, horizon: float = 0.5, period: float = 0.0) -> None:
        self.cutoff, self.horizon, self.period = cutoff, horizon, period
        self.refused = 0
        self._memory = np.zeros(13)
        self.measured = -math.inf

    def update(self, pose: Pose, now: float) -> State | None:
        """The state at `now` with a new pose; None only before the first pose that is finite."""
        h = now - pose.age - self.measured
        if h <= 1e-6:  # a repeated or an older pose says nothing new
            return self.predict(now)
        if h == math.inf:
            return self._start(pose, now)
        age, out = pose.age, np.empty(13)
        if self.period > 0.0:  # their rate tells it better than a clock
            whole = self.period * int(h / self.period + EARLY)
            if whole and abs(h - whole) > ROUNDING:
                late = (1.0 - TRUST) * (h - whole)
                age, h = age + late, h - late
        if _measure(pose.flat, self._memory, h, self.cutoff, min(age, self.horizon), out):
            self.measured = now - age
            return State(out, age)
        self.refused += 1
        return self.predict(now)

    def predict(self, now: float) -> State | None:
        """The state at `now` at constant velocity, when no pose has come; None before the first."""
        age = now - self.measured
        if age == math.inf:
            return None
        out = np.empty(13)
        _extrapolate(self._memory, min(age, self.horizon), out)
        return State(out, age)

    def _start(self, pose: Pose, now: float) -> State | None:
        """Take the first pose, at rest."""
        if np.all(np.isfinite(pose.flat)):
            self._memory[0:3], self._memory[6:10] = pose.p, pose.q / np.linalg.norm(pose.q)
            self.measured = now - pose.age
        else:
            self.refused += 1
        return self.predict(now)
