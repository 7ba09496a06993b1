"""The Kalman filter measures the noise of the positions, in flight and with lost poses."""

import math

import numpy as np
import pytest

from crazychoir.filters.kalman import KalmanFilter, KalmanNoise
from crazychoir.filters.motion import CommandedMotion
from crazychoir.filters.place_noise import PLACE_NOISE
from crazychoir.platforms import PAPER_PLATFORM
from crazychoir.types import Pose

RADIUS = 0.6
TURN_RATE = 3.0  # rad/s: 1.8 m/s


def fly_circle(f, rate, noise, seconds=8.0, is_lost=lambda k: False):
    draw = np.random.default_rng(3)
    for k in range(round(seconds * rate)):
        t = k / rate
        p = RADIUS * np.array([math.cos(TURN_RATE * t), math.sin(TURN_RATE * t), 2.0])
        p += noise * draw.standard_normal(3)
        if is_lost(k):
            f.predict(t)
        else:
            f.update(Pose(np.array([*p, 0.0, 0.0, 0.0, 1.0])), t)
    return f


def measured_noise(f):
    return math.sqrt(f._row["place_variance"])


@pytest.mark.parametrize("rate", [50, 100, 240])
@pytest.mark.parametrize("noise", [1e-4, 5e-4, 1e-3])
def test_the_noise_of_the_cameras_is_measured_while_the_drone_flies_fast(rate, noise):
    f = fly_circle(KalmanFilter(period=1 / rate), rate, noise)
    assert measured_noise(f) == pytest.approx(noise, rel=0.2)


@pytest.mark.parametrize("rate", [25, 50, 100, 240])
def test_poses_without_noise_on_the_floor_are_forgotten_alike_at_all_rates(rate):
    """Rounded poses of a drone that stands do not change; it needs seconds, not a number of poses, to learn more."""
    f = KalmanFilter(period=1 / rate)
    draw = np.random.default_rng(1)
    for k in range(4 * rate):
        f.update(Pose(np.array([0.0, 0, 0, 0, 0, 0, 1])), k / rate)
    assert measured_noise(f) == pytest.approx(PLACE_NOISE.least)
    for k in range(4 * rate, 7 * rate):
        p = [0.0, 0.0, 0.5] + 5e-4 * draw.standard_normal(3)
        f.update(Pose(np.array([*p, 0, 0, 0, 1])), k / rate)
    assert measured_noise(f) == pytest.approx(5e-4, rel=0.3)


def test_lost_poses_are_not_taken_for_noise():
    f = fly_circle(
        KalmanFilter(period=0.01), 100, 1e-4, is_lost=lambda k: k % 7 in (2, 3)
    )
    assert measured_noise(f) == pytest.approx(1e-4, rel=0.2)


def test_the_way_flown_in_a_long_gap_is_not_taken_for_noise():
    before = fly_circle(KalmanFilter(period=0.01), 100, 1e-4, seconds=7.0)
    after = fly_circle(
        KalmanFilter(period=0.01), 100, 1e-4, 7.86, is_lost=lambda k: 700 <= k < 780
    )
    assert after._row["even_poses"] == 5
    assert measured_noise(after) == pytest.approx(measured_noise(before), rel=0.05)


def test_cameras_without_noise_count_as_the_best():
    f = fly_circle(KalmanFilter(period=0.01), 100, 0.0)
    assert measured_noise(f) == pytest.approx(PLACE_NOISE.least)


def test_a_wrong_pose_that_is_accepted_hardly_counts():
    f = fly_circle(KalmanFilter(period=0.01), 100, 1e-4, seconds=4.0)
    before = measured_noise(f)
    t = 4.0
    p = RADIUS * np.array([math.cos(TURN_RATE * t), math.sin(TURN_RATE * t), 2.0])
    f.update(Pose(np.array([p[0], p[1], p[2] + 0.006, 0.0, 0.0, 0.0, 1.0])), t)
    assert f.refused == 0
    assert before < measured_noise(f) < 1.1 * before


def test_a_filter_with_a_given_noise_measures_none():
    f = KalmanFilter(period=0.01, noise=KalmanNoise(place=3e-4))
    fly_circle(f, 100, 1e-4, seconds=1.0)
    assert measured_noise(f) == pytest.approx(3e-4)


def test_a_filter_that_knows_the_commands_measures_the_noise_too():
    motion = CommandedMotion(PAPER_PLATFORM.flat, 0.0)
    f = fly_circle(KalmanFilter(period=0.01, motion=motion), 100, 1e-4)
    assert measured_noise(f) == pytest.approx(1e-4, rel=0.2)


def test_no_pose_is_refused_after_gaps_in_a_fast_turn():
    f = fly_circle(
        KalmanFilter(period=0.01), 100, 1e-4, is_lost=lambda k: k % 100 >= 80
    )
    assert f.refused == 0
