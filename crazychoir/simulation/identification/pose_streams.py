"""Make poses, commands and truth for a filter from a recorded flight, at any rate of the cameras."""

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.signal import savgol_coeffs, savgol_filter
from scipy.spatial.transform import Rotation

from crazychoir.filters.motion import RATE_LAG
from crazychoir.numerics.math3d import STANDARD_GRAVITY
from crazychoir.platforms import Platform
from crazychoir.simulation.identification.flights import (
    FLIGHT_RULES,
    FLIGHT_TIME_STEP,
    RealFlight,
)
from crazychoir.simulation.identification.open_loop import compute_motor_thrust
from crazychoir.types import Bools, Mat, Vec

POLYNOMIAL_DEGREE = 3
"""Degree of the polynomials of the truth."""


@dataclass(frozen=True, slots=True)
class PoseStream:
    """What a filter gets in a flight at n instants, and the truth."""

    t: Vec
    """(n,) s."""
    poses: Mat
    """(n, 7), as Pose.flat."""
    commands: Mat
    """(n, 4): thrust N and body rates rad/s, obeyed from each instant on."""
    v: Mat
    """(n, 3) m/s, world: true velocity."""
    w: Mat
    """(n, 3) rad/s, body: gyroscope."""
    is_known: Bools
    """(n,): whether commands and gyroscope lie outside the gaps of the telemetry."""


def make_stream(
    flight: RealFlight, platform: Platform, rate: int, seed: int
) -> PoseStream:
    """Return the part of a flight in the air.

    If its rows divide evenly among the poses, the poses are recorded ones. Otherwise they are the smoothed
    flight with white noise, which is as large as that of the recorded poses.

    rate: Hz, of the poses
    seed: seed of the noise
    """
    a, b = flight.airborne
    rows = slice(a, b)
    recorded = PoseStream(
        t=flight.t[rows],
        poses=np.hstack([flight.p, flight.q])[rows],
        commands=_find_commands(flight, platform)[rows],
        v=flight.v[rows],
        w=flight.w[rows],
        is_known=flight.is_known[rows],
    )
    rows_a_pose = 1.0 / (rate * FLIGHT_TIME_STEP)
    step = round(rows_a_pose)
    if step >= 1 and abs(rows_a_pose - step) < 1e-9:
        return _take_rows(recorded, step)
    return _resample(recorded, rate, np.random.default_rng(seed))


def _find_commands(flight: RealFlight, platform: Platform) -> Mat:
    """Return commands (n, 4) that the flight obeyed, as far as it is recorded.

        u_1 = k sum of F(duty vbat),   u_2..4 = w + RATE_LAG w'

    F is the platform's thrust curve. k carries the flight: the filter of a drone that hovers knows its thrust.
    The rates are the best case: those by which the model of the filter makes the recorded ones.
    """
    a, b = flight.airborne
    thrust = compute_motor_thrust(platform, flight.duty * flight.vbat[:, None]).sum(
        axis=1
    )
    gravity = np.array([0.0, 0.0, STANDARD_GRAVITY])
    force = smooth(flight.p, 2) + gravity
    axis = Rotation.from_quat(flight.q).apply([0.0, 0.0, 1.0])
    lift = platform.mass * (force * axis).sum(axis=1)
    known = np.flatnonzero(flight.is_known[a:b]) + a
    factor = (lift[known] @ thrust[known]) / (thrust[known] @ thrust[known])
    rates = smooth(flight.w, 0) + RATE_LAG * smooth(flight.w, 1)
    return np.column_stack([factor * thrust, rates])


def _take_rows(stream: PoseStream, step: int) -> PoseStream:
    """Return each step-th instant of a stream."""
    return PoseStream(
        stream.t[::step],
        stream.poses[::step],
        stream.commands[::step],
        stream.v[::step],
        stream.w[::step],
        stream.is_known[::step],
    )


def _resample(stream: PoseStream, rate: int, draw: np.random.Generator) -> PoseStream:
    """Return the smoothed stream at another rate, with the noise that smoothing has removed."""
    t = np.arange(stream.t[0], stream.t[-1], 1.0 / rate)
    p = stream.poses[:, :3]
    place = CubicSpline(stream.t, smooth(p, 0))
    place_noise = estimate_noise(p - place(stream.t))
    q = _join_signs(stream.poses[:, 3:])
    attitude = CubicSpline(stream.t, smooth(q, 0))
    turns = Rotation.from_quat(attitude(stream.t)).inv() * Rotation.from_quat(q)
    turn_noise = estimate_noise(turns.as_rotvec())
    poses = np.hstack(
        [
            place(t) + place_noise * draw.standard_normal((len(t), 3)),
            (
                Rotation.from_quat(attitude(t))
                * Rotation.from_rotvec(turn_noise * draw.standard_normal((len(t), 3)))
            ).as_quat(),
        ]
    )
    return PoseStream(
        t=t,
        poses=poses,
        commands=_interpolate(t, stream.t, stream.commands),
        v=place(t, 1),
        w=_interpolate(t, stream.t, stream.w),
        is_known=np.interp(t, stream.t, stream.is_known) == 1.0,
    )


def smooth(values: Mat, derivative: int) -> Mat:
    """Return a derivative of values (n, c) by the polynomials of the truth."""
    return np.asarray(
        savgol_filter(
            values,
            FLIGHT_RULES.smoothing_rows,
            POLYNOMIAL_DEGREE,
            deriv=derivative,
            delta=FLIGHT_TIME_STEP,
            axis=0,
        )
    )


def estimate_noise(residual: Mat) -> Vec:
    """Return the standard deviations (c,) of the white noise in values that were smoothed.

        var(residual) = (1 - h_0) var(noise)

    h_0: weight of a value in its own smoothed value
    residual: (n, c): what smoothing has taken away
    """
    middle = FLIGHT_RULES.smoothing_rows // 2
    own = savgol_coeffs(FLIGHT_RULES.smoothing_rows, POLYNOMIAL_DEGREE)[middle]
    return np.asarray(residual.std(axis=0) / np.sqrt(1.0 - own))


def _join_signs(q: Mat) -> Mat:
    """Return the quaternions (n, 4) without changes of sign from one to the next."""
    flips = np.sum(q[1:] * q[:-1], axis=1) < 0.0
    signs = np.where(np.cumsum(flips) % 2, -1.0, 1.0)
    return np.vstack([q[:1], q[1:] * signs[:, None]])


def _interpolate(t: Vec, known: Vec, columns: Mat) -> Mat:
    """Return the columns (n, c), known at some times, at the times t."""
    return np.column_stack([np.interp(t, known, column) for column in columns.T])
