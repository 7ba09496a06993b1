"""Flights of minimum snap through waypoints."""

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.optimize import minimize

from crazychoir.errors import ConfigError
from crazychoir.planning.feasibility import (
    Limits,
    check_limits,
    check_references,
    is_within_limits,
)
from crazychoir.planning.piecewise import Piecewise
from crazychoir.planning.scaling import compute_slowdown
from crazychoir.planning.spline import check_waypoints, compute_chord_times, fit_spline
from crazychoir.types import FullState, Mat, Vec

GAUSS_NODES, GAUSS_WEIGHTS = np.polynomial.legendre.leggauss(
    4
)  # exact for snap^2, of degree 6


@dataclass(frozen=True, slots=True)
class DurationSearch:
    """The durations that are tried for a flight with a moving end."""

    first_factor: float = 0.5
    """First factor of the time from rest to rest that is tried if an end moves."""
    growth: float = 1.03
    """Ratio of successive factors."""
    trials: int = 70
    """Number of factors that are tried; the last one is 3.8."""


DURATION_SEARCH = DurationSearch()


NO_LIMITS = Limits()
UNTIMED_LIMITS = Limits(v_max=1.0, a_max=2.0, yaw_rate_max=2.0)
"""Limits of a flight without times."""


def minimum_snap(
    waypoints: npt.ArrayLike,
    times: npt.ArrayLike | None = None,
    yaws: npt.ArrayLike | None = None,
    start: FullState | None = None,
    goal: FullState | None = None,
    limits: Limits | None = None,
) -> Piecewise:
    """Return the flight of least snap through the waypoints.

        min integral |p''''|^2 dt   subject to   p(t_i) = w_i
        p', p'', p''' at both ends equal to those of start and goal

    The minimum is the spline of degree 7 with continuous derivatives up to the 6th (Schoenberg &
    Reinsch: p^(8) = 0 between the knots, and p'''' to p^(6) have no jump at a knot). It is found by
        a banded linear system.

    waypoints: w (k, 3) m world
    times: t_i (k,) s, increasing. Without them, `allocate_times` shares out the time, and the limits
        give the duration.
    yaws: (k,) rad, each the short way from the one before; 0 without
    start: state at the beginning; only derivatives count; at rest without
    goal: state at the end; only derivatives count; at rest without
    limits: by default unlimited with times; v 1 m/s, a 2 m/s2 and 2 rad/s without
    Raises ConfigError if a waypoint is outside of the fence, or if given times break the limits.
    Source: Mellinger & Kumar 2011, ICRA, section IV.
    """
    w = check_waypoints(waypoints, "waypoints")
    limits = limits or (UNTIMED_LIMITS if times is None else NO_LIMITS)
    limits.check_places(w, "waypoints")
    if times is not None:
        flight = fit_spline(times, w, yaws, start, goal, degree=7)
        check_limits(flight, limits)
        return flight
    limits.check_timed("minimum_snap")
    return _plan_within_limits(allocate_times(w), w, yaws, start, goal, limits)


def _plan_within_limits(
    t: Vec,
    w: Mat,
    yaws: npt.ArrayLike | None,
    start: FullState | None,
    goal: FullState | None,
    limits: Limits,
) -> Piecewise:
    """Return the flight in the proportions of the times t, as fast as the limits allow.

    If an end moves, the duration is at most 3 % too long.

    t: (k,) s
    w: (k, 3) m
    """
    from_rest = fit_spline(t, w, yaws, degree=7)
    k = compute_slowdown(from_rest, limits)
    if start is None and goal is None:
        return from_rest.slowed(k)
    ends = np.array(
        [np.zeros(14) if end is None else end.flat for end in (start, goal)]
    )
    ends[:, 0:3] = w[[0, -1]]
    check_references(t[[0, -1]], ends, limits)
    for share in DURATION_SEARCH.first_factor * DURATION_SEARCH.growth ** np.arange(
        DURATION_SEARCH.trials
    ):
        flight = fit_spline(share * k * t, w, yaws, start, goal, degree=7)
        if is_within_limits(flight, limits):
            return flight
    tried = (
        f"{DURATION_SEARCH.first_factor * k * t[-1]:.1f} to {share * k * t[-1]:.1f} s"
    )
    raise ConfigError(
        "minimum_snap: time for all waypoints",
        tried,
        "a time that keeps the limits from its moving ends",
        "Give times, wider limits, or ends at rest.",
    )


def allocate_times(waypoints: npt.ArrayLike) -> Vec:
    """Return times (k,) s that share out one flight among its waypoints for the least snap.

        min over T_i > 0 of  integral |p''''|^2 dt   subject to   sum T_i = T

    The search starts with T_i in proportion to the distances and takes quasi-Newton steps in log
    T_i. T is 1 s a metre, and scaled later.
    Source: Mellinger & Kumar 2011, ICRA, section IV-C.
    """
    w = check_waypoints(waypoints, "waypoints")
    first = np.diff(compute_chord_times(w))
    total = float(first.sum())

    def times(logs: Vec) -> Vec:
        shares = np.exp(logs - logs.max())
        return np.asarray(np.cumsum([0.0, *shares]) * (total / shares.sum()))

    if len(first) == 1:
        return times(np.log(first))
    least = compute_snap(fit_spline(times(np.log(first)), w, degree=7))
    found = minimize(
        lambda logs: math.log(
            compute_snap(fit_spline(times(logs), w, degree=7)) / least
        ),
        np.log(first),
        method="L-BFGS-B",
        bounds=[(x - 3.0, x + 3.0) for x in np.log(first)],
        options={"maxiter": 50, "ftol": 1e-4},
    )
    return times(np.asarray(found.x))


def compute_snap(flight: Piecewise) -> float:
    """Return the integral of |p''''|^2 dt, m^2/s^7, by Gauss's rule, which is exact here."""
    c = flight.coefficients[:, 0:3, 4:]
    durations = flight.durations
    s = 0.5 * durations[:, None] * (GAUSS_NODES + 1.0)
    n = np.arange(4, 8)
    factors = n * (n - 1) * (n - 2) * (n - 3)
    values = np.einsum("kan,kgn->kag", c * factors, s[:, :, None] ** np.arange(4))
    return float(np.sum(0.5 * durations[:, None, None] * GAUSS_WEIGHTS * values**2))
