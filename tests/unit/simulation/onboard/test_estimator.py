"""The estimator: converges, follows a flight, turns through pi, resets, says how sure it is."""

import math

import numpy as np
import pytest
from rigid_body import Body
from scipy.spatial.transform import Rotation

from crazychoir.platforms import CRAZYFLIE_21
from crazychoir.simulation.onboard import loop
from crazychoir.simulation.onboard.onboard import Onboard

G = 9.80665
UP = np.array([0.0, 0.0, G])


def angle(q, r):
    return (Rotation.from_quat(q).inv() * Rotation.from_quat(r)).magnitude()


def follow(onboard, seconds, p, v, q, w, rng=None, every=10, send=None):
    """Perfect sensors along a motion of constant body rate and given p(t), v(t); poses each `every` ms."""
    for k in range(round(1000 * seconds)):
        t = k * 1e-3
        if k % every == 0:
            noise = np.zeros(3) if rng is None else 0.002 * rng.normal(size=3)
            onboard.external_pose(p(t) + noise, q(t).as_quat())
            if send:
                send()
        a = (v(t + 5e-4) - v(t - 5e-4)) / 1e-3
        force = q(t).inv().apply(a + UP)
        loop.run(onboard.rows, 1.0, *w, *force)


@pytest.mark.parametrize("every", [10, 20, 70])
def test_it_follows_a_circle_with_a_turning_heading(every):
    onboard = Onboard(CRAZYFLIE_21)
    onboard.set("locSrv.extPosStdDev", 0.002)
    onboard.record["acc_count"] = 200.0  # the accelerometer is calibrated

    def p(t):
        return np.array([math.cos(2 * t), math.sin(2 * t), 1.0])

    def v(t):
        return 2 * np.array([-math.sin(2 * t), math.cos(2 * t), 0.0])

    def q(t):
        return Rotation.from_euler("z", 1.5 * t)

    follow(onboard, 6.0, p, v, q, (0, 0, 1.5), np.random.default_rng(3), every)
    state, last = onboard.estimate, 5.991  # predictions are at 100 Hz
    assert state.p == pytest.approx(p(last), abs=0.02)
    assert state.v == pytest.approx(v(last), abs=0.11)
    assert angle(state.q, q(last).as_quat()) < 0.003
    assert state.w == pytest.approx([0, 0, 1.5], abs=1e-3)


def test_the_variances_in_hover_are_the_firmwares():
    """The firmware logs 1.16e-4 and 2.95e-4 with poses at 50 Hz."""
    onboard = Onboard(CRAZYFLIE_21)
    still = (np.array([0.0, 0.0, 0.5]), np.zeros(3))
    q = Rotation.identity()
    follow(
        onboard,
        3.0,
        lambda t: still[0],
        lambda t: still[1],
        lambda t: q,
        (0, 0, 0),
        every=20,
    )
    assert onboard.log("kalman.varPX") == pytest.approx(1.16e-4, rel=0.05)
    assert onboard.log("kalman.varPZ") == pytest.approx(2.95e-4, rel=0.05)


@pytest.mark.parametrize(
    ("std", "velocity", "position"), [(0.01, 0.093, 0.0187), (0.06, None, 0.116)]
)
def test_drag_is_seen_as_late_as_by_the_firmware(std, velocity, position):
    """The firmware's estimate at 1 m/s with poses at 50 Hz; in flight it takes no drag into account.

    The drag of that flight is not known: 0.225 m/s2 is chosen for the first velocity. The positions follow.
    """
    onboard = Onboard(CRAZYFLIE_21)
    onboard.set("locSrv.extPosStdDev", std)
    q = Rotation.from_euler("y", math.atan(0.225 / G))
    follow(
        onboard,
        6.0,
        lambda t: np.array([t, 0.0, 0.5]),
        lambda t: np.array([1.0, 0.0, 0.0]),
        lambda t: q,
        (0, 0, 0),
        every=20,
        send=lambda: onboard.setpoints.velocity((1.0, 0.0, 0.0), 0.0),
    )
    assert onboard.state == "flying"
    at = 5.991
    assert onboard.estimate.p[0] - at == pytest.approx(position, rel=0.05)
    if velocity:
        assert onboard.estimate.v[0] - 1.0 == pytest.approx(velocity, rel=0.05)


def test_yaw_goes_through_pi_without_a_jump():
    onboard = Onboard(CRAZYFLIE_21)
    onboard.place((0, 0, 0), 3.0)
    worst = 0.0
    for k in range(1000):
        q = Rotation.from_euler("z", 3.0 + 0.5e-3 * k)
        if k % 10 == 0:
            onboard.external_pose(
                np.zeros(3), q.as_quat() * (1.0 if k % 20 else -1.0)
            )  # either sign of q
        loop.run(onboard.rows, 1.0, 0, 0, 0.5, 0, 0, G)
        worst = max(worst, angle(onboard.estimate.q, q.as_quat()))
    assert worst < 0.01
    assert onboard.log("stateEstimate.yaw") == pytest.approx(
        math.degrees(3.5) - 360.0, abs=0.5
    )


def test_a_wrong_beginning_is_forgotten_within_20_poses():
    onboard = Onboard(CRAZYFLIE_21)
    q = Rotation.from_euler("ZYX", [2.8, 0.1, -0.2])
    still = (np.array([2.0, -1.0, 0.5]), np.zeros(3))
    follow(onboard, 0.2, lambda t: still[0], lambda t: still[1], lambda t: q, (0, 0, 0))
    assert onboard.estimate.p == pytest.approx([2.0, -1.0, 0.5], abs=0.01)
    # 2.8 rad with a deviation of 0.01 rad against 20 poses with 0.0045 rad
    assert angle(onboard.estimate.q, q.as_quat()) < 2.8 / (20 * 0.01**2 / 0.0045**2)


def test_the_variance_begins_large_and_falls():
    onboard = Onboard(CRAZYFLIE_21)
    assert onboard.log("kalman.varX") == pytest.approx(1e4)
    assert onboard.log("kalman.varZ") == pytest.approx(1.0)
    for _ in range(50):
        onboard.external_pose(np.zeros(3), np.array([0, 0, 0, 1.0]))
        loop.run(onboard.rows, 10.0, 0, 0, 0, 0, 0, G)
    assert 1e-6 < onboard.log("kalman.varX") < 1e-4
    loop.run(onboard.rows, 3000.0, 0, 0, 0, 0, 0, G)
    assert onboard.log("kalman.varX") > 1e-3
    onboard.set("kalman.resetEstimation", 1)
    assert onboard.log("kalman.varX") == pytest.approx(1e4)


@pytest.mark.parametrize(
    ("p", "force"), [((101.0, 0, 0), (0, 0, G)), ((0, 0, 0), (0, 0, 5 * G))]
)
def test_out_of_bounds_it_begins_anew(p, force):
    onboard = Onboard(CRAZYFLIE_21)
    onboard.place((0.5, 0.0, 0.0), 0.3)
    onboard.external_position(np.array(p, float))
    loop.run(onboard.rows, 400.0, 0, 0, 0, *force)
    assert onboard.record["resets"] > 0
    assert np.linalg.norm(onboard.estimate.v) < 10.0
    assert abs(onboard.estimate.p[0]) < 1.0


def test_what_is_no_pose_is_passed_over():
    onboard = Onboard(CRAZYFLIE_21)
    before = onboard.estimate.flat.copy()
    onboard.external_pose(np.array([math.nan, 0, 0]), np.array([0, 0, 0, 1.0]))
    onboard.external_pose(np.zeros(3), np.zeros(4))
    onboard.external_pose(np.ones(3), np.array([0, 0, math.nan, 1.0]))
    onboard.external_position(np.array([0, math.inf, 0]))
    assert np.array_equal(onboard.estimate.flat, before)


def test_logged_angles_are_the_firmwares():
    onboard = Onboard(CRAZYFLIE_21)
    q = Rotation.from_euler("ZYX", [1.0, 0.2, 0.1]).as_quat()
    for _ in range(300):
        onboard.external_pose(np.zeros(3), q)
    assert onboard.log("stateEstimate.roll") == pytest.approx(
        math.degrees(0.1), abs=0.05
    )
    assert onboard.log("stateEstimate.pitch") == pytest.approx(
        -math.degrees(0.2), abs=0.05
    )
    assert onboard.log("stateEstimate.yaw") == pytest.approx(
        math.degrees(1.0), abs=0.05
    )


def test_in_a_flight_the_estimate_is_near_the_truth():
    body = Body().fly(0.2).hovering(1.0)
    worst = [0.0, 0.0]

    def look():
        worst[0] = max(
            worst[0], float(np.linalg.norm(body.onboard.estimate.p - body.p))
        )
        worst[1] = max(worst[1], angle(body.onboard.estimate.q, body.s[6:10]))
        body.onboard.setpoints.position((0.8, 0.5, 1.2), 0.5)

    body.fly(3.0, look)
    assert worst[0] < 0.02
    assert worst[1] < 0.05


def test_a_velocity_corrects_the_velocity_and_what_it_has_led_to():
    onboard = Onboard(CRAZYFLIE_21)
    for _ in range(100):
        onboard.measured_velocity(np.array([0.3, -0.2, 0.1]), 0.02)
        loop.run(onboard.rows, 10.0, 0.0, 0.0, 0.0, *UP)
    estimate = onboard.estimate
    assert estimate.v == pytest.approx([0.3, -0.2, 0.1], abs=0.02)
    assert estimate.p == pytest.approx([0.3, -0.2, 0.1], abs=0.03)
    assert onboard.log("kalman.varPX") < 0.02**2
    before = onboard.estimate.v
    onboard.measured_velocity(np.array([np.nan, 0.0, 0.0]), 0.02)
    assert np.array_equal(onboard.estimate.v, before)
