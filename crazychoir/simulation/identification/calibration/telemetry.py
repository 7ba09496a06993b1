"""Find lost packets in recorded telemetry, and align the clock of a drone with that of motion capture."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.signal import savgol_filter
from scipy.spatial.transform import Rotation

from crazychoir.simulation.identification.flights import (
    FLIGHT_RULES,
    FLIGHT_TIME_STEP,
)
from crazychoir.types import Bools, Mat, Vec


class TelemetryRules(NamedTuple):
    """How gaps and clocks are found."""

    straight_line: float = 1e-5
    """rad/s: a row with a smaller second difference of all axes of the gyroscope was interpolated."""
    shortest_run: int = 3
    """Least number of such rows in a row that are a gap."""
    window_rows: int = 400
    """Rows of a part of the flight for which a delay is found: 4 s."""
    largest_delay_rows: int = 25
    """Largest delay that is searched, in rows: 0.25 s."""
    least_rate: float = 0.15
    """rad/s: smallest deviation of the rates of a part that tells its delay."""


TELEMETRY_RULES = TelemetryRules()


@dataclass(frozen=True, slots=True)
class ClockFit:
    """Delay of the drone's clock behind that of motion capture, as a straight line over time."""

    offset: float
    """s at the start."""
    drift: float
    """s a s."""
    parts: int
    """Parts of the flight that told their delay."""

    def delays(self, t: Vec) -> Vec:
        """Return the delays (n,) in s at the times t (n,)."""
        return np.asarray(self.offset + self.drift * t)


def find_interpolated(gyro: Mat) -> Bools:
    """Return the rows (n,) that lie on a straight line between others, in all axes of the gyroscope (n, 3).

    A gyroscope is never so quiet: such rows were interpolated over lost packets, or are frozen.
    """
    bend = np.abs(np.diff(gyro, n=2, axis=0)).max(axis=1)
    straight = np.concatenate([[False], bend < TELEMETRY_RULES.straight_line, [False]])
    edges = np.diff(np.concatenate([[0], straight.astype(int), [0]]))
    found = np.zeros(len(gyro), bool)
    for begin, end in zip(
        np.flatnonzero(edges == 1), np.flatnonzero(edges == -1), strict=True
    ):
        if end - begin >= TELEMETRY_RULES.shortest_run:
            found[begin:end] = True
    return found


def integrate_turns(q: Mat) -> Mat:
    """Return angles (n, 3) in rad that grow by the turn from each attitude (n, 4) to the next, body."""
    turns = (Rotation.from_quat(q[:-1]).inv() * Rotation.from_quat(q[1:])).as_rotvec()
    return np.asarray(np.vstack([np.zeros(3), np.cumsum(turns, axis=0)]))


def compute_pose_rates(q: Mat) -> Mat:
    """Return the body rates (n, 3) in rad/s of the attitudes (n, 4), centred."""
    return np.asarray(
        savgol_filter(
            integrate_turns(q),
            FLIGHT_RULES.smoothing_rows,
            3,
            deriv=1,
            delta=FLIGHT_TIME_STEP,
            axis=0,
        )
    )


def align_clock(
    t: Vec, q: Mat, gyro: Mat, is_known: Bools, rows: slice
) -> ClockFit | None:
    """Return how late the gyroscope is behind the attitudes, None if the flight is too calm to tell.

    Each part of the flight tells the delay at which the rates of both differ least; a line through them is fitted.
    """
    rates = compute_pose_rates(q)
    smooth = savgol_filter(gyro, FLIGHT_RULES.smoothing_rows, 3, axis=0)
    times: list[float] = []
    delays: list[float] = []
    most = TELEMETRY_RULES.largest_delay_rows
    length = TELEMETRY_RULES.window_rows
    for begin in range(rows.start + most, rows.stop - most - length, length // 2):
        part = slice(begin, begin + length)
        wanted = rates[part, :2]
        if wanted.std() < TELEMETRY_RULES.least_rate or is_known[part].mean() < 0.9:
            continue
        errors = np.array(
            [
                np.mean((smooth[begin + d : begin + d + length, :2] - wanted) ** 2)
                for d in range(-most, most + 1)
            ]
        )
        best = int(np.argmin(errors))
        if best in (0, len(errors) - 1):
            continue
        low, middle, high = errors[best - 1 : best + 2]
        vertex = best + 0.5 * (low - high) / (low - 2.0 * middle + high)
        delays.append((vertex - most) * FLIGHT_TIME_STEP)
        times.append(float(t[begin + length // 2]))
    if not delays:
        return None
    return _fit_line(np.array(times), np.array(delays))


def _fit_line(times: Vec, delays: Vec) -> ClockFit:
    """Fit a line through delays; a few wrong ones do not move it."""
    kept = np.ones(len(times), bool)
    drift = 0.0
    offset = float(np.median(delays))
    for _ in range(5):
        if kept.sum() >= 4 and np.ptp(times[kept]) > 10.0:
            drift, offset = np.polyfit(times[kept], delays[kept], 1).tolist()
        else:
            offset = float(np.median(delays[kept]))
        residual = np.abs(delays - offset - drift * times)
        kept = residual <= max(3.0 * float(np.median(residual)), 0.002)
    return ClockFit(offset, drift, int(kept.sum()))
