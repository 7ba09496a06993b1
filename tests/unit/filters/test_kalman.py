import math

import numpy as np
import pytest

from crazychoir.filters.kalman import KalmanFilter
from crazychoir.filters.kalman_law import KALMAN_GATE
from crazychoir.filters.motion import CommandedMotion
from crazychoir.filters.state_filter import StateFilter
from crazychoir.filters.velocity import VelocityFilter
from crazychoir.numerics.math3d import (
    quaternion_conjugate,
    quaternion_of_yaw,
    quaternion_product,
    rotation_exponential,
    rotation_logarithm,
)
from crazychoir.platforms import PAPER_PLATFORM
from crazychoir.types import Pose

STILL = np.array([0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0])
HOVER = np.array([PAPER_PLATFORM.weight, 0.0, 0.0, 0.0])


def pose(x, age=0.0):
    return Pose(np.array([x, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]), age)


def noisy(flat, draw):
    return Pose(np.array([*(flat[:3] + 5e-4 * draw.standard_normal(3)), *flat[3:]]))


def command(weights, *rates):
    return np.array([weights * PAPER_PLATFORM.weight, *rates])


def told(**options):
    f = KalmanFilter(motion=CommandedMotion(PAPER_PLATFORM.flat, 0.0), **options)
    f.commanded = HOVER
    return f


def flying(f, until, speed=1.0):
    for k in range(until + 1):
        state = f.update(pose(0.01 * speed * k), 0.01 * k)
    return state


def angle(state, q):
    return np.linalg.norm(
        rotation_logarithm(
            quaternion_product(quaternion_conjugate(tuple(q)), tuple(state.q))
        )
    )


def covariances(f):
    pp, pv, pd, vv, vd, dd = f._row["place_covariance"]
    aa, aw, ww = f._row["attitude_covariance"]
    return np.array([[pp, pv, pd], [pv, vv, vd], [pd, vd, dd]]), np.array(
        [[aa, aw], [aw, ww]]
    )


def test_a_pilot_may_take_either_filter():
    motion = CommandedMotion(PAPER_PLATFORM.flat, 0.0)
    filters: list[StateFilter] = [
        VelocityFilter(motion=motion),
        KalmanFilter(motion=motion),
    ]
    for f in filters:
        f.commanded = HOVER
        assert f.update(pose(0.0), 0.0).age == 0.0
        assert (f.refused, f.speed, f.measured, f.horizon) == (0, 0.0, 0.0, 0.5)


def test_before_the_first_pose_there_is_no_state_and_it_may_come_late():
    f = told()
    assert f.predict(3.0) is None
    state = f.update(pose(5.0, age=0.01), 100.0)
    np.testing.assert_allclose(
        state.flat, [5, 0, 1, 0, 0, 0, 0, 0, 0, 1, 0, 0, 0], atol=1e-12
    )
    assert f.measured == pytest.approx(99.99)


@pytest.mark.parametrize("now", [1.0, 0.9])
def test_a_repeated_or_older_pose_changes_nothing(now):
    f = KalmanFilter()
    before = flying(f, 100)
    again = f.update(pose(0.3, age=1.0 - now), 1.0)
    np.testing.assert_array_equal(again.flat, before.flat)


def test_a_steady_flight_is_met_and_goes_on_without_poses_as_far_as_the_horizon():
    f = told(horizon=0.5)
    np.testing.assert_allclose(flying(f, 300).v, [1.0, 0.0, 0.0], atol=0.02)
    assert f.predict(3.2).p[0] == pytest.approx(3.2, abs=5e-3)
    assert f.predict(3.2).age == pytest.approx(0.2)
    far = f.predict(9.0)
    assert far.p[0] == pytest.approx(3.5, abs=0.02)
    assert far.age == pytest.approx(6.0)


def test_a_gap_longer_than_the_horizon_leaves_its_mean_velocity():
    f = KalmanFilter()
    flying(f, 100)
    assert f.update(pose(1.7), 2.0).v[0] == pytest.approx(0.7, abs=1e-3)
    assert f.measured == 2.0


@pytest.mark.parametrize(
    "flat",
    [
        STILL * np.nan,
        [np.inf, 0, 1, 0, 0, 0, 1],
        *([0, 0, 1, 0, 0, 0, n] for n in (0.0, 0.49, 2.1, 1e200)),
    ],
)
def test_a_pose_that_is_not_readable_counts_as_missing(flat):
    bad = Pose(np.array(flat, dtype=float))
    f = KalmanFilter()
    assert f.update(bad, -1.0) is None
    flying(f, 100)
    for k in range(2 * KALMAN_GATE.doubts):
        state = f.update(bad, 1.01 + 0.01 * k)
        assert np.all(np.isfinite(state.flat))
        assert state.age == pytest.approx(0.01 * (k + 1))
    assert f.refused == 1 + 2 * KALMAN_GATE.doubts
    assert f.update(pose(1.22), 1.22).age == 0.0


def test_a_returned_state_is_read_only():
    f = KalmanFilter()
    for state in (
        f.update(pose(0.0), 0.0),
        f.update(pose(0.01), 0.01),
        f.predict(0.02),
        f.update(pose(9.0), 0.03),
    ):
        with pytest.raises(ValueError, match="read-only"):
            state.p[0] = 1.0


def test_the_speed_is_that_of_the_newest_state():
    f = told()
    for k in range(5):
        state = f.update(pose(0.01 * k), 0.01 * k)
        assert f.speed == pytest.approx(np.linalg.norm(state.v))
    f.commanded = 0.2 * HOVER
    assert f.predict(0.34).v[2] < -2.0
    assert f.speed == pytest.approx(np.linalg.norm(f.predict(0.34).v))


@pytest.mark.parametrize(
    "f",
    [VelocityFilter(), KalmanFilter(), told()],
    ids=["derivative", "kalman", "told"],
)
def test_the_body_rates_are_right_where_the_heading_passes_pi(f):
    rate, worst = 2.0, 0.0
    if isinstance(f, KalmanFilter):
        f.commanded = np.array([f.commanded[0], 0.0, 0.0, rate])
    for k in range(400):
        q = quaternion_of_yaw(
            math.remainder(2.5 + 0.01 * rate * k, 2.0 * math.pi)
        )  # w changes its sign at pi
        state = f.update(Pose(np.array([0.0, 0.0, 1.0, *q])), 0.01 * k)
        worst = (
            max(worst, np.linalg.norm(state.w - [0.0, 0.0, rate])) if k > 20 else 0.0
        )
        assert angle(state, q) < 1e-2
    assert worst < 2e-4


@pytest.mark.parametrize(
    "bad", [[0.3, 0, 1, 0, 0, 0, 1], [0.0, 0, 1, 1, 0, 0, 0]], ids=["place", "attitude"]
)
def test_an_outlier_is_refused_and_leaves_no_trace(bad):
    f, clean = told(), told()
    for k in range(200):
        good = Pose(STILL)
        state = f.update(
            Pose(np.array(bad, dtype=float)) if k == 100 else good, 0.01 * k
        )
        expected = clean.predict(0.01 * k) if k == 100 else clean.update(good, 0.01 * k)
        np.testing.assert_allclose(state.flat, expected.flat, atol=1e-12)
        assert state.age == (pytest.approx(0.01) if k == 100 else 0.0)
    assert f.refused == 1


def test_poses_that_stay_elsewhere_are_believed_in_the_end():
    f = told()
    flying(f, 100, speed=0.5)
    for k in range(1, 60):
        state = f.update(pose(4.0 + 0.5 + 0.005 * k), 1.0 + 0.01 * k)
        assert (state.p[0] > 4.0) == (k >= KALMAN_GATE.doubts)
    assert f.refused == KALMAN_GATE.doubts - 1
    assert state.v[0] == pytest.approx(0.5, abs=0.02)


@pytest.mark.parametrize(
    "bad",
    [
        np.full(4, np.nan),
        command(1.0, 0.0, np.nan, 0.0),
        command(np.inf, 0.0, 0.0, 0.0),
    ],
)
def test_commands_that_are_not_numbers_are_not_taken(bad):
    f = told()
    flying(f, 50, speed=0.0)
    f.commanded = bad
    assert np.all(np.isfinite(f.predict(0.6).flat))
    assert np.all(np.isfinite(f.update(pose(0.0), 0.61).flat))


def test_the_latency_is_bridged_by_the_commands_of_that_time():
    """Thrust and rates change each tick; the poses are 30 ms late, the state is that of now."""
    motion, truth, f = (
        CommandedMotion(PAPER_PLATFORM.flat, 0.0),
        [np.array([*STILL[:3], 0, 0, 0, *STILL[3:], 0, 0, 0.0])],
        told(),
    )
    for k in range(150):
        f.commanded = command(
            1.0 + 0.2 * math.sin(0.2 * k),
            2.0 * math.sin(0.3 * k),
            1.5 * math.cos(0.25 * k),
            0.4,
        )
        truth.append(motion.after(truth[-1], f.commanded, 0.01))
        if k < 2:
            f.predict(0.01 * (k + 1))
            continue
        seen = truth[k - 2]
        state = f.update(Pose(np.array([*seen[:3], *seen[6:10]]), 0.03), 0.01 * (k + 1))
        if k > 100:
            np.testing.assert_allclose(state.flat[:6], truth[-1][:6], atol=3e-4)
            np.testing.assert_allclose(state.w, truth[-1][10:13], atol=3e-3)
            assert angle(state, truth[-1][6:10]) < 1e-3


def test_half_a_second_without_poses_is_flown_by_the_commands_and_the_thrust_that_was_off():
    motion = CommandedMotion(PAPER_PLATFORM.flat, 0.0)
    off = {}
    for kind in ("derivative", "kalman"):
        f = VelocityFilter(motion=motion) if kind == "derivative" else told()
        x = np.array([0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0])
        for k in range(250):
            seen = Pose(np.array([*x[:3], *x[6:10]]))
            state = f.update(seen, 0.01 * k) if k < 200 else f.predict(0.01 * k)
            u = command(1.0, 0.6 * math.sin(0.1 * k), 0.0, 0.5)
            f.commanded = u * [0.95, 1.0, 1.0, 1.0]  # it pushes harder than it is told
            before, x = x, motion.after(x, u, 0.01)
        off[kind] = np.linalg.norm(state.p - before[:3])
    assert off["kalman"] < 0.02
    assert off["derivative"] > 0.04


@pytest.mark.parametrize("ground", [0.0, -0.05])
def test_a_drone_that_stands_on_the_ground_is_at_rest_and_takes_off_without_a_jump(
    ground,
):
    """Also from lower than the floor was believed to be."""
    draw, f = (
        np.random.default_rng(1),
        KalmanFilter(motion=CommandedMotion(PAPER_PLATFORM.flat, 0.0)),
    )
    place = np.array([0.0, 0.0, ground, 0.0, 0.0, 0.0, 1.0])
    for k in range(400):
        f.commanded = HOVER * (0.0 if k < 200 else 0.9)
        state = f.update(noisy(place, draw), 0.01 * k)
        assert k < 20 or np.linalg.norm(state.v) < 0.03
    assert (
        np.linalg.norm(f._row["disturbance"]) < 0.1
    )  # what the floor carries is not summed up
    f.commanded = 1.2 * HOVER
    for k in range(1, 50):
        t = 0.01 * k
        risen = np.array([0.0, 0.0, ground + 0.1 * 9.80665 * t * t, 0.0, 0.0, 0.0, 1.0])
        state = f.update(Pose(risen), 3.99 + t)
        assert abs(state.v[2] - 0.2 * 9.80665 * t) < 0.05
    assert f.refused == 0


def test_a_floor_that_is_not_where_it_was_believed_does_no_harm():
    f, high = (
        KalmanFilter(motion=CommandedMotion(PAPER_PLATFORM.flat, 0.0)),
        np.array([0.0, 0.0, 0.4, 0.0, 0.0, 0.0, 1.0]),
    )
    for k in range(300):
        state = f.update(Pose(high), 0.01 * k)
        f.commanded = HOVER * (0.0 if k < 100 else 0.8)
        assert np.linalg.norm(state.v) < 0.2
    assert np.linalg.norm(state.v) < 0.02
    assert np.linalg.norm(state.p - high[:3]) < 1e-3


def test_the_rate_of_the_cameras_tells_when_a_pose_was_measured():
    draw, f = np.random.default_rng(2), KalmanFilter(period=0.01)
    instants = []
    for k in range(2000):
        f.update(Pose(STILL), 1.0 + 0.01 * k + (draw.uniform(5e-5, 3e-4) if k else 0.0))
        instants.append(f.measured)
    assert np.diff(instants).std() < 1e-6


@pytest.mark.parametrize("spread", [0.0002, 0.001])
@pytest.mark.parametrize("gap", [0.1, 0.3, 1.0])
def test_poses_that_were_late_come_together_and_nothing_seems_fast(gap, spread):
    """A program that stood still reads in a moment what came meanwhile; none of it says that it is old."""
    f, speeds, n, read = (
        KalmanFilter(horizon=2.0, period=0.01),
        [],
        round(100 * gap),
        0.0,
    )
    for k in range(300 + n):
        seen, age = 0.01 * k, 0.002
        read = max(seen + age, read + spread, 2.0 + gap + age if k >= 200 else 0.0)
        f.update(pose(seen, age), read)
        speeds.append(f.speed)
    assert max(speeds[150:]) < 2.0
    assert speeds[-1] == pytest.approx(1.0, abs=0.05)


@pytest.mark.parametrize("rate", [50, 100, 240])
def test_whatever_comes_the_covariances_stay_positive_and_bounded_and_the_state_finite(
    rate,
):
    draw, f, at_rest = np.random.default_rng(rate), told(), STILL.copy()
    largest = 0.0
    for k in range(10 * rate):
        now = k / rate + draw.uniform(5e-5, 3e-4)
        flat = noisy(at_rest, draw).flat
        match int(draw.integers(12)):
            case 0:
                flat[:3] += draw.uniform(-1e3, 1e3, 3)
            case 1:
                flat[3:] = draw.uniform(-2, 2, 4)
            case 2:
                flat *= draw.choice([1.0, np.nan], 7)
        late = draw.choice([0.0, 0.01, 0.4, 5.0], p=[0.5, 0.48, 0.01, 0.01])
        unseen = 5.0 < k / rate < 6.5
        state = f.predict(now) if unseen else f.update(Pose(flat, late), now)
        if state is None:
            continue
        for covariance in covariances(f):
            assert np.linalg.eigvalsh(covariance).min() > 0.0
            largest = max(largest, covariance.max())
        assert np.all(np.isfinite(state.flat))
        assert np.linalg.norm(state.q) == pytest.approx(1.0)
    assert largest <= 25.0
    for k in range(rate):
        state = f.update(Pose(at_rest), 20.0 + k / rate)
    np.testing.assert_allclose(state.p, at_rest[:3], atol=1e-3)
    assert np.linalg.norm(state.v) < 0.01
    assert angle(state, rotation_exponential(0.0, 0.0, 0.0)) < 1e-3
