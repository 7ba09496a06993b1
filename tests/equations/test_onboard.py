"""Equations of the firmware on board, against matrices, finite differences and scipy."""

import math

import numba
import numpy as np
import pytest
from scipy import signal
from scipy.spatial.transform import Rotation

from crazychoir.numerics.kernels import kernel
from crazychoir.numerics.math3d import STANDARD_GRAVITY, rotation, rotation_from_flat
from crazychoir.platforms import CRAZYFLIE_21
from crazychoir.simulation.onboard import (
    estimator,
    loop,
    mixing,
    planner,
    polynomial,
)
from crazychoir.simulation.onboard.controllers import attitude, lee, mellinger
from crazychoir.simulation.onboard.onboard import Onboard
from crazychoir.simulation.onboard.record import rows
from crazychoir.simulation.onboard.units import FIRMWARE_GRAVITY

UP = np.array([0.0, 0.0, FIRMWARE_GRAVITY])
singles = numba.float32[::1]


@kernel(singles, numba.float32, singles, singles)
def connect(c, duration, start, end):
    polynomial.connect_ends(c, 0, duration, start, end)


@kernel(singles, numba.float32, singles)
def evaluate(c, t, out):
    polynomial.evaluate_piece(c, t, out)


def vec(*numbers):
    return np.array(numbers, np.float32)


def connected(duration, start, end):
    c = np.zeros(33, np.float32)
    connect(c, np.float32(duration), vec(*start), vec(*end))
    return c


def test_rest_to_rest_has_the_coefficients_of_the_firmware():
    d, t = 0.8, 1.7
    want = [0.2, 0, 0, 0, 35 * d / t**4, -84 * d / t**5, 70 * d / t**6, -20 * d / t**7]
    assert connected(t, (0.2, 0, 0), (1.0, 0, 0))[:8] == pytest.approx(want, rel=1e-5)


def test_a_piece_meets_its_ends_with_no_jerk():
    start, end, t = (0.3, -0.5, 0.7), (1.2, 0.4, -0.2), 2.3
    c = connected(t, start, end)
    out = np.zeros(16, np.float32)
    for at, ends in ((0.0, start), (t, end)):
        evaluate(c, np.float32(at), out)
        assert [out[k] for k in (0, 4, 8, 12)] == pytest.approx([*ends, 0.0], abs=1e-4)


def test_an_evaluation_is_that_of_the_polynomial_and_its_derivatives():
    c = connected(2.3, (0.3, -0.5, 0.7), (1.2, 0.4, -0.2))
    p = np.polynomial.Polynomial(c[:8].astype(float))
    out = np.zeros(16, np.float32)
    for t in (0.1, 0.9, 2.2):
        evaluate(c, np.float32(t), out)
        want = [p.deriv(k)(t) if k else p(t) for k in range(4)]
        assert [out[k] for k in (0, 4, 8, 12)] == pytest.approx(want, abs=2e-5)


def flat(t):
    """a, j, yaw, yaw' of some flight."""
    a = np.array([math.sin(t), 2 * math.cos(0.7 * t), 0.5 * math.sin(2 * t)])
    j = np.array([math.cos(t), -1.4 * math.sin(0.7 * t), math.cos(2 * t)])
    return a, j, 0.4 * t, 0.4


@pytest.mark.parametrize("t", [0.0, 0.7, 2.0])
def test_body_rates_turn_the_flat_attitude(t):
    def r(s):
        a, _, yaw, _ = flat(s)
        return rotation_from_flat(a + UP, yaw)

    h = 1e-5
    skew = r(t).T @ (r(t + h) - r(t - h)) / (2 * h)
    a, j, yaw, rate = flat(t)
    w = planner.compute_flat_body_rates(tuple(a), tuple(j), yaw, rate)
    assert w[:2] == pytest.approx([skew[2, 1], skew[0, 2]], abs=1e-6)
    # the firmware's third rate leaves out the turn of the thrust axis
    assert w[2] == pytest.approx(r(t)[2, 2] * rate)


@kernel(rows, numba.float64[::1])
def laws(fleet, out):
    fw = fleet[0]
    axes = attitude.compute_axes_by_angles(
        fw.wanted, attitude.choose_heading(fw, fw.wanted)
    )
    e = attitude.compute_attitude_error(axes, fw)
    for k in range(3):
        for c in range(3):
            out[3 * k + c] = axes[k][c]
        out[9 + k] = e[k]


@kernel(rows)
def run_mellinger(fleet):
    mellinger.control(fleet[0], fleet[0].wanted)


@kernel(rows)
def run_lee(fleet):
    lee.control(fleet[0], fleet[0].wanted)


@pytest.fixture
def tilted():
    """A drone in some state, asked for some full state."""
    onboard = Onboard(CRAZYFLIE_21)
    fw = onboard.record
    q = Rotation.from_euler("ZYX", [0.5, 0.2, -0.1]).as_quat()
    names = ("x", "y", "z", "vx", "vy", "vz", "qx", "qy", "qz", "qw")
    for name, value in zip(names, (0.1, 0.2, 1, 0.3, 0, 0.1, *q), strict=True):
        fw[name] = value
    fw["yaw"] = math.degrees(0.5)
    fw["gx"], fw["gy"], fw["gz"] = 20.0, -30.0, 40.0
    onboard.setpoints.position((0.0, 0.0, 0.0), 0.0)
    qd = Rotation.from_euler("z", 0.3).as_quat()
    onboard.setpoints.full_state(
        np.array([0.3, 0.1, 1.2, 0.1, 0.2, 0, 0.4, -0.3, 0.2, *qd, 0.2, 0.1, -0.3])
    )
    return onboard


def reference(onboard):
    """R, position error, velocity error, acceleration, w, w_d of the fixture."""
    fw = onboard.record
    r = rotation(np.array([fw["qx"], fw["qy"], fw["qz"], fw["qw"]]))
    p, v, a = (
        np.array([0.2, -0.1, 0.2]),
        np.array([-0.2, 0.2, -0.1]),
        np.array([0.4, -0.3, 0.2]),
    )
    return r, p, v, a, np.radians([20.0, -30.0, 40.0]), np.array([0.2, 0.1, -0.3])


def vee(m):
    return np.array([m[2, 1], m[0, 2], m[1, 0]])


def test_angles_give_the_axes_of_r_and_the_attitude_error_is_that_of_the_matrices(
    tilted,
):
    tilted.setpoints.z_distance(0.2, -0.3, 0.0, 1.0)
    out = np.zeros(12)
    laws(tilted.rows, out)
    rd = Rotation.from_euler("ZYX", [0.5, -0.3, 0.2]).as_matrix()
    assert pytest.approx(rd) == out[:9].reshape(3, 3).T
    r = reference(tilted)[0]
    assert out[9:12] == pytest.approx(vee(rd.T @ r - r.T @ rd))


def test_mellingers_law(tilted):
    tilted.set("ctrlMel.ki_m_z", 5e5)
    tilted.set("ctrlMel.ki_m_xy", 5e5)
    tilted.set("ctrlMel.kR_xy", 2e4)  # so that no moment is at its limit
    tilted.set("ctrlMel.kR_z", 1e4)
    tilted.set("ctrlMel.kd_omega_rp", 0.0)
    run_mellinger(tilted.rows)
    r, p, v, a, w, wd = reference(tilted)
    f = (
        0.029 * (a + UP)
        + np.array([0.4, 0.4, 1.25]) * p
        + np.array([0.2, 0.2, 0.4]) * v
        + 0.05 * p * 0.002
    )
    rd = rotation_from_flat(f, 0.3)
    e = vee(rd.T @ r - r.T @ rd)
    m = -np.array([2e4, 2e4, 1e4]) * e + np.array([2e4, 2e4, 1.2e4]) * (wd - w)
    m -= 5e5 * e * 0.002
    fw = tilted.record
    assert fw["thrust"] == pytest.approx(132000 * f @ r[:, 2])
    got = [fw["roll_out"], -fw["pitch_out"], -fw["yaw_out"]]
    assert got == pytest.approx(m, abs=1.0)
    assert np.max(np.abs(m)) < 32000


def test_mellingers_rate_damping_is_the_change_since_the_last_pass(tilted):
    run_mellinger(tilted.rows)
    run_mellinger(tilted.rows)
    steady = float(tilted.record["roll_out"])
    tilted.record["gx"] += math.degrees(0.01)
    run_mellinger(tilted.rows)
    change = -20000 * 0.01 - 200 * 0.01 / 0.002
    assert tilted.record["roll_out"] - steady == pytest.approx(change, rel=0.01)


def test_mellingers_rate_damping_starts_from_rates_of_zero(tilted):
    w, wd = reference(tilted)[4:6]
    tilted.set("ctrlMel.kd_omega_rp", 1.0)
    run_mellinger(tilted.rows)
    first = float(tilted.record["roll_out"])
    run_mellinger(tilted.rows)
    kick = (wd[0] - w[0]) / 0.002
    assert abs(kick) > 50.0
    assert first - tilted.record["roll_out"] == pytest.approx(kick, abs=5.0)


def test_a_negative_thrust_of_mellingers_controller_is_kept_without_moments(tilted):
    tilted.record["wanted"]["az"] = -30.0
    tilted.record["gx"] = 100.0
    run_mellinger(tilted.rows)
    fw = tilted.record
    assert fw["thrust"] < 0.0
    assert [fw["roll_out"], fw["pitch_out"], fw["yaw_out"]] == [0.0, 0.0, 0.0]
    assert fw["mellinger"]["iz"] == 0.0
    assert fw["mellinger"]["wx"] == pytest.approx(math.radians(100.0))


def test_lees_law(tilted):
    jerk = np.array([0.5, -0.2, 0.3])
    fw = tilted.record
    fw["wanted"]["jx"], fw["wanted"]["jy"], fw["wanted"]["jz"] = jerk
    run_lee(tilted.rows)
    r, p, v, a, w, _ = reference(tilted)
    f = 0.029 * (a + 7 * p + 4 * v + UP)
    rd = rotation_from_flat(f, 0.3)
    e = 0.5 * vee(rd.T @ r - r.T @ rd)
    j = np.array([16.571710e-6, 16.655602e-6, 29.261652e-6])
    h = 0.029 / (f @ r[:, 2]) * (jerk - jerk @ rd[:, 2] * rd[:, 2])
    wd = np.array([-h @ rd[:, 1], h @ rd[:, 0], -0.3 * rd[2, 2]])
    ew = w - r.T @ rd @ wd
    tau = (
        -np.array([7e-3, 7e-3, 8e-3]) * e
        - np.array([1.15e-3, 1.15e-3, 2e-3]) * ew
        - 0.03 * e * 0.002
    )
    tau += np.cross(w, j * w)
    fw = tilted.record
    assert fw["force"] == pytest.approx(f @ r[:, 2])
    assert [fw["torque_x"], fw["torque_y"], fw["torque_z"]] == pytest.approx(
        tau, rel=1e-9
    )


@kernel(rows)
def predict(fleet):
    estimator.predict(fleet[0])


SYMMETRIC = np.array([[0.04, 0.01, 0.003], [0.01, 0.09, -0.002], [0.003, -0.002, 0.02]])
"""A covariance of position, velocity and tilt."""
COVARIANCE = ("xy_pp", "xy_pv", "xy_pt", "xy_vv", "xy_vt", "xy_tt")


def uncertain():
    onboard = Onboard(CRAZYFLIE_21)
    fw = onboard.record
    for name, value in zip(COVARIANCE, SYMMETRIC[np.triu_indices(3)], strict=True):
        fw[name] = value
    fw["yaw_var"] = 0.03
    fw["x"], fw["vx"], fw["y"], fw["vy"] = 1.0, 0.5, -2.0, 0.3
    return onboard, fw


def corrected(covariance, row, variance):
    """The gain, and the covariance after a correction of state `row`."""
    gain = covariance[:, row] / (covariance[row, row] + variance)
    return gain, covariance - np.outer(gain, covariance[row])


def horizontal(fw):
    return np.array([fw["x"], fw["vx"], fw["y"], fw["vy"]])


def test_a_prediction_and_a_correction_are_kalmans():
    onboard, fw = uncertain()
    fw["samples"], fw["fx_sum"], fw["fz_sum"] = 10, 10 * 0.2, 10.0
    predict(onboard.rows)
    dt, n, lift = 0.01, 0.5, FIRMWARE_GRAVITY
    transition = np.array([[1, dt, lift * dt * dt / 2], [0, 1, lift * dt], [0, 0, 1]])
    noise = np.diag([0.0, 10 * (n * 1e-3) ** 2, 10 * (0.1 * 1e-3) ** 2])  # of each ms
    covariance = transition @ SYMMETRIC @ transition.T + noise
    assert [fw[name] for name in COVARIANCE] == pytest.approx(
        covariance[np.triu_indices(3)]
    )
    a = 0.2 * FIRMWARE_GRAVITY
    x = np.array([1 + 0.5 * dt + a * dt * dt / 2, 0.5 + a * dt, -2 + 0.3 * dt, 0.3])
    assert horizontal(fw) == pytest.approx(x)
    yaw_variance = 0.03 + 10 * (0.1 * 1e-3) ** 2
    assert fw["yaw_var"] == pytest.approx(yaw_variance)
    q = Rotation.from_rotvec([0.1, -0.2, 0.3])
    onboard.external_pose(np.array([1.1, -2.2, 0]), q.as_quat())
    gain, covariance = corrected(covariance, 0, 1e-4)
    off = np.array([1.1 - x[0], -2.2 - x[2]])
    x += [gain[0] * off[0], gain[1] * off[0], gain[0] * off[1], gain[1] * off[1]]
    turned = Rotation.from_rotvec([-gain[2] * off[1], gain[2] * off[0], 0.0])
    gain, covariance = corrected(covariance, 2, 4.5e-3**2)
    off = (q * turned.inv()).as_rotvec()
    x += [gain[0] * off[1], gain[1] * off[1], -gain[0] * off[0], -gain[1] * off[0]]
    yaw_gain = yaw_variance / (yaw_variance + 4.5e-3**2)
    turned = Rotation.from_rotvec(np.array([gain[2], gain[2], yaw_gain]) * off) * turned
    assert horizontal(fw) == pytest.approx(x)
    assert [fw[name] for name in COVARIANCE] == pytest.approx(
        covariance[np.triu_indices(3)]
    )
    own = Rotation.from_quat([fw["qx"], fw["qy"], fw["qz"], fw["qw"]])
    assert own.as_rotvec() == pytest.approx(turned.as_rotvec())


def test_a_correction_by_a_velocity_is_kalmans():
    onboard, fw = uncertain()
    onboard.measured_velocity(np.array([0.7, 0.2, 0.0]), 0.1)
    gain, covariance = corrected(SYMMETRIC, 1, 0.1**2)
    off = (0.7 - 0.5, 0.2 - 0.3)
    x = np.array([1.0, 0.5, -2.0, 0.3])
    x += [gain[0] * off[0], gain[1] * off[0], gain[0] * off[1], gain[1] * off[1]]
    assert horizontal(fw) == pytest.approx(x)
    assert [fw[name] for name in COVARIANCE] == pytest.approx(
        covariance[np.triu_indices(3)]
    )
    own = Rotation.from_quat([fw["qx"], fw["qy"], fw["qz"], fw["qw"]])
    assert own.as_rotvec() == pytest.approx([-gain[2] * off[1], gain[2] * off[0], 0.0])


@pytest.mark.parametrize("axis", [0, 1])
def test_the_tilt_of_the_filter_accelerates_along_its_axis(axis):
    """A tilt t about y moves along x by F t, a tilt about x along y by -F t."""
    tilt = np.array([[0.0, 1e-5, 0.0], [-1e-5, 0.0, 0.0]])[axis]
    got = []
    for q in (Rotation.identity(), Rotation.from_rotvec(tilt)):
        onboard = Onboard(CRAZYFLIE_21)
        fw = onboard.record
        fw["qx"], fw["qy"], fw["qz"], fw["qw"] = q.as_quat()
        fw["samples"], fw["fz_sum"] = 10, 10.0
        predict(onboard.rows)
        got.append([float(fw["vx"]), float(fw["vy"])][axis])
    assert got[1] - got[0] == pytest.approx(FIRMWARE_GRAVITY * 0.01 * 1e-5)


def test_in_flight_only_the_force_along_the_body_counts():
    onboard = Onboard(CRAZYFLIE_21)
    fw = onboard.record
    tilt = Rotation.from_euler("ZYX", [0.5, 0.2, -0.1])
    fw["qx"], fw["qy"], fw["qz"], fw["qw"] = tilt.as_quat()
    fw["samples"], fw["fx_sum"], fw["fy_sum"], fw["fz_sum"] = (
        10,
        10 * 0.2,
        10 * -0.3,
        10 * 1.1,
    )
    fw["flying"] = 1
    predict(onboard.rows)
    a = tilt.apply([0.0, 0.0, 1.1 * FIRMWARE_GRAVITY]) - [0.0, 0.0, FIRMWARE_GRAVITY]
    assert [fw["vx"], fw["vy"], fw["vz"]] == pytest.approx(0.01 * a)


def test_the_attitude_is_integrated_as_a_rotation():
    onboard = Onboard(CRAZYFLIE_21)
    fw = onboard.record
    fw["qx"], fw["qy"], fw["qz"], fw["qw"] = Rotation.from_euler(
        "ZYX", [0.5, 0.2, -0.1]
    ).as_quat()
    fw["samples"], fw["p_sum"], fw["q_sum"], fw["r_sum"] = 10, 1000.0, -2000.0, 3000.0
    fw["fz_sum"] = 10.0
    predict(onboard.rows)
    want = Rotation.from_euler("ZYX", [0.5, 0.2, -0.1]) * Rotation.from_rotvec(
        np.radians([1.0, -2.0, 3.0])
    )
    assert (
        want.inv() * Rotation.from_quat([fw["qx"], fw["qy"], fw["qz"], fw["qw"]])
    ).magnitude() < 1e-12
    assert [fw["yaw"], -fw["pitch"], fw["roll"]] == pytest.approx(
        want.as_euler("ZYX", degrees=True)
    )


@pytest.mark.parametrize(("axis", "hertz"), [("gx", 80.0), ("ax", 30.0)])
def test_sensors_pass_a_butterworth_filter(axis, hertz):
    onboard = Onboard(CRAZYFLIE_21)
    x = np.sin(0.05 * np.arange(100)) + 0.3 * np.sin(0.9 * np.arange(100))
    got = []
    for value in x:
        rate, force = (value, 0.0) if axis == "gx" else (0.0, value)
        loop.run(onboard.rows, 1.0, rate, 0.0, 0.0, force, 0.0, STANDARD_GRAVITY)
        got.append(float(onboard.record[axis]))
    b, a = signal.butter(2, hertz, fs=1000.0)
    unit = 180 / math.pi if axis == "gx" else 1 / STANDARD_GRAVITY
    assert got == pytest.approx(signal.lfilter(b, a, x) * unit, abs=1e-9)
    assert onboard.record["az"] == pytest.approx(1.0, abs=1e-12)


def test_the_batterys_low_pass_has_a_time_constant_of_100_ms():
    onboard = Onboard(CRAZYFLIE_21)
    onboard.record["vbat"] = 3.2
    loop.run(onboard.rows, 100.0, 0, 0, 0, 0, 0, STANDARD_GRAVITY)
    assert onboard.record["vbat_low"] == pytest.approx(
        3.2 + (1 - mixing.POWER_DISTRIBUTION.voltage_low_pass) ** 100
    )
