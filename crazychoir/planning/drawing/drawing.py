"""Hand-drawn strokes, made smooth enough to fly."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import numpy.typing as npt
from scipy.interpolate import splev, splprep
from scipy.spatial import cKDTree

from crazychoir.errors import ConfigError
from crazychoir.planning.drawing.stroke import check_stroke, fill_line, split_stroke
from crazychoir.planning.feasibility import (
    FEASIBILITY_CHECK,
    Limits,
    compute_peaks,
    sample_references,
)
from crazychoir.planning.piecewise import Piecewise, join_pieces
from crazychoir.planning.point_to_point import PointToPoint, compute_flight_time
from crazychoir.planning.scaling import compute_slowdown
from crazychoir.planning.spline import fit_spline
from crazychoir.planning.trajectory import MOST_SETPOINTS
from crazychoir.types import FullState, Mat, Vec

DRAWING_LIMITS = Limits(v_max=0.5, a_max=1.0, yaw_rate_max=2.0)
"""Default limits."""
DEVIATION_STEP = 0.002  # m, between the places by which the deviation is measured
BEND_ACCELERATION_SHARE = (
    0.5  # of a_max for the bends, and as much for the changes of speed
)


@dataclass(frozen=True, slots=True)
class LineSmoothing:
    """How a hand-drawn line is smoothed, and how far the smoothed line may be from it."""

    end_weight: float = 1e3
    """Weight of both ends, against 1 of each point in between."""
    largest_shift: float = 3.5
    """Largest distance by which a point is moved, as a multiple of the smoothing."""
    largest_bulge: float = 0.25
    """Largest distance of a bend from the lines between points, relative to the longest such line."""
    rounding: float = 1e-9
    """m."""
    trials: int = 6
    """Number of trials, each with half the smoothing of the one before; then points are not moved."""


LINE_SMOOTHING = LineSmoothing()


LEAST_LENGTH_SHARE = 0.5  # of the length of a stroke, at least: the rest may be tremor
SLOWEST_PACE = 3.0  # relative to the mean s/m: hesitation of a hand that is flown
FASTEST_PACE = 1.0 / 3.0  # relative to the mean s/m: haste of a hand that is flown


@dataclass(frozen=True, kw_only=True)
class Pen:
    """Settings for the flight of strokes.

    A drawing is refused if it would be flown more than `allowed_deviation` m away from its lines.
    """

    height: float = 1.0
    """m, world."""
    lift: float = 0.0
    """m above the drawing, in which the drone flies from one stroke to the next."""
    yaw: float | Literal["along"] = 0.0
    """rad, or "along" the path."""
    timing: Literal["even", "drawn"] = "even"
    """Speed along a stroke.

    "even": as fast as bends and limits allow. "drawn": slower where the hand was slower; needs
    strokes with times.
    """
    spacing: float = 0.05
    """m, between knots of the spline."""
    smoothing: float = 0.004
    """m, standard deviation of the tremor of the hand, which is smoothed out."""

    def __post_init__(self) -> None:
        if self.timing not in ("even", "drawn"):
            raise ConfigError("Pen: timing", self.timing, '"even" or "drawn"')
        if self.yaw != "along" and not math.isfinite(self.yaw):
            raise ConfigError("Pen: yaw", self.yaw, 'a finite angle, rad, or "along"')
        for name, low in (
            ("height", -math.inf),
            ("lift", 0.0),
            ("spacing", 1e-3),
            ("smoothing", 0.0),
        ):
            value = getattr(self, name)
            if not (math.isfinite(value) and value >= low):
                raise ConfigError(
                    f"Pen: {name}", value, f"a finite number of metres, {low:g} or more"
                )

    @property
    def allowed_deviation(self) -> float:
        """Return the largest distance between the flown and the drawn lines, m.

            spacing / 2 + LINE_SMOOTHING.largest_shift smoothing

        Corners between two knots are rounded, and the tremor is smoothed out.
        """
        return 0.5 * self.spacing + LINE_SMOOTHING.largest_shift * self.smoothing


@dataclass(frozen=True)
class Drawing:
    """A drawing as it will be flown."""

    path: Piecewise
    """The flight, from rest to rest."""
    deviation: float
    """m, the largest distance between the flown and the drawn lines."""
    speed: float
    """m/s, the largest of the flight."""
    acceleration: float
    """m/s2, the largest of the flight."""


def plan_drawing(
    strokes: Sequence[npt.ArrayLike],
    pen: Pen = Pen(),
    limits: Limits = DRAWING_LIMITS,
    longest: float = math.inf,
) -> Drawing:
    """Return the smooth flight along drawn strokes, from rest to rest.

    Each stroke is thinned, and split into parts at sharp turns, where the drone stops. For each part:
    1. Add points on long straight lines, because a spline would swing out between distant points.
    2. Smooth out the tremor of the hand, and divide the line into equal lengths.
    3. Choose the times, interpolate with a spline of degree 7, and slow it down to keep the limits.
    Straight flights join the strokes, lifted by pen.lift. The drone stops at a stroke of one point.

    strokes: (k, 2) rows x, y m, or (k, 3) rows t s, x, y m; world
    pen: how strokes are flown
    limits: of the flight; v_max and a_max are finite
    longest: s; a longer flight is refused before it is computed in full
    Raises ConfigError for strokes or limits that do not fit, a flight that is too long, or a stroke
    that would be flown more than pen.allowed_deviation m away from its lines.
    """
    limits.check_timed("drawing")
    drawn = [
        check_stroke(stroke, f"drawing: strokes[{n}]")
        for n, stroke in enumerate(strokes)
    ]
    if pen.timing == "drawn" and any(np.shape(stroke)[1] == 2 for stroke in strokes):
        raise ConfigError(
            "drawing: strokes", "rows of x, y", 'rows of t, x, y for the timing "drawn"'
        )
    longest = min(longest, MOST_SETPOINTS / FEASIBILITY_CHECK.rate)
    parts: list[Piecewise] = []
    deviations: list[float] = []
    has_line = False
    here: FullState | None = None
    spent = 0.0
    for number, (t, xy) in enumerate(drawn):
        flown: list[Mat] = []
        for n, (clock, places) in enumerate(split_stroke(t, xy, pen.spacing)):
            line = (
                _plan_line(clock, places, pen, limits, spent, longest)
                if len(places) > 1
                else None
            )
            begin = line.sample(0.0) if line else _plan_dot(places[0], pen, here)
            lift = 0.0 if n else pen.lift
            new = _plan_transfer(here, begin, lift, limits) if here else []
            flown.append(sample_references(line)[1][:, 0:2] if line else places)
            if line:
                has_line = True
                new.append(line)
            parts += new
            spent += sum(part.duration for part in new)
            _check_time(spent, longest)
            here = line.sample(line.duration) if line else begin
        deviations.append(_compute_deviation(np.concatenate(flown), xy, pen, number))
    if not has_line:
        raise ConfigError(
            "drawing: strokes", f"{len(drawn)}, of one place each", "at least one line"
        )
    path = join_pieces(parts)
    most = compute_peaks(path)
    return Drawing(path, max(deviations), most["speed"], most["acceleration"])


def _check_time(seconds: float, longest: float) -> None:
    """Raise ConfigError for a flight that is too long."""
    if seconds > longest:
        do = "Draw less at once, with fewer corners, or let it be faster."
        raise ConfigError(
            "drawing", f"{seconds:.0f} s or more", f"at most {longest:.0f} s", do
        )


def _plan_line(
    t: Vec, xy: Mat, pen: Pen, limits: Limits, spent: float, longest: float
) -> Piecewise:
    """Return one part of a stroke from rest to rest, as fast as the limits allow.

    t: (k,) s, of the drawing
    xy: (k, 2) m
    pen: how strokes are flown
    limits: of the flight
    spent: s, of the parts before it
    longest: s, of the flight
    """
    length = float(np.linalg.norm(np.diff(xy, axis=0), axis=1).sum())
    _check_time(spent + LEAST_LENGTH_SHARE * length / limits.v_max, longest)
    t, xy = fill_line(t, xy, pen.spacing)
    places, clock = _space_evenly(xy, t, pen)
    durations = _compute_durations(places, limits)
    if pen.timing == "drawn":
        durations = np.maximum(durations, _compute_drawn_pace(clock) * durations.mean())
    _check_time(spent + float(durations.sum()), longest)
    space = np.column_stack([places, np.full(len(places), pen.height)])
    yaws = (
        np.full(len(places), pen.yaw)
        if pen.yaw != "along"
        else _compute_directions(places)
    )
    flight = fit_spline(np.cumsum([0.0, *durations]), space, yaws, degree=7)
    return flight.slowed(compute_slowdown(flight, limits))


def _space_evenly(xy: Mat, t: Vec, pen: Pen) -> tuple[Mat, Vec]:
    """Return places (n, 2) at equal distances on the smoothed line, and the drawn times (n,) there.

    The ends are as drawn.
    """
    u = np.cumsum([0.0, *np.linalg.norm(np.diff(xy, axis=0), axis=1)])
    fine = np.linspace(0.0, u[-1], max(10 * len(u), 100))
    curve = smooth_line(xy, u, pen.smoothing, fine)
    length = np.cumsum([0.0, *np.linalg.norm(np.diff(curve, axis=0), axis=1)])
    at = np.interp(
        np.linspace(0.0, length[-1], max(math.ceil(length[-1] / pen.spacing), 2) + 1),
        length,
        fine,
    )
    places = np.column_stack(
        [np.interp(at, fine, curve[:, 0]), np.interp(at, fine, curve[:, 1])]
    )
    places[[0, -1]] = xy[[0, -1]]
    return places, np.interp(at, u, t)


def smooth_line(xy: Mat, u: Vec, sigma: float, at: Vec) -> Mat:
    """Return points on the cubic smoothing spline near given points.

        sum (w d / s)^2 <= k,  d <= LINE_SMOOTHING.largest_shift sigma

    s is sigma, halved until the curve stays close to the points and to the lines between them. With
    s = sigma, a long line could lose its bends, because its straight sides need little of the sum,
    and the curve could swing out between two points.
    xy: (k, 2) m, the points
    u: (k,) m, distance of each point along the line
    sigma: m, standard deviation of the tremor
    at: (n,) m along the line, where to evaluate
    d: m, distance of the curve from a point; w: its weight
    Returns (n, 2) m.
    """
    if len(xy) < 4:
        return np.column_stack([np.interp(at, u, xy[:, 0]), np.interp(at, u, xy[:, 1])])
    w = np.ones(len(xy))
    w[[0, -1]] = LINE_SMOOTHING.end_weight
    for scale in (*0.5 ** np.arange(LINE_SMOOTHING.trials), 0.0):
        budget = len(xy) * (scale * sigma) ** 2
        # With full_output a fit that did not converge is no warning: the curve itself is judged.
        (curve, _), *_ = splprep(xy.T, w=w, u=u, k=3, s=budget, full_output=1)
        if _is_close(curve, xy, u, sigma):
            break
    return np.asarray(np.column_stack(splev(at, curve)))


def _is_close(curve: Any, xy: Mat, u: Vec, sigma: float) -> bool:
    """Return whether a spline is close to the points (k, 2) at u (k,), and to the lines between them."""
    quarters = np.arange(4 * len(u) - 3) / 4.0
    index = np.arange(len(u))
    at = np.interp(quarters, index, u)
    x, y = splev(at, curve)
    off = np.hypot(
        x - np.interp(quarters, index, xy[:, 0]),
        y - np.interp(quarters, index, xy[:, 1]),
    )
    at_places = off[::4].max()
    between = off.max()
    allowed = LINE_SMOOTHING.largest_shift * sigma + LINE_SMOOTHING.rounding
    return bool(
        at_places <= allowed
        and between <= allowed + LINE_SMOOTHING.largest_bulge * np.diff(u).max()
    )


def _compute_durations(places: Mat, limits: Limits) -> Vec:
    """Return times (n - 1,) s between places (n, 2).

    v^2 <= BEND_ACCELERATION_SHARE a_max / curvature,  |v'| <= BEND_ACCELERATION_SHARE a_max,  v = 0 at both ends
    """
    d = np.linalg.norm(np.diff(places, axis=0), axis=1)
    v = np.zeros(len(places))
    v[1:-1] = np.minimum(
        limits.v_max,
        np.sqrt(
            BEND_ACCELERATION_SHARE
            * limits.a_max
            / np.maximum(_compute_curvatures(places), 1e-9)
        ),
    )
    for k in range(1, len(v)):
        v[k] = min(
            v[k],
            math.sqrt(
                v[k - 1] ** 2 + 2.0 * BEND_ACCELERATION_SHARE * limits.a_max * d[k - 1]
            ),
        )
    for k in range(len(v) - 2, -1, -1):
        v[k] = min(
            v[k],
            math.sqrt(
                v[k + 1] ** 2 + 2.0 * BEND_ACCELERATION_SHARE * limits.a_max * d[k]
            ),
        )
    return np.asarray(2.0 * d / (v[:-1] + v[1:]))


def _compute_curvatures(places: Mat) -> Vec:
    """Return 1/m of the circles through three places in a row (Menger): 4 area / (a b c)."""
    a = places[1:-1] - places[:-2]
    b = places[2:] - places[1:-1]
    sides = (
        np.linalg.norm(a, axis=1)
        * np.linalg.norm(b, axis=1)
        * np.linalg.norm(a + b, axis=1)
    )
    return np.asarray(
        2.0 * np.abs(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]) / np.maximum(sides, 1e-12)
    )


def _compute_drawn_pace(clock: Vec) -> Vec:
    """Return the duration of each drawn step (n - 1,), relative to the mean.

    It is limited to FASTEST_PACE .. SLOWEST_PACE.
    clock: (n,) s, drawn times
    """
    steps = np.diff(clock)
    return np.asarray(
        np.clip(steps / max(steps.mean(), 1e-9), FASTEST_PACE, SLOWEST_PACE)
    )


def _compute_directions(places: Mat) -> Vec:
    """Return the direction in rad of the line at each of places (n, 2).

    It points from the place before to the next place.
    """
    step = np.concatenate(
        [
            places[1:2] - places[0:1],
            places[2:] - places[:-2],
            places[-1:] - places[-2:-1],
        ]
    )
    return np.asarray(np.arctan2(step[:, 1], step[:, 0]))


def _plan_dot(xy: Vec, pen: Pen, here: FullState | None) -> FullState:
    """Return rest at a place; a yaw along the path stays as it is."""
    yaw = 0.0
    if pen.yaw != "along":
        yaw = pen.yaw
    elif here:
        yaw = here.yaw
    return FullState.at((xy[0], xy[1], pen.height), yaw=yaw)


def _plan_transfer(
    here: FullState, there: FullState, lift: float, limits: Limits
) -> list[Piecewise]:
    """Return straight flights from rest to rest, above the drawing if the pen is lifted."""
    up = np.array([0.0, 0.0, lift])
    if np.allclose(here.flat, there.flat, atol=1e-9):
        return []
    corners = [here.p + up, there.p + up, there.p] if lift else [there.p]
    legs: list[Piecewise] = []
    for k, corner in enumerate(corners):
        yaw = here.yaw if lift and k == 0 else there.yaw
        leg = PointToPoint(
            here,
            corner,
            yaw,
            compute_flight_time(here, corner, yaw, limits.v_max, limits.a_max),
        )
        legs.append(leg.slowed(max(1.0, compute_slowdown(leg, limits))))
        here = FullState.at(corner, yaw=yaw)
    return legs


def _compute_deviation(flown: Mat, drawn: Mat, pen: Pen, number: int) -> float:
    """Return the largest distance in m between the flown and the drawn lines of a stroke.

    It is measured from each line to the other (Hausdorff distance).
    flown: (n, 2) m
    drawn: (k, 2) m
    pen: how strokes are flown
    number: number of the stroke, for errors
    Raises ConfigError if it is larger than pen.allowed_deviation.
    """
    flown = _densify(flown)
    wanted = _densify(drawn)
    left_out, _ = cKDTree(flown).query(wanted)
    beside, _ = cKDTree(wanted).query(flown)
    deviation = float(max(left_out.max(), beside.max()))
    if deviation > pen.allowed_deviation:
        x, y = (
            wanted[np.argmax(left_out)]
            if left_out.max() >= beside.max()
            else flown[np.argmax(beside)]
        )
        raise ConfigError(
            f"drawing: strokes[{number}]",
            f"a flight {1e3 * deviation:.0f} mm beside it, at x = {x:.2f} m, y = {y:.2f} m",
            f"at most {1e3 * pen.allowed_deviation:.0f} mm with knots every {1e3 * pen.spacing:.0f} mm and a smoothing "
            f"of {1e3 * pen.smoothing:.0f} mm",
            "Draw it larger, or with its bends farther from each other.",
        )
    return deviation


def _densify(xy: Mat) -> Mat:
    """Return places along the straight lines between places (k, 2), at most DEVIATION_STEP m apart."""
    u = np.cumsum([0.0, *np.linalg.norm(np.diff(xy, axis=0), axis=1)])
    at = np.union1d(u, np.linspace(0.0, u[-1], math.ceil(u[-1] / DEVIATION_STEP) + 1))
    return np.column_stack([np.interp(at, u, xy[:, 0]), np.interp(at, u, xy[:, 1])])
