"""Minimum snap through waypoints."""

import math

import numpy as np
import numpy.typing as npt
from scipy.optimize import minimize

from crazychoir.errors import ConfigError
from crazychoir.planning.feasibility import Limits, check, check_references, keeps
from crazychoir.planning.piecewise import Piecewise
from crazychoir.planning.scaling import slowdown
from crazychoir.planning.spline import checked_places, chord_times, spline
from crazychoir.types import FullState, Mat, Vec

NODES, WEIGHTS = np.polynomial.legendre.leggauss(4)  # exact for snap^2, of degree 6
FASTEST, GROWTH, TRIES = (
    0.5,
    1.03,
    70,
)  # times the time from rest to rest, where an end moves: up to 3.8
UNLIMITED = Limits()
STANDARD = Limits(v_max=1.0, a_max=2.0, yaw_rate_max=2.0)


def minimum_snap(
    waypoints: npt.ArrayLike,
    times: npt.ArrayLike | None = None,
    yaws: npt.ArrayLike | None = None,
    start: FullState | None = None,
    goal: FullState | None = None,
    limits: Limits | None = None,
) -> Piecewise:
    """The flight through the waypoints whose snap is least.

        min integral |p''''|^2 dt   subject to   p(t_i) = w_i;  p', p'', p''' at both ends those of start and goal

    Its minimum is the spline of degree 7 with continuous derivatives up to the 6th (Schoenberg & Reinsch: p^(8) = 0
    between the knots, and what is free at a knot has no jump in p'''' to p^(6)), found by a banded linear system.
    waypoints: w (k, 3) m world;  times: t_i (k,) s, increasing; without: shared out by `allocated`, then as long as the
    limits need;  yaws: (k,) rad, the short way from each to the next, 0 without;  start, goal: at rest without; of them
    only derivatives are taken;  limits: unlimited with times, v 1 m/s, a 2 m/s2 and 2 rad/s without.
    Errors: ConfigError where a waypoint is outside of the fence, or where given times break the limits.
    Source: Mellinger & Kumar 2011, ICRA, section IV.
    """
    w = checked_places(waypoints, "waypoints")
    limits = limits or (STANDARD if times is None else UNLIMITED)
    limits.check_places(w, "waypoints")
    if times is not None:
        flight = spline(times, w, yaws, start, goal, degree=7)
        check(flight, limits)
        return flight
    limits.check_timed("minimum_snap")
    return _within_limits(allocated(w), w, yaws, start, goal, limits)


def _within_limits(
    t: Vec,
    w: Mat,
    yaws: npt.ArrayLike | None,
    start: FullState | None,
    goal: FullState | None,
    limits: Limits,
) -> Piecewise:
    """The flight in the proportions of the times t (k,), as fast as the limits allow, to 3 % where an end moves."""
    from_rest = spline(t, w, yaws, degree=7)
    k = slowdown(from_rest, limits)
    if start is None and goal is None:
        return from_rest.slowed(k)
    ends = np.array(
        [np.zeros(14) if end is None else end.flat for end in (start, goal)]
    )
    ends[:, 0:3] = w[[0, -1]]
    check_references(t[[0, -1]], ends, limits)
    for share in FASTEST * GROWTH ** np.arange(TRIES):
        flight = spline(share * k * t, w, yaws, start, goal, degree=7)
        if keeps(flight, limits):
            return flight
    tried = f"{FASTEST * k * t[-1]:.1f} to {share * k * t[-1]:.1f} s"
    raise ConfigError(
        "minimum_snap: time for all waypoints",
        tried,
        "one that keeps the limits from its moving ends",
        "Give times, wider limits, or ends at rest.",
    )


def allocated(waypoints: npt.ArrayLike) -> Vec:
    """Times (k,) s that share one flight out among its waypoints so that its snap is least.

        min over T_i > 0 of  integral |p''''|^2 dt   subject to   sum T_i = T

    from T_i as the distances, by quasi-Newton steps in log T_i; T: 1 s a metre, scaled later.
    Source: Mellinger & Kumar 2011, ICRA, section IV-C.
    """
    w = checked_places(waypoints, "waypoints")
    first = np.diff(chord_times(w))
    total = float(first.sum())

    def times(logs: Vec) -> Vec:
        shares = np.exp(logs - logs.max())
        return np.asarray(np.cumsum([0.0, *shares]) * (total / shares.sum()))

    if len(first) == 1:
        return times(np.log(first))
    least = snap(spline(times(np.log(first)), w, degree=7))
    found = minimize(
        lambda logs: math.log(snap(spline(times(logs), w, degree=7)) / least),
        np.log(first),
        method="L-BFGS-B",
        bounds=[(x - 3.0, x + 3.0) for x in np.log(first)],
        options={"maxiter": 50, "ftol": 1e-4},
    )
    return times(np.asarray(found.x))


def snap(flight: Piecewise) -> float:
    """Integral of |p''''|^2 dt, m^2/s^7, by Gauss's rule, which is exact here."""
    c = flight.coefficients[:, 0:3, 4:]
    durations = flight.durations
    s = 0.5 * durations[:, None] * (NODES + 1.0)
    n = np.arange(4, 8)
    factors = n * (n - 1) * (n - 2) * (n - 3)
    values = np.einsum("kan,kgn->kag", c * factors, s[:, :, None] ** np.arange(4))
    return float(np.sum(0.5 * durations[:, None, None] * WEIGHTS * values**2))
