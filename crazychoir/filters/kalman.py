"""A Kalman filter of the poses of motion capture that knows the commands of its drone."""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from crazychoir.filters.motion import (
    RATE_LAG,
    STANDING_TOLERANCE,
    CommandedMotion,
    advance_flight,
    is_standing,
)
from crazychoir.filters.velocity import POSE_TIMING, compute_lateness, is_readable
from crazychoir.numerics.kernels import kernel, memory, real, table, vector
from crazychoir.numerics.math3d import (
    Triple,
    clip,
    is_finite,
    normalize_quaternion,
    quaternion_conjugate,
    quaternion_product,
    rotation_exponential,
    rotation_logarithm,
)
from crazychoir.types import Mat, Pose, State, Vec


class KalmanGate(NamedTuple):
    """Which poses the filter refuses, and when it accepts them nevertheless."""

    chi_square: float = 25.0
    """Chi-square of 3 degrees of freedom: one good pose of 65 000 is beyond it."""
    place_slack: float = 0.002
    """Standard deviation in m that a manoeuvre adds, for the gate only."""
    angle_slack: float = 0.035
    """Standard deviation in rad that a manoeuvre adds, for the gate only."""
    doubts: int = 5
    """Poses in a row beyond the gate after which the filter is wrong, not the poses."""


KALMAN_GATE = KalmanGate()


class KalmanDeviations(NamedTuple):
    """Standard deviations of the state when the filter starts, and on the floor."""

    start_velocity: float = 1.0
    """m/s, standard deviation of the velocity when the filter starts."""
    start_disturbance: float = 5.0
    """m/s2, standard deviation of d when the filter starts."""
    start_turn_rate: float = 3.0
    """rad/s, standard deviation of the body rates when the filter starts."""
    floor_velocity: float = 0.01
    """m/s, standard deviation of the velocity on the floor."""
    floor_disturbance: float = 0.5
    """m/s2, standard deviation of d on the floor."""


KALMAN_DEVIATIONS = KalmanDeviations()


DISTURBANCE_FADE_TIME = 0.5  # s, in which d fades without measurements
COMMAND_HISTORY_SIZE = 512  # commands that are remembered: 2.1 s at 240 Hz


class RateLoopModel(NamedTuple):
    """How the known rate loop on board is integrated."""

    lag: float = 0.02
    """Lag in s that stands for the delays of command and measurement behind a known rate loop.
    """
    step: float = 0.0025
    """s, longest step of the integration of that loop."""
    command_timeout: float = 0.5
    """s without a command, after which that loop is at rest."""


RATE_LOOP_MODEL = RateLoopModel()


class KalmanMemory(NamedTuple):
    """Offsets of the filter's memory. It begins with x (13,) at the time of the last measurement."""

    disturbance: int = 13
    """Index of d (3,)."""
    place_covariance: int = 16
    """Index of the upper triangle of the covariance of (p, v, d)."""
    attitude_covariance: int = 22
    """Index of the upper triangle of the covariance of (a, w)."""
    call_time: int = 25
    """Index of the time in s of the last call."""
    newest_command: int = 26
    """Index of the row of the newest command."""
    loop_rate: int = 27
    """Index of r of the rate loop, (3,)."""
    loop_acceleration: int = 30
    """Index of r' of the rate loop, (3,)."""
    loop_integral: int = 33
    """Index of the integral of e of the rate loop, (3,)."""
    size: int = 36
    """Size of the memory."""


KALMAN_MEMORY = KalmanMemory()


class KalmanFigures(NamedTuple):
    """Offsets of the filter's figures."""

    place_variance: int = 0
    """Index of the variance of a place."""
    attitude_variance: int = 1
    """Index of the variance of an attitude."""
    jerk_density: int = 2
    """Index of the density of n_j."""
    push_density: int = 3
    """Index of the density of n_s."""
    swing_density: int = 4
    """Index of the density of n_g."""
    fading_rate: int = 5
    """Index of the rate in 1/s at which d fades."""
    knows_commands: int = 6
    """Index: 1 if the filter knows the commands."""
    floor_height: int = 7
    """Index of the height of the floor."""
    rate_lag: int = 8
    """Index of the lag of the rates behind the recorded ones."""
    knows_loop: int = 9
    """Index: 1 if the rate loop is known."""
    loop: int = 10
    """Index of the rows of the rate loop, (15,)."""
    platform: int = 25
    """Index of Platform.flat."""


KALMAN_FIGURES = KalmanFigures()


@dataclass(frozen=True, slots=True)
class KalmanNoise:
    """Deviations of the measured poses, and densities of the noises that drive the model."""

    place: float = 0.0005
    """m, standard deviation of a position per axis; 0.5 mm for good motion capture."""
    angle: float = math.radians(0.25)
    """rad, standard deviation of an attitude per axis; 0.25 deg for good motion capture."""
    jerk: float = 0.1
    """m2/s5, density of n_j: a thrust that is 10 % wrong for about 0.1 s while the jerk is 10 m/s3.

    Without commands d must follow the whole jerk: then use 0.1 for figure eights at 1 m/s, and 3 at
    2 m/s.
    """
    push: float = 3e-5
    """m2/s3, density of n_s: the error of f from an attitude that is wrong behind the filter.

    The default covers 2 mrad for about 0.03 s.
    """
    swing: float = 0.3
    """rad2/s3, density of n_g: a lag of the rates that is 10 ms wrong.

    The default covers it for about 0.03 s while the rates change by 20 rad/s2.
    """


KALMAN_NOISE = KalmanNoise()


@kernel()
def _advance_rate_loop(mem: Vec, loop: Vec, u: Vec, h: float) -> Triple:
    """Advance the rates of the loop by h s under u, and return their means, rad/s.

    It is Euler's method, with the lag backwards. Without thrust the firmware resets its loops, and
    the rotors run down.

    mem: the memory
    loop: (15,), rows of the loop
    u: (4,): command
    h: s
    """
    if h <= 0.0:  # a refused pose: this tick has already been recorded
        return (
            mem[KALMAN_MEMORY.loop_rate],
            mem[KALMAN_MEMORY.loop_rate + 1],
            mem[KALMAN_MEMORY.loop_rate + 2],
        )
    if not h < RATE_LOOP_MODEL.command_timeout:
        for c in range(3):
            mem[KALMAN_MEMORY.loop_rate + c] = u[1 + c]
            mem[KALMAN_MEMORY.loop_acceleration + c] = 0.0
            mem[KALMAN_MEMORY.loop_integral + c] = 0.0
        return (u[1], u[2], u[3])
    steps = math.ceil(h / RATE_LOOP_MODEL.step)
    step = h / steps
    mean = (0.0, 0.0, 0.0)
    for _ in range(steps):
        for c in range(3):
            lag = loop[5 * c]
            kp = loop[5 * c + 1]
            ki = loop[5 * c + 2]
            kd = loop[5 * c + 3]
            most = loop[5 * c + 4]
            error = u[1 + c] - mem[KALMAN_MEMORY.loop_rate + c]
            mem[KALMAN_MEMORY.loop_integral + c] = (
                mem[KALMAN_MEMORY.loop_integral + c] + step * error
                if u[0] > 0.0
                else 0.0
            )
            wanted = (
                clip(
                    kp * error
                    + ki * mem[KALMAN_MEMORY.loop_integral + c]
                    - kd * mem[KALMAN_MEMORY.loop_acceleration + c],
                    -most,
                    most,
                )
                if u[0] > 0.0
                else 0.0
            )
            mem[KALMAN_MEMORY.loop_acceleration + c] = (
                lag * mem[KALMAN_MEMORY.loop_acceleration + c] + step * wanted
            ) / (lag + step)
            mem[KALMAN_MEMORY.loop_rate + c] += (
                step * mem[KALMAN_MEMORY.loop_acceleration + c]
            )
        r = (
            mem[KALMAN_MEMORY.loop_rate],
            mem[KALMAN_MEMORY.loop_rate + 1],
            mem[KALMAN_MEMORY.loop_rate + 2],
        )
        mean = (mean[0] + r[0] / steps, mean[1] + r[1] / steps, mean[2] + r[2] / steps)
    return mean


@kernel()
def _record_command(mem: Vec, history: Mat, figures: Vec, u: Vec, now: float) -> None:
    """Record that the drone obeyed u from the last call until now.

    A new row of the history (since s, thrust N, rates rad/s) is written if u is new. For a known
    loop the rates are the response of the loop to the commands.

    mem: the memory
    history: (COMMAND_HISTORY_SIZE, 5)
    figures: the figures
    u: (4,): command
    now: s
    """
    if is_finite(u):
        rates = (u[1], u[2], u[3])
        if figures[KALMAN_FIGURES.knows_loop] > 0.0:
            rates = _advance_rate_loop(
                mem,
                figures[KALMAN_FIGURES.loop : KALMAN_FIGURES.platform],
                u,
                now - mem[KALMAN_MEMORY.call_time],
            )
        row = (u[0], rates[0], rates[1], rates[2])
        k = int(mem[KALMAN_MEMORY.newest_command])
        fresh = False
        for c in range(4):
            fresh = fresh or history[k, 1 + c] != row[c]
        if fresh:
            k = (k + 1) % history.shape[0]
            mem[KALMAN_MEMORY.newest_command], history[k, 0] = (
                k,
                mem[KALMAN_MEMORY.call_time],
            )
            for c in range(4):
                history[k, 1 + c] = row[c]
    mem[KALMAN_MEMORY.call_time] = now


@kernel()
def _move_state(x: Vec, d: Triple, u: Vec, figures: Vec, h: float) -> bool:
    """Advance x by h s under u and the acceleration d.

    Return whether it then stands on the floor.
    """
    if figures[KALMAN_FIGURES.knows_commands] > 0.0 and (
        u[0] > 0.0 or x[2] < figures[KALMAN_FIGURES.floor_height] + STANDING_TOLERANCE
    ):
        return bool(
            advance_flight(
                x,
                u,
                figures[KALMAN_FIGURES.platform :],
                figures[KALMAN_FIGURES.floor_height],
                figures[KALMAN_FIGURES.rate_lag],
                d,
                h,
            )
        )
    for c in range(3):
        x[c] += h * (x[3 + c] + 0.5 * h * d[c])
        x[3 + c] += h * d[c]
    x[6], x[7], x[8], x[9] = quaternion_product(
        (x[6], x[7], x[8], x[9]), rotation_exponential(h * x[10], h * x[11], h * x[12])
    )
    return False


@kernel()
def _advance_state(
    x: Vec,
    d: Triple,
    mem: Vec,
    history: Mat,
    figures: Vec,
    t: float,
    end: float,
    fade: float,
) -> Triple:
    """Advance x from the time t to `end` under the commands of that time; return d then.

    d fades with the rate `fade`, 1/s; each part of the time takes its mean.
    """
    newest = int(mem[KALMAN_MEMORY.newest_command])
    rows = history.shape[0]
    k = newest
    for _ in range(rows - 1):
        if history[k, 0] <= t:
            break
        k = (k - 1) % rows
    while t < end:
        after = (k + 1) % rows
        until = end if k == newest else min(end, history[after, 0])
        h = until - t
        if h > POSE_TIMING.rounding:
            keep = math.exp(-fade * h)
            mean = (1.0 - keep) / (fade * h) if fade > 0.0 else 1.0
            stands = _move_state(
                x, (mean * d[0], mean * d[1], mean * d[2]), history[k, 1:5], figures, h
            )
            d = (0.0, 0.0, 0.0) if stands else (keep * d[0], keep * d[1], keep * d[2])
        t = max(t, until)
        k = after
    return d


@kernel()
def _grow_covariances(
    mem: Vec, figures: Vec, h: float
) -> tuple[Triple, Triple, Triple]:
    """Return both covariances h s later.

    They are (pp, pv, pd), (vv, vd, dd) and, of the attitude, (aa, aw, ww).
    """
    pp = mem[KALMAN_MEMORY.place_covariance]
    pv = mem[KALMAN_MEMORY.place_covariance + 1]
    pd = mem[KALMAN_MEMORY.place_covariance + 2]
    vv = mem[KALMAN_MEMORY.place_covariance + 3]
    vd = mem[KALMAN_MEMORY.place_covariance + 4]
    dd = mem[KALMAN_MEMORY.place_covariance + 5]
    j = figures[KALMAN_FIGURES.jerk_density]
    s = figures[KALMAN_FIGURES.push_density]
    g = figures[KALMAN_FIGURES.swing_density]
    h2 = h * h
    h3 = h * h * h
    pp += (
        2.0 * h * pv
        + h2 * (vv + pd)
        + h3 * vd
        + 0.25 * h2 * h2 * dd
        + j * h2 * h3 / 20.0
        + s * h3 / 3.0
    )
    pv += (
        h * (vv + pd) + 1.5 * h2 * vd + 0.5 * h3 * dd + j * h2 * h2 / 8.0 + s * h2 / 2.0
    )
    pd += h * vd + 0.5 * h2 * dd + j * h3 / 6.0
    vv += 2.0 * h * vd + h2 * dd + j * h3 / 3.0 + s * h
    vd += h * dd + j * h2 / 2.0
    aa = (
        mem[KALMAN_MEMORY.attitude_covariance]
        + 2.0 * h * mem[KALMAN_MEMORY.attitude_covariance + 1]
        + h2 * mem[KALMAN_MEMORY.attitude_covariance + 2]
        + g * h3 / 3.0
    )
    aw = (
        mem[KALMAN_MEMORY.attitude_covariance + 1]
        + h * mem[KALMAN_MEMORY.attitude_covariance + 2]
        + g * h2 / 2.0
    )
    return (
        (pp, pv, pd),
        (vv, vd, dd + j * h),
        (aa, aw, mem[KALMAN_MEMORY.attitude_covariance + 2] + g * h),
    )


@kernel()
def _apply_joseph_form(
    p: float, p_1m: float, p_1n: float, k_m: float, k_n: float, s: float
) -> float:
    """Return element (m, n) of (I - K H) P (I - K H)^T + K r K^T where H = (1, 0, ..).

    p: that element of P
    p_1m: element (1, m) of P
    p_1n: element (1, n) of P
    k_m: element m of K
    k_n: element n of K
    s: P_11 + r
    """
    return p - k_m * p_1n - k_n * p_1m + k_m * k_n * s


@kernel()
def _correct_place(
    mem: Vec, x: Vec, d: Triple, e: Triple, first: Triple, second: Triple, r: float
) -> None:
    """Take in the innovation e of the position.

    x is changed in place; d and the covariance go into the memory.
    """
    (pp, pv, pd), (vv, vd, dd) = first, second
    s = pp + r
    kp = pp / s
    kv = pv / s
    kd = pd / s
    for c in range(3):
        x[c] += kp * e[c]
        x[3 + c] += kv * e[c]
        mem[KALMAN_MEMORY.disturbance + c] = d[c] + kd * e[c]
    mem[KALMAN_MEMORY.place_covariance] = _apply_joseph_form(pp, pp, pp, kp, kp, s)
    mem[KALMAN_MEMORY.place_covariance + 1] = _apply_joseph_form(pv, pp, pv, kp, kv, s)
    mem[KALMAN_MEMORY.place_covariance + 2] = _apply_joseph_form(pd, pp, pd, kp, kd, s)
    mem[KALMAN_MEMORY.place_covariance + 3] = _apply_joseph_form(vv, pv, pv, kv, kv, s)
    mem[KALMAN_MEMORY.place_covariance + 4] = _apply_joseph_form(vd, pv, pd, kv, kd, s)
    mem[KALMAN_MEMORY.place_covariance + 5] = _apply_joseph_form(dd, pd, pd, kd, kd, s)


@kernel()
def _set_at_rest(mem: Vec, x: Vec, r: float) -> None:
    """Set the state of a drone on the floor: no velocity, and an unknown error of the thrust."""
    for c in range(3):
        x[3 + c] = mem[KALMAN_MEMORY.disturbance + c] = 0.0
    mem[KALMAN_MEMORY.place_covariance] = min(mem[KALMAN_MEMORY.place_covariance], r)
    mem[KALMAN_MEMORY.place_covariance + 1] = 0.0
    mem[KALMAN_MEMORY.place_covariance + 2] = 0.0
    mem[KALMAN_MEMORY.place_covariance + 3] = KALMAN_DEVIATIONS.floor_velocity**2
    mem[KALMAN_MEMORY.place_covariance + 4] = 0.0
    mem[KALMAN_MEMORY.place_covariance + 5] = KALMAN_DEVIATIONS.floor_disturbance**2


@kernel()
def _correct_attitude(mem: Vec, x: Vec, e: Triple, grown: Triple, r: float) -> None:
    """Take in the innovation e of the attitude, rad, body.

    x is changed in place; the covariance goes into the memory.
    """
    aa, aw, ww = grown
    s = aa + r
    ka = aa / s
    kw = aw / s
    x[6], x[7], x[8], x[9] = normalize_quaternion(
        quaternion_product(
            (x[6], x[7], x[8], x[9]),
            rotation_exponential(ka * e[0], ka * e[1], ka * e[2]),
        )
    )
    for c in range(3):
        x[10 + c] += kw * e[c]
    mem[KALMAN_MEMORY.attitude_covariance] = _apply_joseph_form(aa, aa, aa, ka, ka, s)
    mem[KALMAN_MEMORY.attitude_covariance + 1] = _apply_joseph_form(
        aw, aa, aw, ka, kw, s
    )
    mem[KALMAN_MEMORY.attitude_covariance + 2] = _apply_joseph_form(
        ww, aw, aw, kw, kw, s
    )


@kernel()
def _is_beyond_gate(e: Triple, variance: float) -> bool:
    """Return whether an innovation with this variance per axis is beyond the gate.

    An innovation that is not finite is beyond it.
    """
    return not (
        e[0] * e[0] + e[1] * e[1] + e[2] * e[2] <= KALMAN_GATE.chi_square * variance
    )


@kernel()
def _compute_speed(x: Vec) -> float:
    """Return the speed in m/s."""
    return math.sqrt(x[3] * x[3] + x[4] * x[4] + x[5] * x[5])


@kernel(vector, memory, table, vector, vector, real, real, real, real, memory)
def _take_in_pose(
    pose: Vec,
    mem: Vec,
    history: Mat,
    figures: Vec,
    u: Vec,
    last: float,
    h: float,
    t: float,
    now: float,
    out: Vec,
) -> float:
    """Take in a pose of the time last + h, and return the speed in m/s.

    pose: (7,)
    mem: the memory
    history: (COMMAND_HISTORY_SIZE, 5)
    figures: the figures
    u: (4,): command
    last: s, time of the pose before
    h: s
    t: s
    now: s
    out: (13,): the state t s after the pose
    Returns -1 for a pose that is not readable, -2 for a pose beyond the gate; then only u is
    recorded.
    """
    _record_command(mem, history, figures, u, now)
    if not is_readable(pose):
        return -1.0
    out[:] = mem[0 : KALMAN_MEMORY.disturbance]
    d = _advance_state(
        out,
        (
            mem[KALMAN_MEMORY.disturbance],
            mem[KALMAN_MEMORY.disturbance + 1],
            mem[KALMAN_MEMORY.disturbance + 2],
        ),
        mem,
        history,
        figures,
        last,
        last + h,
        0.0,
    )
    first, second, attitude = _grow_covariances(mem, figures, h)
    e = (pose[0] - out[0], pose[1] - out[1], pose[2] - out[2])
    q = normalize_quaternion((pose[3], pose[4], pose[5], pose[6]))
    turn = rotation_logarithm(
        quaternion_product(quaternion_conjugate((out[6], out[7], out[8], out[9])), q)
    )
    if _is_beyond_gate(
        e,
        first[0] + figures[KALMAN_FIGURES.place_variance] + KALMAN_GATE.place_slack**2,
    ):
        return -2.0
    if _is_beyond_gate(
        turn,
        attitude[0]
        + figures[KALMAN_FIGURES.attitude_variance]
        + KALMAN_GATE.angle_slack**2,
    ):
        return -2.0
    _correct_place(
        mem, out, d, e, first, second, figures[KALMAN_FIGURES.place_variance]
    )
    if figures[KALMAN_FIGURES.knows_commands] > 0.0 and is_standing(
        out, u, figures[KALMAN_FIGURES.platform :], figures[KALMAN_FIGURES.floor_height]
    ):
        _set_at_rest(mem, out, figures[KALMAN_FIGURES.place_variance])
    _correct_attitude(
        mem, out, turn, attitude, figures[KALMAN_FIGURES.attitude_variance]
    )
    mem[0 : KALMAN_MEMORY.disturbance] = out
    d = (
        mem[KALMAN_MEMORY.disturbance],
        mem[KALMAN_MEMORY.disturbance + 1],
        mem[KALMAN_MEMORY.disturbance + 2],
    )
    _advance_state(
        out,
        d,
        mem,
        history,
        figures,
        last + h,
        last + h + t,
        figures[KALMAN_FIGURES.fading_rate],
    )
    return _compute_speed(out)


@kernel(vector, memory, table, vector, vector, real, real, real, real, memory)
def _predict_state(
    x: Vec,
    mem: Vec,
    history: Mat,
    figures: Vec,
    u: Vec,
    measured: float,
    t: float,
    end: float,
    now: float,
    out: Vec,
) -> float:
    """Carry x from the time t to `end`, and return the speed in m/s.

    x: (13,)
    mem: the memory
    history: (COMMAND_HISTORY_SIZE, 5)
    figures: the figures
    u: (4,): command
    measured: s, time of the memory
    t: s
    end: s
    now: s
    out: (13,): the result
    """
    _record_command(mem, history, figures, u, now)
    out[:] = x
    fade = figures[KALMAN_FIGURES.fading_rate]
    left = math.exp(fade * (measured - t))
    _advance_state(
        out,
        (
            left * mem[KALMAN_MEMORY.disturbance],
            left * mem[KALMAN_MEMORY.disturbance + 1],
            left * mem[KALMAN_MEMORY.disturbance + 2],
        ),
        mem,
        history,
        figures,
        t,
        end,
        fade,
    )
    return _compute_speed(out)


class KalmanFilter:
    """Kalman filter of position and velocity, and error-state filter of attitude and body rates.

    The poses may come at any rate.

        p' = v,  v' = f(q, u) + d + n_s,  d' = n_j,      z_p = p + n_p
        q' = 1/2 q (w, 0),  w' = (r - w) / lag + n_g,      z_q = q exp(n_a)

    f: the acceleration of the dynamics of CommandedMotion under the commands u
    d: the remaining acceleration, from a thrust that differs from the command and from wind
    n_s, n_j, n_g, n_p, n_a: white noises
    r: the commanded rates u_2..4, with lag = RATE_LAG

    Without a `motion`, or with motors off, f = 0, d is the whole acceleration, and w' = n_g.

    If the `loop` on board is known, r is the response of the loop to the commands alone, and
    lag = RATE_LOOP_MODEL.lag. One axis of the loop, which runs down while no thrust is commanded:

        lag_r r'' + r' = sat(kp e + ki (integral of e) - kd r'),  e = u_2..4 - r,  |sat| <= most

    Each noise is equal in all axes. So x, y and z share one covariance of (p, v, d), and the three
    angles of the error a, q = q_est exp(a), share one covariance of (a, w). Both are discretised
    exactly for the measured time h between two poses:

        F = [1 h h^2/2; 0 1 h; 0 0 1]
        Q = jerk [h^5/20 h^4/8 h^3/6; h^4/8 h^3/3 h^2/2; h^3/6 h^2/2 h]
            + push [h^3/3 h^2/2 0; h^2/2 h 0; 0 0 0]
        F_a = [1 h; 0 1],  Q_a = swing [h^3/3 h^2/2; h^2/2 h]

    F_a omits the lag of the rates, which is not known well enough. The update has Joseph's form;
    only its upper triangle is kept.

    A pose is refused, and counts as missing, if it is not finite, if the length of its quaternion is
    outside 0.5 to 2, or if it is beyond the gate: |e|^2 / variance of its innovation e exceeds
    KALMAN_GATE.chi_square in position or attitude. After KALMAN_GATE.doubts poses in a row beyond the
    gate the filter accepts the newest: it starts again there, with the velocities that it had. After
    a gap longer than the horizon it starts again with the mean velocity of the gap.

    While the thrust does not lift a drone from the floor, its velocity and d are zero.

    The state is extrapolated from the time of the measurement to `now` under the commands of that
    time, which are recorded: `commanded` is valid from one call to the next. Without poses the
    extrapolation goes on, and d decays with the time constant DISTURBANCE_FADE_TIME. The times follow
    the period of the cameras as in VelocityFilter, and the attributes are the same.

    horizon: s, longest prediction
    period: s, of the cameras; 0 if they have no steady rate
    motion: the dynamics under commands; None if the filter gets no commands
    noise: n_p, n_a, n_j = jerk, n_s = push and n_g = swing
    loop: (3, 5): lag_r s, kp 1/s, ki 1/s2, kd, most rad/s2 of roll, pitch, yaw; None if not known
    Source: Bar-Shalom, Li & Kirubarajan 2001, the Wiener process acceleration model, for Q;
        Lefferts, Markley & Shuster 1982 for the error state.
    """

    def __init__(
        self,
        horizon: float = 0.5,
        period: float = 0.0,
        motion: CommandedMotion | None = None,
        noise: KalmanNoise = KALMAN_NOISE,
        loop: Mat | None = None,
    ) -> None:
        self.horizon = horizon
        self.period = period
        self.cutoff = math.inf
        self.commanded: Vec = np.zeros(4)
        self.refused = 0
        self.speed = 0.0
        self.measured = -math.inf
        known = None if motion is None or loop is None else loop.ravel()
        rates = (
            (RATE_LAG, 0.0, *np.zeros(15))
            if known is None
            else (RATE_LOOP_MODEL.lag, 1.0, *known)
        )
        model = (
            (0.0, 0.0, *rates, *np.zeros(9))
            if motion is None
            else (1.0, motion.floor, *rates, *motion.platform)
        )
        self._figures = np.array(
            [
                noise.place**2,
                noise.angle**2,
                noise.jerk,
                noise.push,
                noise.swing,
                1.0 / DISTURBANCE_FADE_TIME,
                *model,
            ]
        )
        self._memory = np.zeros(KALMAN_MEMORY.size)
        self._history = np.zeros((COMMAND_HISTORY_SIZE, 5))
        self._memory[KALMAN_MEMORY.call_time] = -math.inf
        self._history[:, 0] = -math.inf
        self._doubted = 0
        self._state: State | None = None

    def update(self, pose: Pose, now: float) -> State | None:
        """Return the state at `now` with a new pose; None only before the first valid pose."""
        age = pose.age
        horizon = self.horizon
        last = self.measured
        h = now - age - last
        if h <= 1e-6:  # a repeated or an older pose says nothing new
            return self.predict(now)
        if h > horizon:  # the first one too: h is infinite
            return self._begin(pose, now, h)
        if self.period > 0.0:  # the rate of the cameras tells it better than a clock
            late = compute_lateness(h, self.period)
            age = age + late
            h = h - late
            if h < POSE_TIMING.least_period_share * self.period:
                last = now - age - self.period
                h = self.period
        out = np.empty(13)
        t = age if age < horizon else horizon
        speed = _take_in_pose(
            pose.flat,
            self._memory,
            self._history,
            self._figures,
            self.commanded,
            last,
            h,
            t,
            now,
            out,
        )
        if speed < 0.0:
            return self._refuse(pose, now, doubtful=speed < -1.5)
        out.setflags(False)  # type: ignore[call-arg]  # faster by position than by name, in each tick
        self.speed = speed
        self.measured = now - age
        self._doubted = 0
        self._state = state = State(out, age)
        return state

    def predict(self, now: float) -> State | None:
        """Return the state at `now` without a new pose, by the commands; None before the first."""
        last = self._state
        if last is None:
            return None
        measured = self.measured
        horizon = self.horizon
        age = now - measured
        t = measured + min(last.age, horizon)
        end = measured + min(age, horizon)
        out = np.empty(13)
        self.speed = _predict_state(
            last.flat,
            self._memory,
            self._history,
            self._figures,
            self.commanded,
            measured,
            t,
            end,
            now,
            out,
        )
        out.setflags(False)  # type: ignore[call-arg]
        self._state = state = State(out, age)
        return state

    def _refuse(self, pose: Pose, now: float, doubtful: bool) -> State | None:
        """Count a pose as missing, or start again from it if too many in a row were doubtful."""
        self._doubted += doubtful
        if doubtful and self._doubted >= KALMAN_GATE.doubts:
            return self._start(
                pose, now, self._memory[3:6].copy(), self._memory[10:13].copy()
            )
        self.refused += 1
        return self.predict(now)

    def _begin(self, pose: Pose, now: float, h: float) -> State | None:
        """Start after a gap of h s, without body rates."""
        if not is_readable(pose.flat):
            self.refused += 1
            return self.predict(now)
        return self._start(pose, now, (pose.p - self._memory[0:3]) / h, np.zeros(3))

    def _start(self, pose: Pose, now: float, v: Vec, w: Vec) -> State | None:
        """Start from a readable pose, with estimated velocities.

        pose: taken as exact
        now: s
        v: (3,) m/s
        w: (3,) rad/s
        """
        memory, (r_p, r_angle) = self._memory, self._figures[:2]
        memory[0:3] = pose.p
        memory[3:6] = v
        memory[6:10] = normalize_quaternion(tuple(pose.q))
        memory[10:13] = w
        memory[KALMAN_MEMORY.disturbance : KALMAN_MEMORY.place_covariance] = 0.0
        memory[KALMAN_MEMORY.place_covariance : KALMAN_MEMORY.attitude_covariance] = (
            r_p,
            0.0,
            0.0,
            KALMAN_DEVIATIONS.start_velocity**2,
            0.0,
            KALMAN_DEVIATIONS.start_disturbance**2,
        )
        memory[KALMAN_MEMORY.attitude_covariance : KALMAN_MEMORY.call_time] = (
            r_angle,
            0.0,
            KALMAN_DEVIATIONS.start_turn_rate**2,
        )
        self.measured = now - pose.age
        self._doubted = 0
        self._state = State(memory[: KALMAN_MEMORY.disturbance].copy())
        return self.predict(now)
