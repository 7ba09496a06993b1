"""Errors of the filters on the poses of recorded flights."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from crazychoir.filters.command_history import compute_history_size
from crazychoir.filters.kalman import KALMAN_NOISE, KalmanFilter, KalmanNoise
from crazychoir.filters.motion import CommandedMotion
from crazychoir.filters.row_filter import estimate_rows
from crazychoir.filters.rows import FilterKind, FilterTable
from crazychoir.filters.velocity import VelocityFilter
from crazychoir.platforms import Platform
from crazychoir.simulation.identification.flights import RealFlight
from crazychoir.simulation.identification.pose_streams import PoseStream, make_stream
from crazychoir.types import Bools, Mat, Vec


class FilterRules(NamedTuple):
    """How the filters are scored."""

    pose_rates: tuple[int, ...] = (50, 100, 240)
    """Hz: rates of the cameras."""
    horizon: float = 0.5
    """s, longest prediction of a filter."""
    settling_time: float = 1.0
    """s after take-off that do not count."""
    lost_share: float = 0.02
    """Share of the poses that are lost if there are gaps."""
    gap_spacing: float = 3.0
    """s in which there is one gap, at a random time."""


FILTER_RULES = FilterRules()
NO_GAPS = "no gaps"
"""Name of the flights in which each pose comes."""
GAP_LENGTHS = {NO_GAPS: 0.0, "50 ms": 0.05, "200 ms": 0.2}
"""s: length of the gaps in which no pose comes."""


@dataclass(frozen=True, slots=True)
class FilterCase:
    """A filter that is scored."""

    kind: FilterKind
    """Its law."""
    knows_commands: bool
    """Whether it gets the commands."""
    noise: KalmanNoise = KALMAN_NOISE
    """Noise of a Kalman filter."""

    def begin(self, table: FilterTable, platform: Platform, rate: int) -> None:
        """Begin the filter in a record for poses at this rate, Hz."""
        motion = CommandedMotion(platform.flat, 0.0) if self.knows_commands else None
        horizon = FILTER_RULES.horizon
        if self.kind is FilterKind.KALMAN:
            KalmanFilter(horizon, 1.0 / rate, motion, self.noise, table=table)
        else:
            VelocityFilter(
                horizon=horizon, period=1.0 / rate, motion=motion, table=table
            )


FILTER_CASES = {
    "derivative, no commands": FilterCase(FilterKind.DERIVATIVE, False),
    "derivative": FilterCase(FilterKind.DERIVATIVE, True),
    "kalman, no commands": FilterCase(FilterKind.KALMAN, False),
    "kalman": FilterCase(FilterKind.KALMAN, True),
}
"""The filters that a drone may have, with their defaults."""


@dataclass(frozen=True, slots=True)
class FilterErrors:
    """Errors of one filter in f flights, at one rate and with one kind of gaps."""

    filter: str
    """Name of the filter."""
    rate: int
    """Hz, of the poses."""
    gaps: str
    """Name of the gaps, of GAP_LENGTHS."""
    velocity: Vec
    """(f,) m/s: RMSE of the velocity in each flight."""
    rates: Vec
    """(f,) rad/s: RMSE of the body rates in each flight, against the gyroscope."""
    refused: int
    """Number of poses that the filter has not used."""

    def figures(self) -> dict[str, Any]:
        """Return the errors for JSON; each flight counts alike."""
        return {
            "filter": self.filter,
            "rate_hz": self.rate,
            "gaps": self.gaps,
            "velocity_mm_s": 1e3 * _root_mean_square(self.velocity),
            "rates_rad_s": _root_mean_square(self.rates),
            "refused": self.refused,
            "velocity_mm_s_of_flights": (1e3 * self.velocity).tolist(),
        }


def score_filters(
    flights: Sequence[RealFlight],
    platform: Platform,
    rates: Sequence[int] = FILTER_RULES.pose_rates,
    cases: Mapping[str, FilterCase] = FILTER_CASES,
) -> list[FilterErrors]:
    """Run the filters over all flights, at each rate and with each kind of gaps.

    The error is taken at each instant, with a pose or without, where commands and gyroscope are known. The truth is the
    derivative of the smoothed places, over 110 ms.
    """
    scored = []
    for rate in rates:
        errors = np.empty((len(flights), len(cases) * len(GAP_LENGTHS), 2))
        refused = np.zeros(errors.shape[1], int)
        for number, flight in enumerate(flights):
            stream = make_stream(flight, platform, rate, number)
            errors[number], own = _score_stream(stream, platform, rate, cases, number)
            refused += own
        names = [(name, gaps) for name in cases for gaps in GAP_LENGTHS]
        scored += [
            FilterErrors(
                filter=name,
                rate=rate,
                gaps=gaps,
                velocity=errors[:, r, 0],
                rates=errors[:, r, 1],
                refused=int(refused[r]),
            )
            for r, (name, gaps) in enumerate(names)
        ]
    return scored


def _score_stream(
    stream: PoseStream,
    platform: Platform,
    rate: int,
    cases: Mapping[str, FilterCase],
    seed: int,
) -> tuple[Mat, Vec]:
    """Return the errors (r, 2) of velocity and rates, and the refused poses (r,), a row a case and kind of gaps."""
    lost = [
        draw_lost_poses(stream.t, rate, length, np.random.default_rng(seed))
        for length in GAP_LENGTHS.values()
    ]
    history_size = compute_history_size(FILTER_RULES.horizon, 1.0 / rate)
    table = FilterTable.allocate(len(cases) * len(lost), history_size)
    begun = [case for case in cases.values() for _ in lost]
    for r, case in enumerate(begun):
        case.begin(table.share_row(r), platform, rate)
    states = _run(table, stream, np.tile(lost, (len(cases), 1)))
    counts = stream.is_known & (stream.t >= stream.t[0] + FILTER_RULES.settling_time)
    off = states[counts] - np.hstack([stream.v, stream.w])[counts, None]
    squared = np.stack(
        [(off[:, :, :3] ** 2).sum(axis=2), (off[:, :, 3:] ** 2).sum(axis=2)], axis=2
    )
    return np.sqrt(squared.mean(axis=0)), table.rows["refused"]


def draw_lost_poses(
    t: Vec, rate: int, gap_length: float, draw: np.random.Generator
) -> Bools:
    """Return which poses (n,) do not come. The first always comes."""
    lost = np.zeros(len(t), bool)
    if gap_length > 0.0:
        lost = draw.random(len(t)) < FILTER_RULES.lost_share
        spacing = FILTER_RULES.gap_spacing
        for start in np.arange(t[0], t[-1], spacing):
            begin = start + draw.uniform(0.0, spacing - gap_length)
            first = round((begin - t[0]) * rate)
            lost[first : first + round(gap_length * rate)] = True
    lost[0] = False
    return lost


def _run(table: FilterTable, stream: PoseStream, lost: Bools) -> Mat:
    """Run the filters of a table over a stream, and return their velocities and body rates (n, r, 6).

    lost: (r, n): which poses do not come
    """
    rows = table.rows
    states = np.empty((len(stream.t), len(rows), 6))
    for k, now in enumerate(stream.t):
        rows["pose"] = stream.poses[k]
        rows["has_pose"] = ~lost[:, k]
        estimate_rows(rows, table.history, now)
        states[k, :, :3] = rows["state"][:, 3:6]
        states[k, :, 3:] = rows["state"][:, 10:]
        rows["command"] = stream.commands[k]
    return states


def _root_mean_square(values: Vec) -> float:
    return float(np.sqrt(np.mean(values**2)))
