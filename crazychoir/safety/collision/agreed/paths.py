"""Paths that a planner on board flies, piece by piece: each is a polynomial of degree 7 of go_to.

A path is a (k, 25) table. Each row is a piece: its duration in s, then the coefficients of x, y and
z in t, ascending, 8 each. A path ends at rest, and there the drone stays.
A motion is (12,): p m, v m/s, a m/s2, j m/s3, each (3,), world.
"""

import math
from typing import NamedTuple

import numpy as np

from crazychoir.numerics.kernels import kernel, matrix, memory, real, vector
from crazychoir.numerics.math3d import Triple
from crazychoir.planning.point_to_point import (
    PEAK_ACCELERATION,
    PEAK_DECELERATION,
    PEAK_SPEED,
    SHORTEST_FLIGHT,
)
from crazychoir.types import Mat, Vec

PIECE_SIZE = 25
"""Numbers of a piece."""


class PathSearch(NamedTuple):
    """How the shortest duration of a piece within the limits is searched for."""

    duration_growth: float = 1.06
    """Ratio of successive durations that are tried."""
    longest_duration: float = 2.0
    """Longest duration that is tried, as a multiple of the duration from rest."""
    samples: int = 16
    """Number of samples of a piece in the search for its peaks."""
    speed_excess: float = 1.05
    """Allowed sampled peak speed, as a share of the limit."""
    acceleration_excess: float = 1.1
    """Allowed sampled peak acceleration, as a share of the limit."""
    steep_start: float = 1.25
    """Share of a_max from which an acceleration is no peak of such a path."""
    steep_start_limit: float = 2.0
    """Least limit, as a multiple of a_max, for a path that begins with a larger acceleration.

    With a gentler limit the drone would become far too fast before it turned round.
    """


PATH_SEARCH = PathSearch()


BOX_CHECK_STEP = 0.1
"""Seconds between two checks of the place on a path."""
BOX_TOLERANCE = 1e-3
"""Distance in m by which the drone may be elsewhere between two checks: 1 m/s2 makes 1.3 mm."""


@kernel()
def _find_piece(way: Mat, t: float) -> tuple[int, float]:
    """Return the piece that is flown t s after the beginning of the path, and s since it began."""
    last = way.shape[0] - 1
    for k in range(last):
        if t < way[k, 0]:
            return k, max(t, 0.0)
        t -= way[k, 0]
    return last, min(max(t, 0.0), way[last, 0])


@kernel()
def compute_place(way: Mat, t: float) -> Triple:
    """Return the place, (3,) m, t s after the beginning."""
    k, s = _find_piece(way, t)
    x = way[k, 8]
    y = way[k, 16]
    z = way[k, 24]
    for n in range(6, -1, -1):
        x = x * s + way[k, 1 + n]
        y = y * s + way[k, 9 + n]
        z = z * s + way[k, 17 + n]
    return x, y, z


@kernel(matrix, real, memory)
def fill_motion(way: Mat, t: float, out: Vec) -> None:
    """Compute the motion t s after the beginning; at rest after the end.

    way: (k, 25)
    t: s
    out: (12,): the result
    """
    k, s = _find_piece(way, t)
    for c in range(3):
        p = 0.0
        v = 0.0
        a = 0.0
        j = 0.0
        # Horner's scheme: j, a and v hold a sixth, half and the whole of a derivative.
        for n in range(7, -1, -1):
            j = j * s + a
            a = a * s + v
            v = v * s + p
            p = p * s + way[k, 1 + 8 * c + n]
        out[c] = p
        out[3 + c] = v
        out[6 + c] = 2.0 * a
        out[9 + c] = 6.0 * j
    if t >= np.sum(way[:, 0]):
        out[3:12] = 0.0


@kernel(vector, vector, real, memory)
def fill_connection(start: Vec, end: Vec, duration: float, piece: Vec) -> None:
    """Compute the polynomial from one motion to another.

        p(t) = sum_n c_n t^n:  p, v, a, j are the start's at 0 and the end's at T

    start: (12,)
    end: (12,)
    duration: s, T
    piece: (25,): the result
    """
    t = piece[0] = duration
    for c in range(3):
        v = start[3 + c] * t
        a = start[6 + c] * t * t
        j = start[9 + c] * t * t * t
        g0 = end[c] - start[c] - v - a / 2.0 - j / 6.0
        g1 = end[3 + c] * t - v - a - j / 2.0
        g2 = end[6 + c] * t * t - a - j
        g3 = end[9 + c] * t * t * t - j
        row = 1 + 8 * c
        piece[row] = start[c]
        piece[row + 1] = v
        piece[row + 2] = a / 2.0
        piece[row + 3] = j / 6.0
        piece[row + 4] = 35.0 * g0 - 15.0 * g1 + 2.5 * g2 - g3 / 6.0
        piece[row + 5] = -84.0 * g0 + 39.0 * g1 - 7.0 * g2 + 0.5 * g3
        piece[row + 6] = 70.0 * g0 - 34.0 * g1 + 6.5 * g2 - 0.5 * g3
        piece[row + 7] = -20.0 * g0 + 10.0 * g1 - 2.0 * g2 + g3 / 6.0
        power = 1.0
        for n in range(8):
            piece[row + n] /= power
            power *= t


@kernel()
def _compute_length(x: Vec, first: int) -> float:
    """Return the length of the three numbers of x from index `first` on."""
    return math.sqrt(x[first] ** 2 + x[first + 1] ** 2 + x[first + 2] ** 2)


@kernel()
def _compute_excess(piece: Vec, v_max: float, a_max: float, at: Vec) -> float:
    """Return the larger of peak speed and peak acceleration of a piece, as shares of their limits.

    piece: (25,)
    v_max: m/s
    a_max: m/s2
    at: (12,): work space
    """
    worst = 0.0
    way = piece.reshape((1, PIECE_SIZE))
    for n in range(1, PATH_SEARCH.samples):
        fill_motion(way, piece[0] * n / PATH_SEARCH.samples, at)
        worst = max(
            worst,
            _compute_length(at, 3) / v_max,
            _compute_length(at, 6) / (PATH_SEARCH.acceleration_excess * a_max),
        )
    return worst


@kernel()
def _compute_acceleration_limit(acceleration: float, a_max: float) -> float:
    """Return the limit in m/s2 for a path that begins with an acceleration."""
    if acceleration <= PATH_SEARCH.steep_start * a_max:
        return max(a_max, acceleration / PATH_SEARCH.acceleration_excess)
    return max(acceleration, PATH_SEARCH.steep_start_limit * a_max)


@kernel(matrix)
def find_peak_sideways_acceleration(way: Mat) -> float:
    """Return the largest sampled sideways acceleration on a path, m/s2."""
    at = np.zeros(12)
    worst = 0.0
    began = 0.0
    for k in range(way.shape[0]):
        for n in range(PATH_SEARCH.samples):
            fill_motion(way, began + way[k, 0] * n / PATH_SEARCH.samples, at)
            worst = max(worst, math.sqrt(at[6] ** 2 + at[7] ** 2))
        began += way[k, 0]
    return worst


@kernel(matrix)
def find_peak_speed(way: Mat) -> float:
    """Return the largest sampled speed on a path, m/s."""
    at = np.zeros(12)
    worst = 0.0
    began = 0.0
    for k in range(way.shape[0]):
        for n in range(PATH_SEARCH.samples):
            fill_motion(way, began + way[k, 0] * n / PATH_SEARCH.samples, at)
            worst = max(worst, _compute_length(at, 3))
        began += way[k, 0]
    return worst


@kernel(matrix, real, vector, vector)
def is_outside_box(way: Mat, begins: float, low: Vec, high: Vec) -> bool:
    """Return whether a path leaves a box from a time on, checked every BOX_CHECK_STEP s.

    way: (k, 25)
    begins: s, since the beginning of the path
    low: (3,) m: lower corner
    high: (3,) m: upper corner
    """
    lasts = np.sum(way[:, 0])
    t = begins
    while t < lasts + BOX_CHECK_STEP:
        p = compute_place(way, t)
        for c in range(3):
            if p[c] < low[c] - BOX_TOLERANCE or p[c] > high[c] + BOX_TOLERANCE:
                return True
        t += BOX_CHECK_STEP
    return False


@kernel(vector, vector, real, real, memory)
def fill_flight(start: Vec, goal: Vec, v_max: float, a_max: float, piece: Vec) -> None:
    """Compute the piece from a motion to a goal at rest.

    The piece is as short as the limits allow. It goes on with the jerk of the motion: if each new
    piece of a drone that accelerates began without jerk, the drone would get faster and faster.
    From rest T = max(35/16 d / v_max, sqrt(84 sqrt(5) / 25 d / a_max)). Otherwise it is the
    first of a growing series of durations with samples within the limits, or with the least excess.
    A start that is itself too fast counts as its own limit. So does a start with too much
    acceleration, or PATH_SEARCH.steep_start_limit a_max from PATH_SEARCH.steep_start a_max on.

    start: (12,)
    goal: (3,) m
    v_max: m/s
    a_max: m/s2
    piece: (25,): the result
    """
    end = np.zeros(12)
    at = np.zeros(12)
    end[0:3] = goal
    d = _compute_length(end[0:3] - start[0:3], 0)
    t = max(
        PEAK_SPEED * d / v_max,
        math.sqrt(PEAK_ACCELERATION * d / a_max),
        SHORTEST_FLIGHT,
    )
    speed = _compute_length(start, 3)
    acceleration = _compute_length(start, 6)
    if speed + acceleration < 1e-6:
        fill_connection(start, end, t, piece)
        return
    longest = PATH_SEARCH.longest_duration * t + PEAK_DECELERATION * speed / a_max
    t = max(SHORTEST_FLIGHT, 0.5 * t)
    v = max(PATH_SEARCH.speed_excess * v_max, speed)
    a = _compute_acceleration_limit(acceleration, a_max)
    best = t
    least = math.inf
    while t < longest and least > 1.0:
        fill_connection(start, end, t, piece)
        excess = _compute_excess(piece, v, a, at)
        if excess < least:
            best = t
            least = excess
        t *= PATH_SEARCH.duration_growth
    fill_connection(start, end, best, piece)


@kernel(vector, real, memory)
def fill_stop(start: Vec, a_max: float, piece: Vec) -> None:
    """Compute the shortest piece from a motion to rest, wherever that is.

        p(T) = p + v T / 2 + a T^2 / 10,   T = 15/8 |v| / a_max without acceleration

    start: (12,)
    a_max: m/s2
    piece: (25,): the result
    """
    begin = start.copy()
    end = np.zeros(12)
    at = np.zeros(12)
    begin[9:12] = 0.0
    t = max(PEAK_DECELERATION * _compute_length(start, 3) / a_max, SHORTEST_FLIGHT)
    a = _compute_acceleration_limit(_compute_length(start, 6), a_max)
    longest = PATH_SEARCH.longest_duration * t + PATH_SEARCH.longest_duration
    while True:
        for c in range(3):
            end[c] = start[c] + start[3 + c] * t / 2.0 + start[6 + c] * t * t / 10.0
        fill_connection(begin, end, t, piece)
        if t > longest or _compute_excess(piece, math.inf, a, at) <= 1.0:
            return
        t *= PATH_SEARCH.duration_growth


def plan_hold(p: Vec, seconds: float) -> Mat:
    """Return the path that stays at p, (3,) m."""
    way = np.zeros((1, PIECE_SIZE))
    way[0, 0] = seconds
    way[0, [1, 9, 17]] = p
    return way


def plan_flight(start: Vec, goal: Vec, v_max: float, a_max: float) -> Mat:
    """Return the path of one go_to."""
    way = np.empty((1, PIECE_SIZE))
    fill_flight(start, goal, v_max, a_max, way[0])
    return way


def plan_braking(start: Vec, a_max: float) -> Mat:
    """Return the path to rest."""
    way = np.empty((1, PIECE_SIZE))
    fill_stop(start, a_max, way[0])
    return way


def plan_catching_up(start: Vec, then: Vec, seconds: float, a_max: float) -> Mat:
    """Return the path to a motion that will be wanted `compute_path_duration` later, and to rest from there.

    start: (12,)
    then: (12,)
    seconds: s
    a_max: m/s2
    """
    way = np.empty((2, PIECE_SIZE))
    fill_connection(start, then, seconds, way[0])
    fill_stop(then, a_max, way[1])
    return way


def compute_motion(way: Mat, t: float) -> Vec:
    """Return the motion, (12,), t s after the beginning."""
    out = np.empty(12)
    fill_motion(way, t, out)
    return out


def compute_path_duration(way: Mat) -> float:
    """Return the duration of all pieces in s."""
    return float(way[:, 0].sum())


def compute_end_place(way: Mat) -> Vec:
    """Return the place, (3,) m, where a path ends."""
    return compute_motion(way, compute_path_duration(way))[0:3]
