"""The filter compared with the textbook's matrices, and its model compared with the model that it is given."""

import math

import numpy as np
import pytest
from scipy.linalg import expm
from scipy.signal import lsim

from crazychoir.control.margin import make_rate_loop
from crazychoir.filters.kalman import KalmanFilter, KalmanNoise
from crazychoir.filters.kalman_law import KALMAN_DEVIATIONS
from crazychoir.filters.motion import CommandedMotion
from crazychoir.flight.estimate import compute_rate_loops
from crazychoir.numerics.math3d import quaternion_product, rotation_exponential
from crazychoir.platforms import PAPER_PLATFORM
from crazychoir.types import Pose

JERK, PUSH, SWING, R_P, R_A = 0.7, 2e-3, 0.4, 1e-6, 2.5e-5
WIENER = np.diag([1.0, 1.0], 1)
HOVER = np.array([PAPER_PLATFORM.weight, 0.0, 0.0, 0.0])


def discretised(a, q, h):
    """F and Q of x' = a x + n, n with density q: Van Loan 1978."""
    n = len(a)
    big = expm(h * np.block([[-a, q], [np.zeros((n, n)), a.T]]))
    f = big[n:, n:].T
    return f, f @ big[:n, n:]


def textbook(x, cov, z, f, q, r):
    """One step of the Kalman filter that measures the first element of x."""
    x, cov = f @ x, f @ cov @ f.T + q
    s = cov[0, 0] + r
    gain = cov[:, 0] / s
    return x + gain * (z - x[0]), cov - np.outer(gain, gain) * s


def upper(cov):
    return cov[np.triu_indices(len(cov))]


@pytest.mark.parametrize("mean_step", [0.02, 0.01, 1 / 240])
def test_position_and_its_covariance_are_those_of_the_textbook_at_uneven_steps(
    mean_step,
):
    draw = np.random.default_rng(1)
    f = KalmanFilter(noise=KalmanNoise(place=math.sqrt(R_P), jerk=JERK, push=PUSH))
    x, cov, t = (
        np.zeros(3),
        np.diag(
            [
                R_P,
                KALMAN_DEVIATIONS.start_velocity**2,
                KALMAN_DEVIATIONS.start_disturbance**2,
            ]
        ),
        0.0,
    )
    f.update(Pose(np.array([0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0])), 0.0)
    for _ in range(100):
        h = mean_step * draw.uniform(0.2, 3.0)
        t += h
        z = math.sin(2.0 * t) + 1e-3 * draw.standard_normal()
        state = f.update(Pose(np.array([z, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0])), t)
        x, cov = textbook(
            x, cov, z, *discretised(WIENER, np.diag([0.0, PUSH, JERK]), h), R_P
        )
        np.testing.assert_allclose([state.p[0], state.v[0]], x[:2], atol=1e-9)
        np.testing.assert_allclose(
            f._row["place_covariance"],
            upper(cov),
            rtol=1e-6,
        )


def test_the_measured_noise_is_the_mean_of_the_squared_fourth_differences():
    draw = np.random.default_rng(4)
    f = KalmanFilter(period=0.01)
    p = 2e-4 * draw.standard_normal((60, 3))
    for k, place in enumerate(p):
        f.update(Pose(np.array([*place, 0.0, 0.0, 0.0, 1.0])), 0.01 * k)
    differences = np.diff(p[1:], 4, axis=0)  # the filter starts at the first pose
    expected = np.mean((differences**2).sum(axis=1)) / (3.0 * 70.0)
    assert f._row["place_variance"] == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize("mean_step", [0.02, 0.01, 1 / 240])
def test_an_angle_about_one_axis_and_its_covariance_are_those_of_the_textbook(
    mean_step,
):
    draw = np.random.default_rng(2)
    f = KalmanFilter(noise=KalmanNoise(angle=math.sqrt(R_A), swing=SWING))
    x, cov, t = np.zeros(2), np.diag([R_A, KALMAN_DEVIATIONS.start_turn_rate**2]), 0.0
    f.update(Pose(np.array([0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0])), 0.0)
    for k in range(100):
        h = mean_step * draw.uniform(0.2, 3.0)
        t += h
        z = 6.0 * math.sin(0.7 * t) + 5e-3 * draw.standard_normal()  # beyond pi
        sign = -1.0 if k % 2 else 1.0  # motion capture may give either sign
        q = sign * np.array(rotation_exponential(0.0, z, 0.0))
        state = f.update(Pose(np.array([0.0, 0.0, 1.0, *q])), t)
        x, cov = textbook(
            x, cov, z, *discretised(WIENER[:2, :2], np.diag([0.0, SWING]), h), R_A
        )
        np.testing.assert_allclose(state.w, [0.0, x[1], 0.0], atol=1e-8)
        assert abs(state.q @ rotation_exponential(0.0, x[0], 0.0)) == pytest.approx(
            1.0, abs=1e-12
        )
        np.testing.assert_allclose(
            f._row["attitude_covariance"],
            upper(cov),
            rtol=1e-6,
        )


def test_what_obeys_the_commands_leaves_nothing_unexplained():
    """Poses of the paper's dynamics: all is met, changes of the acceleration too, but for the integration's step."""
    motion = CommandedMotion(PAPER_PLATFORM.flat, 0.0)
    f = KalmanFilter(motion=motion)
    x = np.array([0.0, 0.0, 9.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0])
    for k in range(300):
        state = f.update(Pose(np.array([*x[:3], *x[6:10]])), 0.01 * k)
        np.testing.assert_allclose(state.flat, x, atol=3e-4)
        np.testing.assert_allclose(
            f._row["disturbance"],
            0.0,
            atol=5e-3,
        )
        f.commanded = PAPER_PLATFORM.weight * np.array(
            [1.0 + 0.2 * math.sin(0.1 * k), 0, 0, 0]
        )
        f.commanded[1:] = 2.0 * math.sin(0.07 * k), math.cos(0.11 * k), -1.0
        x = motion.after(x, f.commanded, 0.01)


def test_an_uncommanded_steady_force_becomes_the_disturbance_d():
    """A drone that weighs 10 % more than its model: d = -0.1 g / 1.1, and its velocity is met all the same."""
    f, a = (
        KalmanFilter(motion=CommandedMotion(PAPER_PLATFORM.flat, -math.inf)),
        -0.1 / 1.1 * 9.80665,
    )
    for k in range(200):
        t = 0.01 * k
        state = f.update(
            Pose(np.array([0.0, 0.0, 5.0 + 0.5 * a * t * t, 0.0, 0.0, 0.0, 1.0])), t
        )
        f.commanded = np.array([PAPER_PLATFORM.weight, 0.0, 0.0, 0.0])
    fall = (
        PAPER_PLATFORM.weight - PAPER_PLATFORM.drag[2] * a * 1.99
    ) / PAPER_PLATFORM.mass - 9.80665
    assert f._row["disturbance"][2] == pytest.approx(a - fall, abs=0.05)
    assert state.v[2] == pytest.approx(a * 1.99, abs=0.01)


def test_a_constant_body_rate_about_any_axis_is_found():
    f, w, h = KalmanFilter(), np.array([0.3, -0.2, 3.0]), 0.01
    q = (0.0, 0.0, 0.0, 1.0)
    for k in range(400):
        state = f.update(
            Pose(np.array([0.0, 0.0, 1.0, *((-1.0) ** k * np.array(q))])), k * h
        )
        q = quaternion_product(q, rotation_exponential(*(h * w)))
    np.testing.assert_allclose(state.w, w, atol=1e-6)


def swung(loop, seen=0.5, until=0.9, h=0.01, rubbish=False):
    """Return the largest error of the roll, rad, until `until` s. Poses are seen until `seen` s; then none, or rubbish.

    The true roll comes from the whole rate loop of the firmware. Commands tilt it to and fro, and reach it 20 ms late.
    """
    f, t = (
        KalmanFilter(motion=CommandedMotion(PAPER_PLATFORM.flat, 0.0), loop=loop),
        np.arange(0.0, until, h),
    )
    told = 5.0 * np.sin(2.0 * math.pi * 2.5 * t)
    fine = np.arange(0.0, until, h / 10)
    _, w, _ = lsim(
        make_rate_loop(PAPER_PLATFORM, 0),
        np.concatenate([np.zeros(20), np.repeat(told, 10)])[: len(fine)],
        fine,
    )
    roll = np.concatenate([[0.0], np.cumsum(0.5 * (w[1:] + w[:-1])) * h / 10])[::10]
    errors = []
    for k, now in enumerate(t):
        q = np.array(rotation_exponential(roll[k], 0.0, 0.0))
        pose = Pose(
            np.array([0.0, 0.0, 9.0, *(q if now < seen else np.full(4, np.nan))])
        )
        state = f.update(pose, now) if now < seen or rubbish else f.predict(now)
        errors.append(abs(2.0 * math.atan2(state.q[0], state.q[3]) - roll[k]))
        f.commanded = np.array([PAPER_PLATFORM.weight, told[k], 0.0, 0.0])
    return max(errors)


def test_an_unseen_drone_knows_its_tilt_if_it_knows_its_rate_loop():
    assert swung(compute_rate_loops(PAPER_PLATFORM)) < 0.06 < 0.2 < swung(None)
    assert swung(compute_rate_loops(PAPER_PLATFORM), rubbish=True) == pytest.approx(
        swung(compute_rate_loops(PAPER_PLATFORM)), abs=1e-9
    )


def test_without_thrust_the_rotors_run_down_and_the_rates_stay():
    """The firmware resets its loops meanwhile: r' fades with the lag of the rotors."""
    f = KalmanFilter(
        motion=CommandedMotion(PAPER_PLATFORM.flat, 0.0),
        loop=compute_rate_loops(PAPER_PLATFORM),
    )
    rates = []
    for k in range(60):
        f.update(Pose(np.array([0.0, 0.0, 9.0, 0.0, 0.0, 0.0, 1.0])), 0.01 * k)
        rates.append(f._row["loop_rate"][0])
        f.commanded = np.array([PAPER_PLATFORM.weight if k < 5 else 0.0, 5.0, 0.0, 0.0])
    slope = (rates[5] - rates[4]) / 0.01
    assert rates[-1] == pytest.approx(
        rates[5] + slope * PAPER_PLATFORM.rotor.lag, rel=0.1
    )
    assert rates[-1] == pytest.approx(rates[-10], rel=0.01)


@pytest.mark.parametrize("loop", [None, compute_rate_loops(PAPER_PLATFORM)])
@pytest.mark.parametrize("motion", [None, CommandedMotion(PAPER_PLATFORM.flat, 0.0)])
def test_the_loop_is_known_only_with_the_motion_and_the_loop(motion, loop):
    row = KalmanFilter(motion=motion, loop=loop)._row
    assert row["knows_commands"] == (motion is not None)
    assert row["knows_loop"] == (motion is not None and loop is not None)


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_the_rates_are_those_of_the_loop_on_board(axis):
    """Until its integral or the limit of its commands says more: a small step, as `make_rate_loop` has it."""
    assert stepped(axis, 0.5) == pytest.approx(0.5 * response(axis), abs=0.03)


def test_a_large_step_meets_the_limit_of_the_motors_commands():
    """The motors' commands are int16, kp of them a degree/s; `make_rate_loop` has rad/s2 a rad/s."""
    gain, lag, t = (
        make_rate_loop(PAPER_PLATFORM, 0)[1][2]
        / (PAPER_PLATFORM.firmware.rate_pid[0] * math.degrees(1.0)),
        PAPER_PLATFORM.rotor.lag,
        0.04,
    )
    most = gain * 32767.0
    assert stepped(0, 8.0)[4] == pytest.approx(
        most * (t - lag * (1.0 - math.exp(-t / lag))), rel=0.1
    )
    assert 8.0 * response(0)[4] > 3.0


def stepped(axis, rate, until=0.5, h=0.01):
    """rad/s, every 10 ms from the step of a command on."""
    f, told = (
        KalmanFilter(
            motion=CommandedMotion(PAPER_PLATFORM.flat, 0.0),
            loop=compute_rate_loops(PAPER_PLATFORM),
        ),
        HOVER.copy(),
    )
    told[1 + axis], found = rate, []
    for k in range(round(until / h)):
        f.update(Pose(np.array([0.0, 0.0, 9.0, 0.0, 0.0, 0.0, 1.0])), k * h)
        found.append(f._row["loop_rate"][axis])
        f.commanded = told
    return np.array(found)


def response(axis, until=0.5, h=0.01):
    """The step response of the linear loop."""
    t = np.arange(round(until / h)) * h
    return lsim(make_rate_loop(PAPER_PLATFORM, axis), np.ones(len(t)), t)[1]
