"""Clamped splines through places at given times."""

import numpy as np
import numpy.typing as npt
from scipy.interpolate import BSpline, make_interp_spline

from crazychoir.errors import ConfigError
from crazychoir.numerics.math3d import wrap_angle
from crazychoir.planning.piecewise import FACTORIAL_TABLE, POLYNOMIAL_DEGREE, Piecewise
from crazychoir.types import FullState, Mat, Vec

END_DERIVATIVES = {
    3: 1,
    5: 2,
    7: 3,
}
"""For each degree, how many of v, a, j can be given at an end."""
DERIVATIVE_NAMES = ("velocity", "acceleration", "jerk")
"""Names of these derivatives."""


def fit_spline(
    times: npt.ArrayLike,
    places: npt.ArrayLike,
    yaws: npt.ArrayLike | None = None,
    start: FullState | None = None,
    goal: FullState | None = None,
    degree: int = 5,
) -> Piecewise:
    """Return the spline through the places, with the derivatives of `start` and `goal` at its ends.

        p(t_i) = p_i
        degree 3: C2, v at the ends
        degree 5: C4, v and a
        degree 7: C6, v, a and j

    times: (k,) s, increasing; the first becomes t = 0
    places: (k, 3) m world
    yaws: (k,) rad, 0 without. Each is turned to the short way from the one before, along a cubic
        spline that ends at the yaw rates of start and goal.
    start: only derivatives count; at rest without
    goal: only derivatives count; at rest without
    degree: 3, 5 or 7
    Raises ConfigError for another degree, wrong shapes or times, or derivatives without room.
    Source: Biagiotti & Melchiorri 2008, Trajectory Planning for Automatic Machines and Robots,
        chapter 4.
    """
    if degree not in END_DERIVATIVES:
        raise ConfigError("spline: degree", degree, "3, 5 or 7")
    t, p = _check_points(times, places)
    psi = unwrap_yaws(np.zeros(len(t)) if yaws is None else yaws, len(t))
    ends = [FullState(np.zeros(14)) if end is None else end for end in (start, goal)]
    rates = [end.flat[13] for end in ends]
    flat = make_interp_spline(
        t,
        p,
        degree,
        bc_type=(
            _select_derivatives(ends[0], degree),
            _select_derivatives(ends[1], degree),
        ),
    )
    heading = make_interp_spline(t, psi, 3, bc_type=([(1, rates[0])], [(1, rates[1])]))
    coefficients = np.zeros((len(t) - 1, 4, POLYNOMIAL_DEGREE + 1))
    coefficients[:, 0:3] = _compute_taylor(flat, t).transpose(0, 2, 1)
    coefficients[:, 3] = _compute_taylor(heading, t)
    return Piecewise(coefficients, np.diff(t))


def _check_points(times: npt.ArrayLike, places: npt.ArrayLike) -> tuple[Vec, Mat]:
    """Return times from 0 on and places; raise ConfigError for wrong ones."""
    p = check_waypoints(places, "spline: places")
    t = np.asarray(times, dtype=float)
    if t.shape != (len(p),) or not np.isfinite(t).all():
        raise ConfigError(
            "spline: times", t.tolist(), f"{len(p)} finite numbers, one a place"
        )
    if not np.all(np.diff(t) > 0.0):
        k = int(np.argmin(np.diff(t) > 0.0))
        raise ConfigError(
            f"spline: times[{k + 1}]",
            float(t[k + 1]),
            f"more than times[{k}] = {t[k]:g}",
        )
    return t - t[0], p


def check_waypoints(places: npt.ArrayLike, where: str) -> Mat:
    """Return the places as (k, 3) m.

    Raises ConfigError for fewer than two places, or a place that is not three finite numbers.
    """
    p = np.asarray(places, dtype=float)
    if p.ndim != 2 or p.shape[1] != 3 or len(p) < 2:
        raise ConfigError(
            where,
            f"shape {p.shape}",
            "(k, 3), k at least 2",
            "One place alone is a goal: PointToPoint.",
        )
    if not np.isfinite(p).all():
        k = int(np.argmin(np.isfinite(p).all(axis=1)))
        raise ConfigError(f"{where}[{k}]", p[k].tolist(), "three finite numbers, m")
    return p


def unwrap_yaws(yaws: npt.ArrayLike, k: int) -> Vec:
    """Return the yaws (k,) rad, each turned to the short way from the one before."""
    psi = np.asarray(yaws, dtype=float)
    if psi.shape != (k,) or not np.isfinite(psi).all():
        raise ConfigError("yaws", psi.tolist(), f"{k} finite numbers, rad, one a place")
    turns = [wrap_angle(turn) for turn in np.diff(psi).tolist()]
    return np.cumsum([psi[0], *turns])


def _select_derivatives(end: FullState, degree: int) -> list[tuple[int, Vec]]:
    """Return the derivatives (order, value (3,)) of an end that the degree has room for.

    Raises ConfigError if a further derivative is not 0.
    """
    given = [end.flat[3 * n : 3 * n + 3] for n in (1, 2, 3)]
    room = END_DERIVATIVES[degree]
    for name, value in zip(DERIVATIVE_NAMES[room:], given[room:], strict=True):
        if np.any(value != 0.0):
            raise ConfigError(
                f"spline: {name} at an end",
                value.tolist(),
                f"0 at degree {degree}",
                "Take degree 7.",
            )
    if not np.isfinite(end.flat).all():
        raise ConfigError(
            "spline: state at an end", end.flat.tolist(), "finite numbers"
        )
    return [(n + 1, given[n]) for n in range(room)]


def _compute_taylor(curve: BSpline, t: Vec) -> npt.NDArray[np.float64]:
    """Return the coefficients (k - 1, 8, ...) at each knot but the last, per s^n."""
    orders = range(curve.k + 1)
    values = np.array([curve(t[:-1], nu=n) / FACTORIAL_TABLE[n] for n in orders])
    padding = [(0, POLYNOMIAL_DEGREE - curve.k)] + [(0, 0)] * (values.ndim - 1)
    return np.asarray(np.moveaxis(np.pad(values, padding), 0, 1))


def compute_chord_times(places: Mat) -> Vec:
    """Return times (k,) s of places (k, 3) at 1 m/s on straight lines.

    Raises ConfigError for two equal places in a row.
    """
    lengths = np.linalg.norm(np.diff(places, axis=0), axis=1)
    if lengths.min() < 1e-6:
        k = int(np.argmin(lengths))
        raise ConfigError(
            f"places[{k + 1}]",
            places[k + 1].tolist(),
            "another place than the one before",
            "Leave it out, or give times, to wait there.",
        )
    return np.cumsum([0.0, *lengths])
