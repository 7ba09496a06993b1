"""Velocity errors of the filters on a flight with known truth.

A quadrotor flies an eight at 1 m/s at most while its heading turns, by differential flatness.
Cameras see it with noise, with independent dropouts and with one gap. The error is the root
mean square of the length of the error vector over all ticks after the first FILTER_BENCH.settling_time s,
including ticks without a pose.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from rich.table import Table

from crazychoir.filters.kalman import KalmanFilter
from crazychoir.filters.motion import RATE_LAG, CommandedMotion
from crazychoir.filters.state_filter import StateFilter
from crazychoir.filters.velocity import VelocityFilter
from crazychoir.numerics.math3d import (
    STANDARD_GRAVITY,
    quaternion,
    quaternion_conjugate,
    quaternion_product,
    rotation_exponential,
    rotation_from_flat,
    rotation_logarithm,
    yaw_of,
)
from crazychoir.platforms import PAPER_PLATFORM
from crazychoir.types import Pose, Vec


@dataclass(frozen=True, slots=True)
class FilterBenchSettings:
    """Settings of `crazychoir bench filters`: the flight, and the errors of its poses and
    commands.
    """

    pose_rates: tuple[int, ...] = (50, 100, 240)
    """Hz: rates of the cameras."""
    seeds: tuple[int, ...] = (1, 2, 3)
    """Seeds of the random errors."""
    position_noise: float = 0.0005
    """m: standard deviation of a position, an axis."""
    angle_noise: float = math.radians(0.25)
    """rad: standard deviation of an attitude, an axis."""
    dropout: float = 0.02
    """Share of the poses that are lost."""
    gap_start: float = 6.0
    """s: time at which the gap without poses begins."""
    gap_length: float = 0.05
    """s: length of the gap without poses."""
    settling_time: float = 2.0
    """s: start of the flight, which does not count."""
    duration: float = 12.0
    """s: length of the flight."""
    turn_rate: float = 1.0
    """rad/s: rate of the heading, so that it passes pi."""
    thrust_factor: float = 0.95
    """Commanded thrust / flown thrust: the battery is fuller than assumed."""


FILTER_BENCH = FilterBenchSettings()


Say = Callable[[str], None]


class VelocityEstimator(Protocol):
    """The estimator of a row."""

    def told(self, pose: Pose | None, now: float, command: Vec) -> tuple[Vec, Vec]:
        """Return the velocity (3,) m/s and the body rates (3,) rad/s at `now`.

        pose: newest pose, None if it was lost
        now: s
        command: (4,) N and rad/s: thrust and body rates commanded from now on
        """
        ...


class OriginalFilter:
    """The difference equation of the original CrazyChoir; its gain fits 100 Hz, whatever the rate.

        v_k = 0.6 v_k-1 + 40 (p_k - p_k-1)

    The rates of roll, pitch and yaw follow from these angles by the same equation.
    Angles are not unwrapped, and their rates are taken for body rates. A missing pose is replaced
    by the last one.
    """

    def __init__(self) -> None:
        self._last = np.zeros(6)
        self._rates = np.zeros(6)

    def told(self, pose: Pose | None, now: float, command: Vec) -> tuple[Vec, Vec]:
        """Return the velocity and the rates of the angles, (3,) each."""
        here = (
            self._last if pose is None else np.array([*pose.p, *_euler_angles(pose.q)])
        )
        self._rates = 0.6 * self._rates + 40.0 * (here - self._last)
        self._last = here
        return self._rates[:3], self._rates[3:]


class PilotFilter:
    """A filter as the pilot runs it.

    filtering: the filter
    commanded: whether it gets the commands
    """

    def __init__(self, filtering: StateFilter, commanded: bool) -> None:
        self.filter = filtering
        self.commanded = commanded

    def told(self, pose: Pose | None, now: float, command: Vec) -> tuple[Vec, Vec]:
        """Return the velocity and the body rates, (3,) each; zero before the first pose."""
        state = (
            self.filter.predict(now) if pose is None else self.filter.update(pose, now)
        )
        if self.commanded:
            self.filter.commanded = command
        return (np.zeros(3), np.zeros(3)) if state is None else (state.v, state.w)


FILTER_MAKERS: dict[str, Callable[[float], VelocityEstimator]] = {
    "original": lambda period: OriginalFilter(),
    "derivative": lambda period: PilotFilter(
        VelocityFilter(period=period, motion=CommandedMotion(PAPER_PLATFORM.flat, 0.0)),
        commanded=True,
    ),
    "kalman": lambda period: PilotFilter(
        KalmanFilter(period=period, motion=CommandedMotion(PAPER_PLATFORM.flat, 0.0)),
        commanded=True,
    ),
    "kalman, no commands": lambda period: PilotFilter(
        KalmanFilter(period=period), commanded=False
    ),
}
"""Makes a new estimator, by name, for cameras with the given period in s."""


def run(
    rates: tuple[int, ...] = FILTER_BENCH.pose_rates,
    seeds: tuple[int, ...] = FILTER_BENCH.seeds,
    say: Say = lambda line: None,
) -> dict[str, Any]:
    """Return {"rows": [one a filter and rate]}.

    rates: Hz: poses a second
    seeds: seeds of the noise
    say: called with the rate being measured
    """
    rows = []
    for rate in rates:
        say(f"{rate} Hz")
        flight = TrueFlight.at(rate)
        for name, new in FILTER_MAKERS.items():
            v, w = flight.errors(new, seeds)
            rows.append(
                {
                    "filter": name,
                    "rate_hz": rate,
                    "noise_mm": 1e3 * FILTER_BENCH.position_noise,
                    "noise_deg": math.degrees(FILTER_BENCH.angle_noise),
                    "dropout": FILTER_BENCH.dropout,
                    "gap_ms": 1e3 * FILTER_BENCH.gap_length,
                    "velocity_rmse_mm_s": 1e3 * v,
                    "angular_rmse_rad_s": w,
                }
            )
    return {"rows": rows}


def table(result: dict[str, Any]) -> Table:
    """Return the rows as a table."""
    shown = Table(title="Root mean square of the error of the velocities")
    for name in ("filter", "poses, Hz", "velocity, mm/s", "body rates, rad/s"):
        shown.add_column(name, justify="left" if name == "filter" else "right")
    for row in result["rows"]:
        v = row["velocity_rmse_mm_s"]
        w = row["angular_rmse_rad_s"]
        shown.add_row(row["filter"], str(row["rate_hz"]), f"{v:.1f}", f"{w:.3f}")
    return shown


@dataclass(frozen=True)
class TrueFlight:
    """The true flight."""

    times: Vec
    """(n,) s."""
    states: Vec
    """(n, 13): true state at each time."""
    commands: Vec
    """(n, 4): command from each time on."""

    @classmethod
    def at(cls, rate: int) -> "TrueFlight":
        """Return the flight sampled at `rate` Hz."""
        times = np.arange(round(FILTER_BENCH.duration * rate)) / rate
        states, commands = zip(*(true_state(t) for t in times), strict=True)
        return cls(times, np.array(states), np.array(commands))

    def errors(
        self, new: Callable[[float], VelocityEstimator], seeds: tuple[int, ...]
    ) -> tuple[float, float]:
        """Return the root mean square errors of velocity, m/s, and body rates, rad/s.

        new: makes an estimator for a period in s
        seeds: seeds of the noise
        """
        counted = self.times >= FILTER_BENCH.settling_time
        period = float(self.times[1])
        # Shape (seeds, n, v or w, 3).
        told = np.array([self._flown(new(period), seed) for seed in seeds])[:, counted]
        off = told - self.states[counted][:, [3, 4, 5, 10, 11, 12]].reshape(-1, 2, 3)
        v, w = np.sqrt((off**2).sum(axis=3).mean(axis=(0, 1))).tolist()
        return v, w

    def _flown(self, estimate: VelocityEstimator, seed: int) -> list[tuple[Vec, Vec]]:
        draw = np.random.default_rng(seed)
        said = []
        for t, x, u in zip(self.times, self.states, self.commands, strict=True):
            noise = draw.standard_normal(6)
            lost = draw.random() < FILTER_BENCH.dropout
            angle = FILTER_BENCH.angle_noise * noise[3:]
            pose = Pose(
                np.array(
                    [
                        *(x[:3] + FILTER_BENCH.position_noise * noise[:3]),
                        *quaternion_product(
                            tuple(x[6:10]), rotation_exponential(*angle)
                        ),
                    ]
                )
            )
            said.append(
                estimate.told(
                    None
                    if lost
                    or FILTER_BENCH.gap_start
                    <= t
                    < FILTER_BENCH.gap_start + FILTER_BENCH.gap_length
                    else pose,
                    float(t),
                    u,
                )
            )
        return said


def true_state(t: float) -> tuple[Vec, Vec]:
    """Return the state (13,) and the command (4,) at t s.

        u_1 = FILTER_BENCH.thrust_factor thrust,  u_2..4 = w + RATE_LAG w'
        w = log(q(t)^-1 q(t + h)) / h by central differences

    The commanded thrust is wrong by the factor FILTER_BENCH.thrust_factor. The commanded rates lead the flown rates by
    RATE_LAG, because the drone reaches them later.
    """
    h = 1e-3
    p, v, q, thrust = _flat_output(t)
    before = _flat_output(t - h)[2]
    after = _flat_output(t + h)[2]
    first = _rotation_between(before, q) / h
    second = _rotation_between(q, after) / h
    w = 0.5 * (first + second)
    turning = (second - first) / h
    return np.array([*p, *v, *q, *w]), np.array(
        [FILTER_BENCH.thrust_factor * thrust, *(w + RATE_LAG * turning)]
    )


def _rotation_between(before: Vec, after: Vec) -> Vec:
    """Return the rotation vector (3,) rad, body, from one attitude to the other."""
    return np.array(
        rotation_logarithm(
            quaternion_product(quaternion_conjugate(tuple(before)), tuple(after))
        )
    )


def _flat_output(t: float) -> tuple[Vec, Vec, Vec, float]:
    """Return p (3,), v (3,), q (4,) and the thrust in N of the eight at t s.

    x = sin wt, y = 1/2 sin 2wt, z = 1, w = 1/sqrt(2) rad/s
    F/m = g e3 + a + (1/m) R A R^T v,  R e3 along F
    """
    w = math.sqrt(0.5)
    yaw = FILTER_BENCH.turn_rate * t
    s = math.sin(w * t)
    c = math.cos(w * t)
    s2 = math.sin(2.0 * w * t)
    c2 = math.cos(2.0 * w * t)
    v = w * np.array([c, c2, 0.0])
    pull = np.array([-w * w * s, -2.0 * w * w * s2, STANDARD_GRAVITY])
    r = rotation_from_flat(pull, yaw)
    # A fixed-point iteration: the drag depends a little on the attitude.
    for _ in range(3):
        f = pull + r @ (np.array(PAPER_PLATFORM.drag) * (r.T @ v)) / PAPER_PLATFORM.mass
        r = rotation_from_flat(f, yaw)
    return (
        np.array([s, 0.5 * s2, 1.0]),
        v,
        quaternion(r),
        float(PAPER_PLATFORM.mass * np.linalg.norm(f)),
    )


def _euler_angles(q: Vec) -> tuple[float, float, float]:
    """Return roll, pitch and yaw, rad."""
    x, y, z, w = q.tolist()
    roll = math.atan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y))
    return roll, math.asin(min(max(2.0 * (w * y - z * x), -1.0), 1.0)), yaw_of(q)
