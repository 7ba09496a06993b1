"""Point-to-point flight by a polynomial of degree 7."""

import math
from collections.abc import Callable

import numpy as np

from crazychoir.errors import ConfigError
from crazychoir.math3d import Mat, Vec, kernel, matrix, memory, real, table, vector, wrap
from crazychoir.types import FullState

PEAK_SPEED = 35.0 / 16.0  # of a rest-to-rest flight of 1 m in 1 s
PEAK_ACCELERATION = 84.0 * math.sqrt(5.0) / 25.0  # the same, m/s2
PEAK_DECELERATION = 15.0 / 8.0  # of a stop from 1 m/s in 1 s, m/s2
STOP = PEAK_DECELERATION / 2.0  # m, of a stop from 1 m/s with 1 m/s2
SHORTEST = 0.1  # s, of a flight to where one is


@kernel(vector, vector, real, real, table)
def _coefficients(start: Vec, goal: Vec, yaw: float, duration: float, out: Vec) -> None:
    """Coefficients out (4, 8) of x, y, z, yaw in s = t / T, ascending, from `start` (14,) to rest at goal (3,), yaw.

    c0..c3 are the start; c4..c7 close the remaining gaps of p, p', p'', p''' at s = 1.
    """
    for axis in range(4):
        c = out[axis]
        if axis < 3:
            p, v, a, j, end = start[axis], start[3 + axis], start[6 + axis], start[9 + axis], goal[axis]
        else:
            p, v, a, j, end = start[12], start[13], 0.0, 0.0, start[12] + wrap(yaw - start[12])
        c[0], c[1], c[2], c[3] = p, v * duration, a * duration**2 / 2.0, j * duration**3 / 6.0
        g0 = end - c[0] - c[1] - c[2] - c[3]
        g1 = -c[1] - 2.0 * c[2] - 3.0 * c[3]
        g2 = -2.0 * c[2] - 6.0 * c[3]
        g3 = -6.0 * c[3]
        c[4] = 35.0 * g0 - 15.0 * g1 + 2.5 * g2 - g3 / 6.0
        c[5] = -84.0 * g0 + 39.0 * g1 - 7.0 * g2 + 0.5 * g3
        c[6] = 70.0 * g0 - 34.0 * g1 + 6.5 * g2 - 0.5 * g3
        c[7] = -20.0 * g0 + 10.0 * g1 - 2.0 * g2 + g3 / 6.0


@kernel(matrix, real, real, memory)
def _sample(coefficients: Mat, duration: float, t: float, out: Vec) -> None:
    """The flat output at t, 0 <= t <= T, into out (14,)."""
    s = t / duration
    for axis in range(4):
        c = coefficients[axis]
        p = v = a = j = 0.0
        for n in range(7, -1, -1):  # Horner's scheme of the polynomial and of its Taylor coefficients at s
            j = j * s + a
            a = a * s + v
            v = v * s + p
            p = p * s + c[n]
        v, a, j = v / duration, 2.0 * a / duration**2, 6.0 * j / duration**3
        if axis < 3:
            out[axis], out[3 + axis], out[6 + axis], out[9 + axis] = p, v, a, j
        else:
            out[12], out[13] = p, v


@kernel(matrix, real, memory)
def _peaks(coefficients: Mat, duration: float, out: Vec) -> None:
    """Largest speed, acceleration and yaw rate on the way, sampled at 33 instants, into out (3,)."""
    at = np.empty(14)
    out[:] = 0.0
    for k in range(33):
        _sample(coefficients, duration, duration * k / 32.0, at)
        out[0] = max(out[0], math.sqrt(at[3] ** 2 + at[4] ** 2 + at[5] ** 2))
        out[1] = max(out[1], math.sqrt(at[6] ** 2 + at[7] ** 2 + at[8] ** 2))
        out[2] = max(out[2], abs(at[13]))


class PointToPoint:
    """Polynomial of degree 7 from a state of the flat output to rest at a goal.

        p(t) = sum_n c_n (t / T)^n,  n = 0..7:  p, v, a, j are the start's at 0 and the goal's, at rest, at T

    start: any FullState, so a flight can be replanned under way without a jump down to the jerk's;  goal: (3,) m world;
    yaw: rad, reached the short way;  duration: T, s.  After T it holds the goal, before 0 the start's first instant.
    """

    def __init__(self, start: FullState, goal: Vec, yaw: float, duration: float) -> None:
        if np.shape(goal) != (3,) or not np.all(np.isfinite([*goal, yaw, *start.flat])):
            raise ConfigError("PointToPoint: goal", [*goal, yaw], "finite numbers; start too")
        if not (math.isfinite(duration) and duration > 0.0):
            raise ConfigError("PointToPoint: duration", duration, "a positive number of seconds")
        self.duration = float(duration)
        self._coefficients = np.empty((4, 8))
        _coefficients(start.flat, np.asarray(goal, dtype=float), float(yaw), self.duration, self._coefficients)
        self._end = np.zeros(14)
        self._end[0:3], self._end[12] = goal, start.flat[12] + wrap(yaw - start.flat[12])

    def sample(self, t: float) -> FullState:
        """The reference t seconds after the start."""
        if t >= self.duration:
            return FullState(self._end.copy())
        out = np.empty(14)
        _sample(self._coefficients, self.duration, max(t, 0.0), out)
        return FullState(out)

    def done(self, t: float) -> bool:
        """Is the goal reached at t?"""
        return t >= self.duration

    @property
    def goal(self) -> Vec:
        """(3,) m, where it ends."""
        return self._end[0:3]

    @property
    def peaks(self) -> tuple[float, float, float]:
        """Largest speed m/s, acceleration m/s2 and yaw rate rad/s on the way."""
        out = np.empty(3)
        _peaks(self._coefficients, self.duration, out)
        return float(out[0]), float(out[1]), float(out[2])


def duration_for(
    start: FullState, goal: Vec, yaw: float, v_max: float = 1.0, a_max: float = 2.0, yaw_rate_max: float = 2.0
) -> float:
    """Shortest flight time in s that keeps speed, acceleration and yaw rate within their limits, to 5 %.

    From rest to rest T = max(35/16 d / v_max, sqrt(84 sqrt(5) / 25 d / a_max)); under way the first T of a growing row
    whose flight fits, where a start that is itself too fast counts as its own limit.
    """
    d = float(np.linalg.norm(np.asarray(goal) - start.p))
    turn = abs(wrap(yaw - start.yaw))
    straight = max(PEAK_SPEED * d / v_max, math.sqrt(PEAK_ACCELERATION * d / a_max))
    at_rest = max(straight, PEAK_SPEED * turn / yaw_rate_max, SHORTEST)
    speed, acceleration = float(np.linalg.norm(start.v)), float(np.linalg.norm(start.a))
    if speed + acceleration + abs(start.flat[13]) < 1e-9:
        return at_rest
    limits = np.array([max(v_max, speed), max(a_max, acceleration), max(yaw_rate_max, abs(start.flat[13]))])
    return _shortest(lambda t: PointToPoint(start, goal, yaw, t), limits).duration


def stopping(start: FullState, a_max: float = 2.0) -> PointToPoint:
    """The shortest flight to rest that keeps the acceleration within a_max m/s2, to 5 %, wherever it ends.

        p(T) = p + v T / 2 + a T^2 / 10 + j T^3 / 120

    the end for which c7 = 0: without a and j at the start it slows down and never turns back, T = 15/8 |v| / a_max,
    in a distance of STOP |v|^2 / a_max. A start that is itself too hard counts as its own limit; the heading stays.
    """
    p, v, a, j = start.flat[0:3], start.flat[3:6], start.flat[6:9], start.flat[9:12]

    def stop(t: float) -> PointToPoint:
        return PointToPoint(start, p + v * t / 2.0 + a * t**2 / 10.0 + j * t**3 / 120.0, start.yaw, t)

    acceleration = float(np.linalg.norm(a))
    if acceleration + float(np.linalg.norm(j)) < 1e-9:
        return stop(max(PEAK_DECELERATION * float(np.linalg.norm(v)) / a_max, SHORTEST))
    return _shortest(stop, np.array([math.inf, max(a_max, acceleration), math.inf]))


def _shortest(flight: Callable[[float], PointToPoint], limits: Vec) -> PointToPoint:
    """The first of flights that grow by 5 % each whose peaks (3,) keep the limits (3,), or which misses them least."""
    best, least = flight(SHORTEST), math.inf
    for n in range(120):
        plan = flight(SHORTEST * 1.05**n)
        excess = float(np.max(plan.peaks / (1.001 * limits)))
        if excess <= 1.0:
            return plan
        if excess < least:
            best, least = plan, excess
    return best
