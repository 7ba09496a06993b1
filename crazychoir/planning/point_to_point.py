"""Point-to-point flight by a polynomial of degree 7."""

import math
from collections.abc import Callable

import numpy as np

from crazychoir.errors import ConfigError
from crazychoir.numerics.math3d import wrap_angle
from crazychoir.planning.polynomial import Polynomial7th
from crazychoir.types import FullState, Vec

PEAK_SPEED = 35.0 / 16.0  # m/s, of a rest-to-rest flight of 1 m in 1 s
PEAK_ACCELERATION = (
    84.0 * math.sqrt(5.0) / 25.0
)  # m/s2, of a rest-to-rest flight of 1 m in 1 s
PEAK_DECELERATION = 15.0 / 8.0  # m/s2, of a stop from 1 m/s in 1 s
STOP_DISTANCE = PEAK_DECELERATION / 2.0  # m, of a stop from 1 m/s with 1 m/s2
SHORTEST_FLIGHT = 0.1  # s, of a flight to the present place


class PointToPoint(Polynomial7th):
    """Polynomial of degree 7 from a state of the flat output to rest at a goal.

        p(t) = sum_n c_n t^n,  n = 0..7
        p, v, a, j are the start's at 0 and the goal's, at rest, at T

    After T it holds the goal, before 0 the first state.

    start: any FullState. So a flight can be replanned while flying, without a jump up to the jerk.
    goal: (3,) m world
    yaw: rad, reached the short way
    duration: T, s
    Raises ConfigError for a goal that is not three numbers.
    """

    def __init__(
        self, start: FullState, goal: Vec, yaw: float, duration: float
    ) -> None:
        if np.shape(goal) != (3,):
            raise ConfigError(
                "PointToPoint: goal", np.asarray(goal).tolist(), "three numbers, m"
            )
        rest = np.zeros(14)
        rest[0:3] = goal
        rest[12] = yaw
        super().__init__(start, FullState(rest), duration)


def compute_rest_to_rest_time(distance: float, v_max: float, a_max: float) -> float:
    """Return the shortest flight time in s from rest to rest within the limits, without a turn.

    It is max(35/16 d / v_max, sqrt(84 sqrt(5) / 25 d / a_max)) for the distance d.

    distance: m
    v_max: m/s
    a_max: m/s2
    """
    straight = max(
        PEAK_SPEED * distance / v_max,
        math.sqrt(PEAK_ACCELERATION * distance / a_max),
    )
    return max(straight, SHORTEST_FLIGHT)


def compute_flight_time(
    start: FullState,
    goal: Vec,
    yaw: float,
    v_max: float = 1.0,
    a_max: float = 2.0,
    yaw_rate_max: float = 2.0,
) -> float:
    """Return the shortest flight time in s within the limits, to 5 %.

    From rest to rest `compute_rest_to_rest_time` gives it, or the time of the turn if this is
    longer. While flying, it is the first T of a growing series with a flight within the limits; a
    start that is itself too fast counts as its own limit.

    start: the state at the beginning
    goal: (3,) m world
    yaw: rad, at the goal
    v_max: m/s
    a_max: m/s2
    yaw_rate_max: rad/s
    """
    d = math.dist(goal, start.p)
    turn = abs(wrap_angle(yaw - start.yaw))
    straight = compute_rest_to_rest_time(d, v_max, a_max)
    at_rest = max(straight, PEAK_SPEED * turn / yaw_rate_max)
    speed = math.hypot(*start.v)
    acceleration = math.hypot(*start.a)
    if speed + acceleration + abs(start.flat[13]) < 1e-9:
        return at_rest
    limits = np.array(
        [
            max(v_max, speed),
            max(a_max, acceleration),
            max(yaw_rate_max, abs(start.flat[13])),
        ]
    )
    return _find_shortest(lambda t: PointToPoint(start, goal, yaw, t), limits).duration


def plan_stop(start: FullState, a_max: float = 2.0) -> PointToPoint:
    """Return the shortest flight to rest within a_max m/s2, to 5 %, wherever it ends.

        p(T) = p + v T / 2 + a T^2 / 10 + j T^3 / 120

    At this end c7 = 0. Without a and j at the start the drone slows down and never turns back. It
    then stops in a distance of STOP_DISTANCE |v|^2 / a_max:

        T = 15/8 |v| / a_max

    A start with too much acceleration counts as its own limit. The heading stays.
    """
    p = start.flat[0:3]
    v = start.flat[3:6]
    a = start.flat[6:9]
    j = start.flat[9:12]

    def stop(t: float) -> PointToPoint:
        return PointToPoint(
            start, p + v * t / 2.0 + a * t**2 / 10.0 + j * t**3 / 120.0, start.yaw, t
        )

    acceleration = math.hypot(*a)
    if acceleration + math.hypot(*j) < 1e-9:
        return stop(max(PEAK_DECELERATION * math.hypot(*v) / a_max, SHORTEST_FLIGHT))
    return _find_shortest(
        stop, np.array([math.inf, max(a_max, acceleration), math.inf])
    )


def _find_shortest(
    flight: Callable[[float], PointToPoint], limits: Vec
) -> PointToPoint:
    """Return the first of flights, each 5 % longer, with peaks (3,) within the limits (3,).

    Returns the flight with the least excess if none is.
    """
    best = flight(SHORTEST_FLIGHT)
    least = math.inf
    for n in range(120):
        plan = flight(SHORTEST_FLIGHT * 1.05**n)
        excess = float(np.max(plan.peaks / (1.001 * limits)))
        if excess <= 1.0:
            return plan
        if excess < least:
            best = plan
            least = excess
    return best
