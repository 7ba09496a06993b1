"""The PID form by hand, and a step response against the same linear loop in scipy."""

import math

import numba
import numpy as np
import pytest
from scipy import signal

from crazychoir.numerics.kernels import kernel, vector
from crazychoir.platforms import CRAZYFLIE_21
from crazychoir.simulation.onboard.controllers import cascade, pid
from crazychoir.simulation.onboard.onboard import Onboard
from crazychoir.simulation.onboard.record import make_fleet, pid_fields

gains = numba.from_dtype(pid_fields)[::1]


@kernel(gains, vector, vector, numba.float64[::1], numba.float64)
def plain(rows, desired, measured, out, rate):
    for k in range(len(out)):
        out[k] = pid.follow(rows[0], desired[k], measured[k], rate)


@kernel(gains, vector, vector, numba.float64[::1], numba.float64)
def smooth(rows, desired, measured, out, rate):
    for k in range(len(out)):
        out[k] = pid.follow_smooth(rows[0], desired[k], measured[k], rate)


@kernel(gains, vector, vector, numba.float64[::1], numba.float64)
def angle(rows, desired, measured, out, rate):
    for k in range(len(out)):
        out[k] = pid.follow_angle(rows[0], desired[k], measured[k], rate)


def answers(law, desired, measured, rate=500.0, **values):
    rows = np.zeros(1, pid_fields)
    rows["previous"] = measured[0]
    for name, value in values.items():
        rows[name] = value
    out = np.zeros(len(desired))
    law(rows, np.array(desired, float), np.array(measured, float), out, rate)
    return out


def test_the_form_by_hand():
    # e: 10, 9, 10, 8;  I: 1, 1.9, 2.9, 3.7;  d(measured)/dt: 0, 10, -10, 20
    out = answers(plain, [10] * 4, [0, 1, 0, 2], rate=10.0, kp=2.0, ki=3.0, kd=0.5)
    assert out == pytest.approx([20 + 3, 18 + 5.7 - 5, 20 + 8.7 + 5, 16 + 11.1 - 10])


def test_the_integral_is_clamped_before_its_gain_and_the_output_after_all():
    out = answers(plain, [10] * 5, [0] * 5, rate=10.0, ki=4.0, i_limit=2.5)
    assert out == pytest.approx([4, 8, 10, 10, 10])
    assert answers(plain, [10, -10], [0, 0], kp=2.0, limit=3.0) == pytest.approx(
        [3, -3]
    )


def test_a_step_of_the_set_point_makes_no_kick_and_feeds_forward():
    assert answers(plain, [0, 100], [5, 5], kd=1.0, kff=0.1) == pytest.approx([0, 10])


def test_an_angle_goes_the_short_way_in_error_and_change():
    out = answers(angle, [-170, -170], [170, -179], rate=10.0, kp=1.0, kd=0.1)
    assert out == pytest.approx([20, 9 - 11])


def test_the_derivative_is_low_passed_at_20_hz():
    b, a = signal.butter(2, 20.0, fs=100.0)
    x = np.sin(0.3 * np.arange(60)) + 0.1 * np.arange(60)
    raw = np.diff(x, prepend=x[0]) * 100.0
    assert answers(smooth, np.zeros(60), x, rate=100.0, kd=1.0) == pytest.approx(
        -signal.lfilter(b, a, raw), abs=1e-9
    )


def test_the_rate_loop_answers_a_step_as_the_linear_loop_of_scipy():
    """kp, ki, kd = 250, 500, 2.5 on the integrator deg/s per command of a 45 mm drone with its motors' lag."""
    j, lag, dt = 16.8e-6, 0.0858607, 0.002
    per_command = math.degrees(4 * 0.03253 * 0.5 * 0.12 / 65535 / j)
    a, b = np.array([[0.0, per_command], [0.0, -1 / lag]]), np.array([[0.0], [1 / lag]])
    ad, bd, *_ = signal.cont2discrete((a, b, np.eye(2), np.zeros((2, 1))), dt)
    # closed loop with states w, force, integral, last w
    kp, ki, kd = 250.0, 500.0, 2.5
    k = np.array([-kp - ki * dt - kd / dt, 0.0, ki, kd / dt])
    top = np.hstack([ad, np.zeros((2, 2))]) + bd @ k[None, :]
    closed = np.vstack([top, [-dt, 0, 1, 0], [1, 0, 0, 0]])
    drive = np.concatenate([(bd * (kp + ki * dt)).ravel(), [dt, 0.0]])
    _, want = signal.dlsim(
        (closed, drive[:, None], np.eye(4), np.zeros((4, 1)), dt), np.full(300, 20.0)
    )[:2]
    rows, x, flown = np.zeros(1, pid_fields), np.zeros(2), []
    rows["kp"], rows["ki"], rows["kd"], rows["i_limit"], rows["previous"] = (
        kp,
        ki,
        kd,
        33.3,
        0.0,
    )
    out = np.zeros(1)
    for _ in range(300):
        flown.append(x[0])
        plain(rows, np.array([20.0]), np.array([x[0]]), out, 500.0)
        x = ad @ x + bd[:, 0] * out[0]
    assert np.array(flown) == pytest.approx(want[:, 0], abs=1e-6)
    assert max(flown) > 20.0


@kernel(numba.from_dtype(make_fleet(1, CRAZYFLIE_21).dtype)[::1])
def control(rows):
    cascade.control(rows[0], rows[0].wanted)


def cascade_of(yaw=0.0, **values):
    onboard = Onboard(CRAZYFLIE_21)
    onboard.place((0.0, 0.0, 1.0), yaw)
    for name, value in values.items():
        onboard.record[name] = value
    return onboard


def test_the_position_cascade_by_hand():
    onboard = cascade_of()
    onboard.setpoints.position((0.3, 0.1, 1.2), 0.0)
    control(onboard.rows)
    fw = onboard.record
    # velocities 2 e; pitch -(25 v + 0.01 v), legacy sign; vertical also 0.5 of the first integral
    assert fw["target_vx"] == pytest.approx(0.6)
    assert fw["target_vy"] == pytest.approx(0.2)
    assert fw["target_vz"] == pytest.approx(0.4 + 0.5 * 0.2 * 0.01)
    assert fw["target_pitch"] == pytest.approx(-(25 * 0.6 + 0.01 * 0.6))
    assert fw["target_roll"] == pytest.approx(-(25 * 0.2 + 0.01 * 0.2))
    assert fw["thrust"] == pytest.approx(36000 + 1000 * (25 + 0.15) * 0.401)


@pytest.mark.parametrize("yaw", [0.5, math.pi, -2.0])
def test_position_errors_are_turned_by_the_yaw(yaw):
    onboard = cascade_of(yaw)
    onboard.setpoints.position((0.3 * math.cos(yaw), 0.3 * math.sin(yaw), 1.0), yaw)
    control(onboard.rows)
    assert onboard.record["target_vx"] == pytest.approx(0.6)
    assert onboard.record["target_vy"] == pytest.approx(0.0, abs=1e-9)


def test_limits_of_velocity_tilt_and_thrust():
    onboard = cascade_of()
    onboard.setpoints.position((9.0, -9.0, 99.0), 0.0)
    control(onboard.rows)
    fw = onboard.record
    assert (fw["target_vx"], fw["target_vy"], fw["target_vz"]) == pytest.approx(
        (1.1, -1.1, 1.1)
    )
    assert (fw["target_pitch"], fw["target_roll"]) == pytest.approx((-20.0, 20.0))
    assert fw["thrust"] == pytest.approx(36000 + 1000 * min(25.15 * 1.1, 32.767))
    onboard.setpoints.position((0.0, 0.0, -99.0), 0.0)
    control(onboard.rows)
    assert fw["thrust"] == 20000


def test_no_thrust_and_a_change_of_modes_reset_the_integrals():
    onboard = cascade_of()
    onboard.setpoints.position((0.3, 0.0, 1.2), 0.0)
    control(onboard.rows)
    fw = onboard.record
    assert fw["vx_pid"]["integral"] > 0.0
    onboard.setpoints.velocity((0.0, 0.0, 0.0), 0.0)
    control(onboard.rows)
    assert fw["vx_pid"]["integral"] == pytest.approx(0.0)
    fw["yaw_rate_pid"]["integral"] = 5.0
    onboard.setpoints.stop_setpoint()
    control(onboard.rows)
    assert fw["yaw_rate_pid"]["integral"] == 0.0
    assert fw["thrust"] == fw["roll_out"] == fw["pitch_out"] == fw["yaw_out"] == 0.0


def test_a_change_of_modes_keeps_the_heading_to_hold():
    """In the firmware only a pass without thrust takes the present heading."""
    onboard = cascade_of(0.0)
    onboard.setpoints.position((0.0, 0.0, 1.0), math.radians(-60.0))
    control(onboard.rows)
    onboard.setpoints.manual(0.3, 0.0, 0.0, 0.0)
    control(onboard.rows)
    assert onboard.record["target_yaw"] == pytest.approx(-60.0)
    onboard.setpoints.stop_setpoint()
    control(onboard.rows)
    assert onboard.record["target_yaw"] == pytest.approx(0.0)


def test_a_change_of_modes_kicks_a_turning_drone_for_one_pass():
    """The firmware takes the derivative of the rates from 0: 2.5 * 14 deg/s * 500 Hz."""
    onboard = cascade_of()
    fw = onboard.record
    fw["gx"] = 14.0
    onboard.setpoints.manual(0.3, 0.0, 0.0, 0.0)
    control(onboard.rows)
    steady = -(250.0 * 14.0 + 500.0 * 14.0 / 500.0)
    assert fw["roll_out"] == pytest.approx(steady - 17500.0, abs=1.0)
    control(onboard.rows)
    assert fw["roll_out"] == pytest.approx(steady - 500.0 * 14.0 / 500.0, abs=1.0)


def test_the_position_part_runs_at_100_hz_alone():
    """Until then the firmware keeps the thrust, and levels at the present angles."""
    onboard = cascade_of()
    fw = onboard.record
    fw["tick"], fw["roll"], fw["pitch"] = 2, 3.0, -2.0
    onboard.setpoints.manual(0.3, 0.0, 0.0, 0.0)
    control(onboard.rows)
    thrust = float(fw["thrust"])
    onboard.setpoints.position((0.3, 0.0, 1.2), 0.0)
    fw["tick"] = 4
    control(onboard.rows)
    assert (fw["thrust"], fw["target_roll"], fw["target_pitch"]) == (thrust, 3.0, -2.0)
    fw["tick"] = 10
    control(onboard.rows)
    assert fw["thrust"] == pytest.approx(36000 + 1000 * (25 + 0.15) * 0.401)


def test_a_yaw_rate_is_integrated_at_500_hz():
    onboard = cascade_of(3.0)
    control(onboard.rows)  # without thrust
    onboard.setpoints.manual(0.3, 0.0, 0.0, math.radians(100.0))
    for _ in range(500):
        control(onboard.rows)
    assert onboard.record["target_yaw"] == pytest.approx(
        math.degrees(3.0) + 100.0 - 360.0, abs=1e-6
    )
