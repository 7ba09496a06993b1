"""The state estimator on board: integrated gyroscope and accelerometer, corrected by poses.

Chosen in place of the firmware's Kalman filter with 9 states: two independent filters with scalar
updates, one for position and velocity on each axis, one for the attitude, with the firmware's
noise figures.
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
from crazychoir.simulation.onboard.record import Fleet, Record, rows, whole
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
    fw.xy_pv = 0.0
    fw.xy_vv = INITIAL_DEVIATIONS.velocity**2
    fw.z_pp = INITIAL_DEVIATIONS.height**2
    fw.z_pv = 0.0
    fw.z_vv = INITIAL_DEVIATIONS.velocity**2
    fw.att_var = INITIAL_DEVIATIONS.attitude**2
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
def _grow_covariance(
    pp: float, pv: float, vv: float, noise: float, samples: int
) -> tuple[float, float, float]:
    dt = samples * TICK_SECONDS
    return (
        pp + dt * (2.0 * pv + dt * vv),
        pv + dt * vv,
        vv + samples * (noise * TICK_SECONDS) ** 2,
    )


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
        P <- A P A^T + Q,  A = [1 dt; 0 1],  Q = k [0 0; 0 (n 1 ms)^2],  dt = k 1 ms
        P_att <- P_att + k (n_gyro 1 ms)^2

    f: m/s2, body: specific force, turned by the attitude at the middle of the interval
    n: m/s2: noise of the acceleration
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
    fw.xy_pp, fw.xy_pv, fw.xy_vv = _grow_covariance(
        fw.xy_pp, fw.xy_pv, fw.xy_vv, fw.noise_xy, fw.samples
    )
    fw.z_pp, fw.z_pv, fw.z_vv = _grow_covariance(
        fw.z_pp, fw.z_pv, fw.z_vv, fw.noise_z, fw.samples
    )
    fw.att_var += fw.samples * (fw.noise_gyro * TICK_SECONDS) ** 2
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
    dx = x - fw.x
    dy = y - fw.y
    fw.x = fw.x + k * dx
    fw.y = fw.y + k * dy
    fw.vx = fw.vx + kv * dx
    fw.vy = fw.vy + kv * dy
    fw.xy_vv = fw.xy_vv - kv * fw.xy_pv
    fw.xy_pv = (1.0 - k) * fw.xy_pv
    fw.xy_pp = (1.0 - k) * fw.xy_pp
    k = fw.z_pp / (fw.z_pp + r)
    kv = fw.z_pv / (fw.z_pp + r)
    dz = z - fw.z
    fw.z = fw.z + k * dz
    fw.vz = fw.vz + kv * dz
    fw.z_vv = fw.z_vv - kv * fw.z_pv
    fw.z_pv = (1.0 - k) * fw.z_pv
    fw.z_pp = (1.0 - k) * fw.z_pp


@kernel(rows, whole)
def reset(fleet: Fleet, i: int) -> None:
    """Start the estimate anew."""
    start_estimate(fleet[i])


@kernel(rows, whole, vector)
def see_position(fleet: Fleet, i: int, p: Vec) -> None:
    """Correct by a position (3,) m; a position that is not finite is ignored."""
    fw = fleet[i]
    if is_finite(p):
        predict(fw)
        _correct_position(fw, p[0], p[1], p[2])


@kernel(rows, whole, vector, vector)
def see_pose(fleet: Fleet, i: int, p: Vec, q: Vec) -> None:
    """Correct by a pose: p (3,) m, q (4,).

        K = P_pp / (P_pp + R),  p <- p + K (p_ext - p),  v <- v + P_pv / (P_pp + R) (p_ext - p)
        q <- q exp(K_att log(q^-1 q_ext)),  K_att = P_att / (P_att + R_att)

    R, R_att: squares of locSrv.extPosStdDev and locSrv.extQuatStdDev
    The sensors' sums are used first, so that the estimate belongs to the time of the pose. A pose
    that is not finite, or with a quaternion far from unit length, is ignored.
    """
    fw = fleet[i]
    n = q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3]
    if not (is_finite(p) and n > 0.25 and n < 4.0):
        return
    predict(fw)
    _correct_position(fw, p[0], p[1], p[2])
    k = fw.att_var / (fw.att_var + fw.ext_quat_std**2)
    own = (fw.qx, fw.qy, fw.qz, fw.qw)
    e = rotation_logarithm(
        quaternion_product(
            quaternion_conjugate(own), normalize_quaternion((q[0], q[1], q[2], q[3]))
        )
    )
    fw.qx, fw.qy, fw.qz, fw.qw = normalize_quaternion(
        quaternion_product(own, rotation_exponential(k * e[0], k * e[1], k * e[2]))
    )
    fw.att_var *= 1.0 - k
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
        v <- v + K (v_seen - v),  p <- p + P_pv / (P_vv + std^2) (v_seen - v)

    v: (3,) m/s, world
    std: m/s: standard deviation of an axis
    """
    fw = fleet[i]
    if not is_finite(v):
        return
    predict(fw)
    r = std * std
    k = fw.xy_vv / (fw.xy_vv + r)
    kp = fw.xy_pv / (fw.xy_vv + r)
    dx = v[0] - fw.vx
    dy = v[1] - fw.vy
    fw.vx = fw.vx + k * dx
    fw.vy = fw.vy + k * dy
    fw.x = fw.x + kp * dx
    fw.y = fw.y + kp * dy
    fw.xy_pp = fw.xy_pp - kp * fw.xy_pv
    fw.xy_pv = (1.0 - k) * fw.xy_pv
    fw.xy_vv = (1.0 - k) * fw.xy_vv
    k = fw.z_vv / (fw.z_vv + r)
    kp = fw.z_pv / (fw.z_vv + r)
    dz = v[2] - fw.vz
    fw.vz = fw.vz + k * dz
    fw.z = fw.z + kp * dz
    fw.z_pp = fw.z_pp - kp * fw.z_pv
    fw.z_pv = (1.0 - k) * fw.z_pv
    fw.z_vv = (1.0 - k) * fw.z_vv
