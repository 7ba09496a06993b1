"""The state estimator on board: integrated gyroscope and accelerometer, corrected by poses.

Chosen in place of the firmware's Kalman filter with 9 states: four independent filters with scalar
updates and the firmware's noise figures. Two have the position and velocity along x or y, and the
tilt that accelerates the drone along that axis. They are alike, so they share their covariance. One
has the height and the climb, one the yaw.
"""

import math
from typing import NamedTuple

from crazychoir.numerics.kernels import flags, kernel, matrix, real, vector, wholes
from crazychoir.numerics.math3d import (
    is_finite,
    normalize_quaternion,
    quaternion_conjugate,
    quaternion_product,
    rotation_columns,
    rotation_exponential,
    rotation_logarithm,
)
from crazychoir.simulation.onboard.record import (
    ESTIMATOR_KINDS,
    Fleet,
    Record,
    rows,
    whole,
)
from crazychoir.simulation.onboard.units import FIRMWARE_GRAVITY
from crazychoir.types import Bools, Ints, Mat, Vec


class InitialDeviations(NamedTuple):
    """Standard deviations of the initial state."""

    horizontal_position: float = 100.0
    """m, for x and y."""
    height: float = 1.0
    """m."""
    velocity: float = 0.01
    """m/s, on each axis."""
    attitude: float = 0.01
    """rad."""


INITIAL_DEVIATIONS = InitialDeviations()


TICK_SECONDS = 1e-3  # s


@kernel()
def _clear_sums(fw: Record) -> None:
    fw.p_sum = fw.q_sum = fw.r_sum = fw.fx_sum = fw.fy_sum = fw.fz_sum = 0.0
    fw.samples = 0


@kernel()
def _update_angles(fw: Record) -> None:
    """Compute roll, pitch, yaw in deg from the quaternion.

    The pitch is positive nose up, as the firmware logs it.
    """
    x = fw.qx
    y = fw.qy
    z = fw.qz
    w = fw.qw
    fw.roll = math.degrees(
        math.atan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y))
    )
    fw.pitch = -math.degrees(math.asin(min(max(2.0 * (w * y - x * z), -1.0), 1.0)))
    fw.yaw = math.degrees(
        math.atan2(2.0 * (x * y + z * w), 1.0 - 2.0 * (y * y + z * z))
    )


@kernel()
def start_estimate(fw: Record) -> None:
    """Start at the initial position and heading, at rest and level, with the initial uncertainty."""
    fw.x = fw.initial_x
    fw.y = fw.initial_y
    fw.z = fw.initial_z
    fw.vx = fw.vy = fw.vz = 0.0
    fw.qx = fw.qy = 0.0
    fw.qz = math.sin(0.5 * fw.initial_yaw)
    fw.qw = math.cos(0.5 * fw.initial_yaw)
    fw.xy_pp = INITIAL_DEVIATIONS.horizontal_position**2
    fw.xy_pv = fw.xy_pt = fw.xy_vt = 0.0
    fw.xy_vv = INITIAL_DEVIATIONS.velocity**2
    fw.xy_tt = INITIAL_DEVIATIONS.attitude**2
    fw.z_pp = INITIAL_DEVIATIONS.height**2
    fw.z_pv = 0.0
    fw.z_vv = INITIAL_DEVIATIONS.velocity**2
    fw.yaw_var = INITIAL_DEVIATIONS.attitude**2
    _clear_sums(fw)
    _update_angles(fw)


@kernel()
def collect_samples(fw: Record) -> None:
    """Add the filtered sensors of this ms to the sums for the next prediction."""
    fw.p_sum += fw.gx
    fw.q_sum += fw.gy
    fw.r_sum += fw.gz
    fw.fx_sum += fw.ax
    fw.fy_sum += fw.ay
    fw.fz_sum += fw.az
    fw.samples += 1


@kernel()
def _compute_process_noise(deviation: float, step: float, samples: int) -> float:
    """Return the variance of the noise of some samples, added each ms as in estimator_kalman.c.

    deviation: standard deviation a second
    step: standard deviation a sample
    samples: number of samples
    """
    return samples * (deviation * TICK_SECONDS + step) ** 2


@kernel()
def _compute_position_noise(fw: Record) -> float:
    """Return the variance of the noise that is added to each axis of the position.

    The noise of the acceleration is left out: it is below 1e-12 m2 a ms.
    """
    return _compute_process_noise(fw.noise_velocity, fw.noise_position, fw.samples)


@kernel()
def _grow_horizontal_covariance(fw: Record, dt: float, lift: float) -> None:
    """Predict the covariance of position, velocity and tilt along x or y.

        p <- p + dt v + 1/2 F dt^2 t,   v <- v + F dt t,   t <- t

    lift: F, m/s2: specific force upwards, which a tilt t rad turns
    """
    a = 0.5 * lift * dt * dt
    b = lift * dt
    pv = fw.xy_pv
    vv = fw.xy_vv
    pt = fw.xy_pt
    vt = fw.xy_vt
    tt = fw.xy_tt
    fw.xy_pp += (
        2.0 * dt * pv + dt * dt * vv + 2.0 * a * pt + 2.0 * a * dt * vt + a * a * tt
    ) + _compute_position_noise(fw)
    fw.xy_pv = pv + dt * vv + b * pt + (a + b * dt) * vt + a * b * tt
    fw.xy_pt = pt + dt * vt + a * tt
    fw.xy_vv = (
        vv
        + 2.0 * b * vt
        + b * b * tt
        + _compute_process_noise(fw.noise_xy, fw.noise_velocity, fw.samples)
    )
    fw.xy_vt = vt + b * tt
    fw.xy_tt = tt + _compute_process_noise(fw.noise_gyro, fw.noise_attitude, fw.samples)


@kernel()
def _turn_estimate(fw: Record, x: float, y: float, z: float) -> None:
    """Turn the estimated attitude by a small rotation vector, rad, world."""
    turned = quaternion_product(
        rotation_exponential(x, y, z), (fw.qx, fw.qy, fw.qz, fw.qw)
    )
    fw.qx, fw.qy, fw.qz, fw.qw = normalize_quaternion(turned)


@kernel()
def _is_lost(fw: Record) -> bool:
    """Return True if the estimate is out of bounds or not finite."""
    p = max(abs(fw.x), max(abs(fw.y), abs(fw.z)))
    v = max(abs(fw.vx), max(abs(fw.vy), abs(fw.vz)))
    known = math.isfinite(fw.x + fw.y + fw.z + fw.vx + fw.vy + fw.vz + fw.qw)
    return not (known and p <= fw.max_pos and v <= fw.max_vel)


@kernel()
def predict(fw: Record) -> None:
    """Predict the state from the sums since the last prediction or correction.

        q <- q exp(w dt),  a = R f - g e3,  p <- p + v dt + a dt^2 / 2,  v <- v + a dt
        P <- A P A^T + Q,  dt = k 1 ms
        along x, y: states (p, v, t), A = [1 dt F dt^2/2; 0 1 F dt; 0 0 1]
        along z:    states (p, v), A = [1 dt; 0 1]
        Q: k (n 1 ms + n_v)^2 for v, k (n_gyro 1 ms + n_t)^2 for the tilt t and the yaw,
           k (n_v 1 ms + n_p)^2 for p

    f: m/s2, body: specific force, turned by the attitude at the middle of the interval
    n: m/s2: noise of the acceleration
    n_p, n_v, n_t: m, m/s, rad: noise a ms, kalman.pNPos, pNVel and pNAtt
    F: m/s2: vertical part of R f
    k: number of samples; the firmware adds its noise each ms (estimator_kalman.c)
    In flight the rotors push along the body's z axis only, so only the z component of f is used:
    the accelerometer's bias across would count as much as drag.
    """
    if fw.samples == 0:
        return
    dt = fw.samples * TICK_SECONDS
    to_rate = math.radians(1.0) * TICK_SECONDS
    to_force = FIRMWARE_GRAVITY / fw.samples
    half = rotation_exponential(
        0.5 * fw.p_sum * to_rate, 0.5 * fw.q_sum * to_rate, 0.5 * fw.r_sum * to_rate
    )
    middle = quaternion_product((fw.qx, fw.qy, fw.qz, fw.qw), half)
    x, y, z = rotation_columns(middle)
    across = 0.0 if fw.flying else to_force
    fx = fw.fx_sum * across
    fy = fw.fy_sum * across
    fz = fw.fz_sum * to_force
    fw.qx, fw.qy, fw.qz, fw.qw = normalize_quaternion(quaternion_product(middle, half))
    fw.acx = x[0] * fx + y[0] * fy + z[0] * fz
    fw.acy = x[1] * fx + y[1] * fy + z[1] * fz
    fw.acz = x[2] * fx + y[2] * fy + z[2] * fz - FIRMWARE_GRAVITY
    fw.x += dt * (fw.vx + 0.5 * dt * fw.acx)
    fw.y += dt * (fw.vy + 0.5 * dt * fw.acy)
    fw.z += dt * (fw.vz + 0.5 * dt * fw.acz)
    fw.vx += dt * fw.acx
    fw.vy += dt * fw.acy
    fw.vz += dt * fw.acz
    _grow_horizontal_covariance(fw, dt, fw.acz + FIRMWARE_GRAVITY)
    fw.z_pp += dt * (2.0 * fw.z_pv + dt * fw.z_vv) + _compute_position_noise(fw)
    fw.z_pv += dt * fw.z_vv
    fw.z_vv += _compute_process_noise(fw.noise_z, fw.noise_velocity, fw.samples)
    fw.yaw_var += _compute_process_noise(
        fw.noise_gyro_yaw, fw.noise_attitude, fw.samples
    )
    _clear_sums(fw)
    _update_angles(fw)
    if _is_lost(fw):
        start_estimate(fw)
        fw.resets += 1


@kernel()
def _correct_position(fw: Record, x: float, y: float, z: float) -> None:
    r = fw.ext_pos_std**2
    k = fw.xy_pp / (fw.xy_pp + r)
    kv = fw.xy_pv / (fw.xy_pp + r)
    kt = fw.xy_pt / (fw.xy_pp + r)
    dx = x - fw.x
    dy = y - fw.y
    fw.x = fw.x + k * dx
    fw.y = fw.y + k * dy
    fw.vx = fw.vx + kv * dx
    fw.vy = fw.vy + kv * dy
    _turn_estimate(fw, -kt * dy, kt * dx, 0.0)
    fw.xy_vv = fw.xy_vv - kv * fw.xy_pv
    fw.xy_vt = fw.xy_vt - kv * fw.xy_pt
    fw.xy_tt = fw.xy_tt - kt * fw.xy_pt
    fw.xy_pv = (1.0 - k) * fw.xy_pv
    fw.xy_pt = (1.0 - k) * fw.xy_pt
    fw.xy_pp = (1.0 - k) * fw.xy_pp
    k = fw.z_pp / (fw.z_pp + r)
    kv = fw.z_pv / (fw.z_pp + r)
    dz = z - fw.z
    fw.z = fw.z + k * dz
    fw.vz = fw.vz + kv * dz
    fw.z_vv = fw.z_vv - kv * fw.z_pv
    fw.z_pv = (1.0 - k) * fw.z_pv
    fw.z_pp = (1.0 - k) * fw.z_pp


@kernel()
def _correct_attitude(fw: Record, q: tuple[float, float, float, float]) -> None:
    own = (fw.qx, fw.qy, fw.qz, fw.qw)
    e = rotation_logarithm(quaternion_product(q, quaternion_conjugate(own)))
    r = fw.ext_quat_std**2
    k = fw.xy_tt / (fw.xy_tt + r)
    kp = fw.xy_pt / (fw.xy_tt + r)
    kv = fw.xy_vt / (fw.xy_tt + r)
    k_yaw = fw.yaw_var / (fw.yaw_var + r)
    _turn_estimate(fw, k * e[0], k * e[1], k_yaw * e[2])
    fw.x += kp * e[1]
    fw.y -= kp * e[0]
    fw.vx += kv * e[1]
    fw.vy -= kv * e[0]
    fw.xy_pp -= kp * fw.xy_pt
    fw.xy_pv -= kp * fw.xy_vt
    fw.xy_vv -= kv * fw.xy_vt
    fw.xy_pt *= 1.0 - k
    fw.xy_vt *= 1.0 - k
    fw.xy_tt *= 1.0 - k
    fw.yaw_var *= 1.0 - k_yaw


@kernel(rows, whole)
def reset(fleet: Fleet, i: int) -> None:
    """Start the estimate anew; another estimator than the Kalman filter is not touched."""
    fw = fleet[i]
    if fw.estimator == ESTIMATOR_KINDS.kalman:
        start_estimate(fw)


@kernel(rows, whole, vector)
def see_position(fleet: Fleet, i: int, p: Vec) -> None:
    """Correct by a position (3,) m; a position that is not finite is ignored."""
    fw = fleet[i]
    if fw.estimator == ESTIMATOR_KINDS.kalman and is_finite(p):
        predict(fw)
        _correct_position(fw, p[0], p[1], p[2])
        _update_angles(fw)


@kernel(rows, whole, vector, vector)
def see_pose(fleet: Fleet, i: int, p: Vec, q: Vec) -> None:
    """Correct by a pose: p (3,) m, q (4,).

        s <- s + P H^T (H P H^T + R)^-1 (seen - H s),  P <- P - P H^T (H P H^T + R)^-1 H P

    s: position, velocity and tilt of an axis; H takes the position first, then the tilt
    seen: position of the pose; tilt and yaw by the rotation vector log(q_ext q^-1), world
    R, R_att: squares of locSrv.extPosStdDev and locSrv.extQuatStdDev
    The sensors' sums are used first, so that the estimate belongs to the time of the pose. A pose
    that is not finite, or with a quaternion far from unit length, is ignored.
    """
    fw = fleet[i]
    n = q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3]
    if fw.estimator != ESTIMATOR_KINDS.kalman:
        return
    if not (is_finite(p) and n > 0.25 and n < 4.0):
        return
    predict(fw)
    _correct_position(fw, p[0], p[1], p[2])
    _correct_attitude(fw, normalize_quaternion((q[0], q[1], q[2], q[3])))
    _update_angles(fw)


@kernel(rows, matrix, flags, wholes, wholes)
def see_poses(
    fleet: Fleet, flat: Mat, seen: Bools, counts: Ints, intervals: Ints
) -> None:
    """Correct the estimates of all drones by the poses of one exposure.

    flat: (n, 7): rows of p m and q
    seen: (n,): whether the drone was seen
    counts: (n,): poses that each drone has had; counted on
    intervals: (n,): a drone is corrected by each pose with a count divisible by this
    """
    for i in range(flat.shape[0]):
        if not seen[i]:
            continue
        counts[i] += 1
        if counts[i] % intervals[i] == 0:
            see_pose(fleet, i, flat[i, 0:3], flat[i, 3:7])


@kernel(rows, whole, vector, real)
def see_velocity(fleet: Fleet, i: int, v: Vec, std: float) -> None:
    """Correct by a velocity, as from a flow deck; chosen.

        K = P_vv / (P_vv + std^2)
        v <- v + K (v_seen - v),  p <- p + P_pv / (P_vv + std^2) (v_seen - v), the tilt as p

    v: (3,) m/s, world
    std: m/s: standard deviation of an axis
    """
    fw = fleet[i]
    if fw.estimator != ESTIMATOR_KINDS.kalman or not is_finite(v):
        return
    predict(fw)
    r = std * std
    k = fw.xy_vv / (fw.xy_vv + r)
    kp = fw.xy_pv / (fw.xy_vv + r)
    kt = fw.xy_vt / (fw.xy_vv + r)
    dx = v[0] - fw.vx
    dy = v[1] - fw.vy
    fw.vx = fw.vx + k * dx
    fw.vy = fw.vy + k * dy
    fw.x = fw.x + kp * dx
    fw.y = fw.y + kp * dy
    _turn_estimate(fw, -kt * dy, kt * dx, 0.0)
    fw.xy_pp = fw.xy_pp - kp * fw.xy_pv
    fw.xy_pt = fw.xy_pt - kp * fw.xy_vt
    fw.xy_tt = fw.xy_tt - kt * fw.xy_vt
    fw.xy_pv = (1.0 - k) * fw.xy_pv
    fw.xy_vt = (1.0 - k) * fw.xy_vt
    fw.xy_vv = (1.0 - k) * fw.xy_vv
    k = fw.z_vv / (fw.z_vv + r)
    kp = fw.z_pv / (fw.z_vv + r)
    dz = v[2] - fw.vz
    fw.vz = fw.vz + k * dz
    fw.z = fw.z + kp * dz
    fw.z_pp = fw.z_pp - kp * fw.z_pv
    fw.z_pv = (1.0 - k) * fw.z_pv
    fw.z_vv = (1.0 - k) * fw.z_vv
    _update_angles(fw)
