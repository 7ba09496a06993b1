"""The law of KalmanFilter, on the record of one drone."""

import math
from typing import NamedTuple

from crazychoir.filters.command_history import advance_state, record_command
from crazychoir.filters.motion import compute_speed, is_standing
from crazychoir.filters.place_noise import measure_place_noise
from crazychoir.filters.poses import POSE_TIMING, is_readable, time_pose
from crazychoir.filters.rows import FilterRow
from crazychoir.numerics.kernels import kernel
from crazychoir.numerics.math3d import (
    Triple,
    normalize_quaternion,
    quaternion_conjugate,
    quaternion_product,
    rotation_exponential,
    rotation_logarithm,
)
from crazychoir.types import Mat, Vec


class KalmanGate(NamedTuple):
    """Which poses the filter refuses, and when it accepts them nevertheless."""

    chi_square: float = 25.0
    """Chi-square of 3 degrees of freedom: one good pose of 65 000 is beyond it."""
    place_slack: float = 0.002
    """Standard deviation in m that a manoeuvre adds, for the gate only."""
    jerk_slack: float = 10.0
    """Standard deviation in m/s3 of a jerk that lasts from pose to pose, for the gate only.

    After a gap the drone is where its manoeuvre has carried it: 13 mm off in 0.2 s.
    """
    angle_slack: float = 0.035
    """Standard deviation in rad that a manoeuvre adds, for the gate only."""
    spin_slack: float = 5.0
    """Standard deviation in rad/s2 of an angular acceleration from pose to pose, for the gate only."""
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
DISTURBANCE_FADE_RATE = 1.0 / DISTURBANCE_FADE_TIME  # 1/s


@kernel()
def _grow_covariances(row: FilterRow, h: float) -> tuple[Triple, Triple, Triple]:
    """Return both covariances h s later.

    They are (pp, pv, pd), (vv, vd, dd) and, of the attitude, (aa, aw, ww).
    """
    pp = row.place_covariance[0]
    pv = row.place_covariance[1]
    pd = row.place_covariance[2]
    vv = row.place_covariance[3]
    vd = row.place_covariance[4]
    dd = row.place_covariance[5]
    j = row.jerk_density
    s = row.push_density
    g = row.swing_density
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
        row.attitude_covariance[0]
        + 2.0 * h * row.attitude_covariance[1]
        + h2 * row.attitude_covariance[2]
        + g * h3 / 3.0
    )
    aw = row.attitude_covariance[1] + h * row.attitude_covariance[2] + g * h2 / 2.0
    return (
        (pp, pv, pd),
        (vv, vd, dd + j * h),
        (aa, aw, row.attitude_covariance[2] + g * h),
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
    row: FilterRow, x: Vec, d: Triple, e: Triple, first: Triple, second: Triple
) -> None:
    """Take in the innovation e of the position.

    x is changed in place; d and the covariance go into the record.
    """
    pp, pv, pd = first
    vv, vd, dd = second
    s = pp + row.place_variance
    kp = pp / s
    kv = pv / s
    kd = pd / s
    for c in range(3):
        x[c] += kp * e[c]
        x[3 + c] += kv * e[c]
        row.disturbance[c] = d[c] + kd * e[c]
    row.place_covariance[0] = _apply_joseph_form(pp, pp, pp, kp, kp, s)
    row.place_covariance[1] = _apply_joseph_form(pv, pp, pv, kp, kv, s)
    row.place_covariance[2] = _apply_joseph_form(pd, pp, pd, kp, kd, s)
    row.place_covariance[3] = _apply_joseph_form(vv, pv, pv, kv, kv, s)
    row.place_covariance[4] = _apply_joseph_form(vd, pv, pd, kv, kd, s)
    row.place_covariance[5] = _apply_joseph_form(dd, pd, pd, kd, kd, s)


@kernel()
def _set_at_rest(row: FilterRow, x: Vec) -> None:
    """Set the state of a drone on the floor: no velocity, and an unknown error of the thrust."""
    for c in range(3):
        x[3 + c] = 0.0
        row.disturbance[c] = 0.0
    row.place_covariance[0] = min(row.place_covariance[0], row.place_variance)
    row.place_covariance[1] = 0.0
    row.place_covariance[2] = 0.0
    row.place_covariance[3] = KALMAN_DEVIATIONS.floor_velocity**2
    row.place_covariance[4] = 0.0
    row.place_covariance[5] = KALMAN_DEVIATIONS.floor_disturbance**2


@kernel()
def _correct_attitude(row: FilterRow, x: Vec, e: Triple, grown: Triple) -> None:
    """Take in the innovation e of the attitude, rad, body.

    x is changed in place; the covariance goes into the record.
    """
    aa, aw, ww = grown
    s = aa + row.attitude_variance
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
    row.attitude_covariance[0] = _apply_joseph_form(aa, aa, aa, ka, ka, s)
    row.attitude_covariance[1] = _apply_joseph_form(aw, aa, aw, ka, kw, s)
    row.attitude_covariance[2] = _apply_joseph_form(ww, aw, aw, kw, kw, s)


@kernel()
def _is_beyond_gate(e: Triple, variance: float) -> bool:
    """Return whether an innovation with this variance per axis is beyond the gate.

    An innovation that is not finite is beyond it.
    """
    return not (
        e[0] * e[0] + e[1] * e[1] + e[2] * e[2] <= KALMAN_GATE.chi_square * variance
    )


@kernel()
def _compute_place_slack(h: float) -> float:
    """Return the variance in m2 that a manoeuvre of h s adds for the gate."""
    jerk_slack = KALMAN_GATE.jerk_slack * h * h * h / 6.0
    return KALMAN_GATE.place_slack**2 + jerk_slack * jerk_slack


@kernel()
def _compute_angle_slack(h: float) -> float:
    """Return the variance in rad2 that a manoeuvre of h s adds for the gate."""
    spin_slack = KALMAN_GATE.spin_slack * h * h / 2.0
    return KALMAN_GATE.angle_slack**2 + spin_slack * spin_slack


@kernel()
def _correct_state(row: FilterRow, history: Mat, x: Vec, last: float, h: float) -> bool:
    """Correct the state at the last measurement by the pose, and return whether the pose is inside the gate.

    Outside the gate nothing changes.

    row: record of the filter
    history: (R, 5)
    x: (13,), scratch
    last: s, time of the measurement before
    h: s, from it to the pose
    """
    pose = row.pose[:]
    x[:] = row.measured_state[:]
    before = (row.disturbance[0], row.disturbance[1], row.disturbance[2])
    d = advance_state(row, history, x, before, last, last + h, 0.0)
    first, second, attitude = _grow_covariances(row, h)
    e = (pose[0] - x[0], pose[1] - x[1], pose[2] - x[2])
    q = normalize_quaternion((pose[3], pose[4], pose[5], pose[6]))
    turn = rotation_logarithm(
        quaternion_product(quaternion_conjugate((x[6], x[7], x[8], x[9])), q)
    )
    place_variance = first[0] + row.place_variance + _compute_place_slack(h)
    angle_variance = attitude[0] + row.attitude_variance + _compute_angle_slack(h)
    if _is_beyond_gate(e, place_variance) or _is_beyond_gate(turn, angle_variance):
        return False
    if row.measures_noise > 0:
        measure_place_noise(row, h)
    _correct_place(row, x, d, e, first, second)
    if row.knows_commands > 0 and is_standing(
        x, row.command[:], row.platform[:], row.floor_height
    ):
        _set_at_rest(row, x)
    _correct_attitude(row, x, turn, attitude)
    row.measured_state[:] = x
    return True


@kernel()
def _start(row: FilterRow, v: Triple, w: Triple, now: float) -> None:
    """Start from the pose, which is readable and taken as exact, with estimated velocities.

    row: record of the filter
    v: m/s
    w: rad/s
    now: s
    """
    pose = row.pose[:]
    x = row.measured_state[:]
    for c in range(3):
        x[c] = pose[c]
        x[3 + c] = v[c]
        x[10 + c] = w[c]
        row.disturbance[c] = 0.0
    x[6], x[7], x[8], x[9] = normalize_quaternion((pose[3], pose[4], pose[5], pose[6]))
    row.place_covariance[:] = 0.0
    row.place_covariance[0] = row.place_variance
    row.place_covariance[3] = KALMAN_DEVIATIONS.start_velocity**2
    row.place_covariance[5] = KALMAN_DEVIATIONS.start_disturbance**2
    row.attitude_covariance[0] = row.attitude_variance
    row.attitude_covariance[1] = 0.0
    row.attitude_covariance[2] = KALMAN_DEVIATIONS.start_turn_rate**2
    row.measured = now - row.pose_age
    row.even_poses = 0
    row.doubts = 0
    row.state[:] = x
    row.age = 0.0
    row.is_known = 1


@kernel()
def _start_after_gap(row: FilterRow, h: float, now: float) -> None:
    """Start with the mean velocity of a gap of h s, without body rates.

    Before the first pose the gap is infinite, and the velocity zero.
    """
    pose = row.pose[:]
    x = row.measured_state[:]
    v = ((pose[0] - x[0]) / h, (pose[1] - x[1]) / h, (pose[2] - x[2]) / h)
    _start(row, v, (0.0, 0.0, 0.0), now)


@kernel()
def _start_where_poses_stay(row: FilterRow, now: float) -> None:
    """Start at the pose with the velocities of the last accepted pose."""
    x = row.measured_state[:]
    _start(row, (x[3], x[4], x[5]), (x[10], x[11], x[12]), now)


@kernel()
def _take_in_pose(row: FilterRow, history: Mat, scratch: Vec, now: float) -> bool:
    """Take in the new pose, and return whether the state of the record is then that of `now`.

    Otherwise the state is older and is to be predicted, as without a new pose.

    row: record of the filter
    history: (R, 5)
    scratch: (13,)
    now: s
    """
    if not math.isfinite(row.pose_age):
        row.refused += 1
        return False
    h = now - row.pose_age - row.measured
    if h <= POSE_TIMING.same_pose_time:  # a repeated or an older pose says nothing new
        return False
    if h > row.horizon:  # the first one too: h is infinite
        if is_readable(row.pose[:]):
            _start_after_gap(row, h, now)
        else:
            row.refused += 1
        return False
    age, h, is_together = time_pose(row.pose_age, h, row.period)
    last = now - age - h if is_together else row.measured
    record_command(row, history, now)
    if not is_readable(row.pose[:]):
        row.refused += 1
        return False
    if not _correct_state(row, history, scratch, last, h):
        row.doubts += 1
        if row.doubts >= KALMAN_GATE.doubts:
            _start_where_poses_stay(row, now)
        else:
            row.refused += 1
        return False
    row.measured = now - age
    row.doubts = 0
    row.age = age
    row.state[:] = row.measured_state[:]
    d = (row.disturbance[0], row.disturbance[1], row.disturbance[2])
    seen = last + h
    ahead = min(age, row.horizon)
    advance_state(
        row, history, row.state[:], d, seen, seen + ahead, DISTURBANCE_FADE_RATE
    )
    row.speed = compute_speed(row.state[:])
    return True


@kernel()
def _predict_state(row: FilterRow, history: Mat, now: float) -> None:
    """Advance the state of the record to `now` s, at most to the horizon."""
    record_command(row, history, now)
    age = now - row.measured
    t = row.measured + min(row.age, row.horizon)
    end = row.measured + min(age, row.horizon)
    left = math.exp(DISTURBANCE_FADE_RATE * (row.measured - t))
    d = (
        left * row.disturbance[0],
        left * row.disturbance[1],
        left * row.disturbance[2],
    )
    advance_state(row, history, row.state[:], d, t, end, DISTURBANCE_FADE_RATE)
    row.age = age
    row.speed = compute_speed(row.state[:])


@kernel()
def estimate_kalman_row(row: FilterRow, history: Mat, scratch: Vec, now: float) -> None:
    """Bring the state of a record to `now` by the law of KalmanFilter, with a new pose or without.

    row: record of the filter
    history: (R, 5)
    scratch: (13,)
    now: s
    """
    is_done = row.has_pose > 0 and _take_in_pose(row, history, scratch, now)
    if not is_done and row.is_known > 0:
        _predict_state(row, history, now)
