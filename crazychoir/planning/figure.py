"""Circles and eights, from rest to rest, with analytic velocity, acceleration and jerk."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from crazychoir.errors import ConfigError
from crazychoir.numerics.kernels import kernel, memory, real, vector
from crazychoir.numerics.math3d import Triple
from crazychoir.types import FullState, Vec

Yaw = float | Literal["along"]
YAW_GIVEN = 0.0
"""Kind of yaw: a given angle and rate."""
YAW_ALONG = 1.0
"""Kind of yaw: along the path."""


@kernel()
def _compute_ramp(s: float, w: float, ramp: float) -> tuple[float, float, float, float]:
    """Return phi, phi', phi'', phi''' at s, 0 <= s <= ramp.

    phi' grows from 0 to w along 10 s^3 - 15 s^4 + 6 s^5.
    """
    x = s / ramp
    phi = w * ramp * x**4 * (2.5 + x * (-3.0 + x))
    first = w * x**3 * (10.0 + x * (-15.0 + 6.0 * x))
    second = w / ramp * 30.0 * x**2 * (1.0 - x) ** 2
    third = w / ramp**2 * 60.0 * x * (1.0 - x) * (1.0 - 2.0 * x)
    return phi, first, second, third


@kernel()
def _compute_phase(
    t: float, w: float, ramp: float, duration: float
) -> tuple[float, float, float, float]:
    """Return phi and its derivatives at t, 0 <= t <= duration."""
    whole = w * (duration - ramp)
    if t < ramp:
        return _compute_ramp(t, w, ramp)
    if t > duration - ramp:
        phi, first, second, third = _compute_ramp(duration - t, w, ramp)
        return whole - phi, first, -second, third
    return w * (t - 0.5 * ramp), w, 0.0, 0.0


@kernel()
def _compute_curve(
    phi: float, size: float, n: float, offset: float
) -> tuple[float, float, float, float]:
    """Return size sin(n phi + offset) and its derivatives by phi."""
    s = size * math.sin(n * phi + offset)
    c = size * math.cos(n * phi + offset)
    return s, n * c, -n * n * s, -n * n * n * c


@kernel()
def _compute_heading(
    x: tuple[float, float, float, float],
    y: tuple[float, float, float, float],
    is_circle: bool,
    phi: float,
) -> tuple[float, float]:
    """Return the direction of (x', y'), unwrapped, and its derivative by phi.

    An eight never heads to +y.
    """
    yaw = 0.5 * math.pi + phi if is_circle else math.atan2(x[1], -y[1]) - 0.5 * math.pi
    return yaw, (x[1] * y[2] - y[1] * x[2]) / (x[1] * x[1] + y[1] * y[1])


@kernel(vector, real, memory)
def _sample_figure(g: Vec, t: float, out: Vec) -> None:
    """Compute the flat output at t.

    g: (14,), see Figure
    t: s
    out: (14,): the result
    """
    phi, d1, d2, d3 = _compute_phase(t, g[3], g[4], g[5])
    x = _compute_curve(phi, g[6], g[7], g[8])
    y = _compute_curve(phi, g[9], g[10], 0.0)
    for c in range(2):
        q = x if c == 0 else y
        out[c] = g[c] + q[0]
        out[3 + c] = q[1] * d1
        out[6 + c] = q[2] * d1 * d1 + q[1] * d2
        out[9 + c] = q[3] * d1**3 + 3.0 * q[2] * d1 * d2 + q[1] * d3
    out[2] = g[2]
    out[5] = 0.0
    out[8] = 0.0
    out[11] = 0.0
    if g[11] == YAW_ALONG:
        out[12], rate = _compute_heading(x, y, g[7] == g[10], phi)
        out[13] = rate * d1
    else:
        out[12] = g[12] + g[13] * phi
        out[13] = g[13] * d1


@dataclass(frozen=True, slots=True)
class _PlaneCurve:
    """The closed curve x = A sin(n_x phi + d), y = B sin(n_y phi)."""

    name: str
    """Its name in errors."""
    x: Triple
    """A in m, n_x, d in rad."""
    y: tuple[float, float]
    """B in m, n_y."""


class Figure:
    """A curve about a centre, at constant height, in whole laps from rest to rest.

        x = A sin(n_x phi + d), y = B sin(n_y phi)
        phi' = w S(t / R) at first, then w, at last w S((T - t) / R)
        S(s) = 10 s^3 - 15 s^4 + 6 s^5,  T = 2 pi laps / w + R
        v = q' phi',  a = q'' phi'^2 + q' phi'',  j = q''' phi'^3 + 3 q'' phi' phi'' + q' phi'''

    So p, v, a and j are continuous, and v, a, j are 0 at both ends. `circle` and `eight` make
    figures.

    figures: (14,): centre (3,) m, w rad/s, R s, T s, A m, n_x, d rad, B m, n_y, then the yaw: kind,
        at the start rad, turn per rad of phi
    """

    def __init__(self, figures: Vec) -> None:
        self._figures = figures
        self.duration = float(figures[5])

    def sample(self, t: float) -> FullState:
        """Return the reference t seconds after the start."""
        out = np.empty(14)
        _sample_figure(self._figures, min(max(t, 0.0), self.duration), out)
        return FullState(out)

    def done(self, t: float) -> bool:
        """Return whether the end is reached at t."""
        return t >= self.duration


def circle(
    center: Sequence[float] | Vec,
    radius: float,
    period: float,
    laps: float = 1.0,
    ramp: float | None = None,
    yaw: Yaw = 0.0,
    yaw_rate: float = 0.0,
) -> Figure:
    """Return a counter-clockwise circle.

        x = r cos phi, y = r sin phi, from (r, 0), at the speed 2 pi r / period

    center: (3,) m
    radius: m, r
    period: s, of a lap at full speed
    laps: number of laps at full speed and in the ramps
    ramp: s from rest to full speed; half a period without
    yaw: rad at the start, or "along" the path
    yaw_rate: rad/s at full speed, for a yaw that is not along the path
    Raises ConfigError for sizes, laps, a ramp or a yaw that do not fit.
    """
    w = _compute_frequency("circle", period, radius=radius)
    curve = _PlaneCurve("circle", (radius, 1.0, 0.5 * math.pi), (radius, 1.0))
    return _build_figure(curve, center, w, laps, ramp, yaw, yaw_rate)


def eight(
    center: Sequence[float] | Vec,
    half_axes: tuple[float, float],
    period: float,
    laps: float = 1.0,
    ramp: float | None = None,
    yaw: Yaw = 0.0,
    yaw_rate: float = 0.0,
) -> Figure:
    """Return an eight, from its middle.

        x = A sin phi, y = B sin 2 phi,  peak speed w sqrt(A^2 + 4 B^2) m/s,  w = 2 pi / period

    center: (3,) m
    half_axes: m, A and B, half the width and half the height
    period: s
    laps, ramp, yaw, yaw_rate: as in `circle`
    Raises ConfigError as `circle` does.
    """
    a, b = half_axes
    w = _compute_frequency("eight", period, a=a, b=b)
    curve = _PlaneCurve("eight", (a, 1.0, 0.0), (b, 2.0))
    return _build_figure(curve, center, w, laps, ramp, yaw, yaw_rate)


def _compute_frequency(name: str, period: float, **sizes: float) -> float:
    """Return 2 pi / period; raise ConfigError unless period and sizes are positive."""
    for key, value in {"period": period, **sizes}.items():
        if not (math.isfinite(value) and value > 0.0):
            raise ConfigError(f"{name}: {key}", value, "a positive number")
    return 2.0 * math.pi / period


def _build_figure(
    curve: _PlaneCurve,
    center: Sequence[float] | Vec,
    w: float,
    laps: float,
    ramp: float | None,
    yaw: Yaw,
    yaw_rate: float,
) -> Figure:
    """Return the figure; raise ConfigError for laps, a ramp or a yaw that do not fit."""
    if not (math.isfinite(laps) and laps > 0.0):
        raise ConfigError(f"{curve.name}: laps", laps, "a positive number")
    period = 2.0 * math.pi / w
    ramp = 0.5 * period * min(laps, 1.0) if ramp is None else ramp
    if not 0.0 < ramp <= laps * period:
        raise ConfigError(
            f"{curve.name}: ramp",
            ramp,
            f"between 0 and {laps * period:g} s, the time of the laps",
        )
    along = isinstance(yaw, str)
    if along and (yaw != "along" or yaw_rate != 0.0):
        raise ConfigError(
            f"{curve.name}: yaw, yaw_rate",
            [yaw, yaw_rate],
            'rad and rad/s, or "along" without a rate',
        )
    angle = 0.0 if isinstance(yaw, str) else yaw
    if len(center) != 3 or not np.all(np.isfinite([*center, angle, yaw_rate])):
        raise ConfigError(
            f"{curve.name}: center, yaw, yaw_rate",
            [*center, yaw, yaw_rate],
            "three m, rad, rad/s: finite",
        )
    kind = YAW_ALONG if along else YAW_GIVEN
    return Figure(
        np.array(
            [
                *center,
                w,
                ramp,
                laps * period + ramp,
                *curve.x,
                *curve.y,
                kind,
                angle,
                yaw_rate / w,
            ]
        )
    )
