"""Hand-drawn strokes, made smooth enough to fly."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
import numpy.typing as npt
from scipy.interpolate import splev, splprep
from scipy.spatial import cKDTree

from crazychoir.errors import ConfigError
from crazychoir.planning.drawing.stroke import checked, split
from crazychoir.planning.feasibility import Limits, peaks, references
from crazychoir.planning.piecewise import Piecewise, joined
from crazychoir.planning.point_to_point import PointToPoint, duration_for
from crazychoir.planning.scaling import slowdown
from crazychoir.planning.spline import spline
from crazychoir.types import FullState, Mat, Vec

STANDARD = Limits(v_max=0.5, a_max=1.0, yaw_rate_max=2.0)
"""Default limits."""
DENSE = 0.002  # m, between the places by which the deviation is measured
SHARE = 0.5  # of a_max for the bends, and as much for the changes of speed
END_WEIGHT = 1e3  # of both ends in the smoothing, against 1 of each point in between
SLOWEST_PACE = 3.0
"""Largest pace of a drawn step that is flown, as a multiple of the mean pace in s/m."""
FASTEST_PACE = 1.0 / 3.0
"""Least pace of a drawn step that is flown, as a multiple of the mean pace in s/m."""


@dataclass(frozen=True, kw_only=True)
class Pen:
    """Settings for the flight of strokes.

    Raises ConfigError for values out of range.
    """

    height: float = 1.0
    """m, world."""
    lift: float = 0.0
    """Height in m above the drawing between two strokes."""
    yaw: float | Literal["along"] = 0.0
    """rad, or "along" the path."""
    timing: Literal["even", "drawn"] = "even"
    """"even": as fast as bends and limits allow. "drawn": slower where the hand was; it needs t."""
    spacing: float = 0.05
    """m, between knots."""
    smoothing: float = 0.004
    """m, standard deviation of the hand."""

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


def drawing(
    strokes: Sequence[npt.ArrayLike],
    pen: Pen = Pen(),
    limits: Limits = STANDARD,
    longest: float = math.inf,
) -> Drawing:
    """Return the smooth flight along drawn strokes, each from rest to rest, from end to end.

    A stroke is thinned, and split at sharp turns, where the drone stops. The tremor of a part is
    smoothed out. The part is cut into equal lengths, timed, interpolated by a spline of degree 7
    and slowed down as the limits need. Straight flights join the strokes, at the same height or
    lifted. A stroke of a single place is a dot: the drone flies to it.

    strokes: (k, 2) rows x, y m, or (k, 3) rows t s, x, y m, world
    pen: how strokes are flown
    limits: v_max and a_max finite
    longest: s, of the flight. A longer flight is refused as soon as its duration is known.
    Raises ConfigError for strokes that are wrong, or a flight that is too long.
    """
    limits.check_timed("drawing")
    drawn = [
        checked(stroke, f"drawing: strokes[{n}]") for n, stroke in enumerate(strokes)
    ]
    if pen.timing == "drawn" and any(np.shape(stroke)[1] == 2 for stroke in strokes):
        raise ConfigError(
            "drawing: strokes", "rows of x, y", 'rows of t, x, y for the timing "drawn"'
        )
    lines: list[Piecewise] = []
    parts: list[Piecewise] = []
    here: FullState | None = None
    spent = 0.0
    for t, xy in drawn:
        for n, (clock, places) in enumerate(split(t, xy, pen.spacing)):
            line = (
                _line(clock, places, pen, limits, spent, longest)
                if len(places) > 1
                else None
            )
            begin = line.sample(0.0) if line else _dot(places[0], pen, here)
            new = _transfer(here, begin, 0.0 if n else pen.lift, limits) if here else []
            if line:
                lines.append(line)
                new.append(line)
            parts += new
            spent += sum(part.duration for part in new)
            _check_time(spent, longest)
            here = line.sample(line.duration) if line else begin
    if len(lines) == 0:
        raise ConfigError(
            "drawing: strokes", f"{len(drawn)}, of one place each", "at least one line"
        )
    path = joined(parts)
    most = peaks(path)
    return Drawing(
        path,
        _deviation(lines, [xy for _, xy in drawn if len(xy) > 1]),
        most["speed"],
        most["acceleration"],
    )


def _check_time(seconds: float, longest: float) -> None:
    """Raise ConfigError for a flight that is too long."""
    if seconds > longest:
        do = "Draw less at once, with fewer corners, or let it be faster."
        raise ConfigError(
            "drawing", f"{seconds:.0f} s or more", f"at most {longest:.0f} s", do
        )


def _line(
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
    places, clock = _even(xy, t, pen)
    durations = _durations(places, limits)
    if pen.timing == "drawn":
        durations = np.maximum(durations, _drawn_pace(clock) * durations.mean())
    _check_time(spent + float(durations.sum()), longest)
    space = np.column_stack([places, np.full(len(places), pen.height)])
    yaws = np.full(len(places), pen.yaw) if pen.yaw != "along" else _directions(places)
    flight = spline(np.cumsum([0.0, *durations]), space, yaws, degree=7)
    return flight.slowed(slowdown(flight, limits))


def _even(xy: Mat, t: Vec, pen: Pen) -> tuple[Mat, Vec]:
    """Return places (n, 2) at equal distances on the smoothed line, and the drawn times (n,) there.

    The ends are as drawn.
    """
    u = np.cumsum([0.0, *np.linalg.norm(np.diff(xy, axis=0), axis=1)])
    fine = np.linspace(0.0, u[-1], max(10 * len(u), 100))
    curve = smoothed(xy, u, pen.smoothing, fine)
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


def smoothed(xy: Mat, u: Vec, sigma: float, at: Vec) -> Mat:
    """Return the cubic smoothing spline through places at certain parameters.

        sum (w d / sigma)^2 <= k

    xy: (k, 2) m
    u: (k,), parameters of the places
    sigma: m
    at: (n,), parameters of the result
    Returns (n, 2).
    """
    if len(xy) < 4:
        return np.column_stack([np.interp(at, u, xy[:, 0]), np.interp(at, u, xy[:, 1])])
    w = np.ones(len(xy))
    w[[0, -1]] = END_WEIGHT
    curve, _ = splprep(xy.T, w=w, u=u, k=3, s=len(xy) * sigma**2)
    return np.asarray(np.column_stack(splev(at, curve)))


def _durations(places: Mat, limits: Limits) -> Vec:
    """Return times (n - 1,) s between places (n, 2).

    v^2 <= SHARE a_max / curvature,  |v'| <= SHARE a_max,  v = 0 at both ends
    """
    d = np.linalg.norm(np.diff(places, axis=0), axis=1)
    v = np.zeros(len(places))
    v[1:-1] = np.minimum(
        limits.v_max,
        np.sqrt(SHARE * limits.a_max / np.maximum(_curvatures(places), 1e-9)),
    )
    for k in range(1, len(v)):
        v[k] = min(
            v[k], math.sqrt(v[k - 1] ** 2 + 2.0 * SHARE * limits.a_max * d[k - 1])
        )
    for k in range(len(v) - 2, -1, -1):
        v[k] = min(v[k], math.sqrt(v[k + 1] ** 2 + 2.0 * SHARE * limits.a_max * d[k]))
    return np.asarray(2.0 * d / (v[:-1] + v[1:]))


def _curvatures(places: Mat) -> Vec:
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


def _drawn_pace(clock: Vec) -> Vec:
    """Return the share of each step in the drawn times (n,).

    The mean is 1, and each is within a third and three times of it.
    """
    steps = np.diff(clock)
    return np.asarray(
        np.clip(steps / max(steps.mean(), 1e-9), FASTEST_PACE, SLOWEST_PACE)
    )


def _directions(places: Mat) -> Vec:
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


def _dot(xy: Vec, pen: Pen, here: FullState | None) -> FullState:
    """Return rest at a place; a yaw along the path stays as it is."""
    yaw = pen.yaw if pen.yaw != "along" else here.yaw if here else 0.0
    return FullState.at((xy[0], xy[1], pen.height), yaw=yaw)


def _transfer(
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
            duration_for(here, corner, yaw, limits.v_max, limits.a_max),
        )
        legs.append(leg.slowed(max(1.0, slowdown(leg, limits))))
        here = FullState.at(corner, yaw=yaw)
    return legs


def _deviation(lines: list[Piecewise], drawn: list[Mat]) -> float:
    """Return the largest distance in m between the flown and the drawn lines, both ways."""
    flown = np.concatenate([references(line)[1][:, 0:2] for line in lines])
    wanted = np.concatenate([_dense(xy) for xy in drawn])
    there, _ = cKDTree(flown).query(wanted)
    back, _ = cKDTree(wanted).query(flown)
    return float(max(there.max(), back.max()))


def _dense(xy: Mat) -> Mat:
    """Return places along the straight lines between places (k, 2), at most DENSE m apart."""
    u = np.cumsum([0.0, *np.linalg.norm(np.diff(xy, axis=0), axis=1)])
    at = np.union1d(u, np.linspace(0.0, u[-1], math.ceil(u[-1] / DENSE) + 1))
    return np.column_stack([np.interp(at, u, xy[:, 0]), np.interp(at, u, xy[:, 1])])
