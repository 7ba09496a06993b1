"""Where a tracked body sits on its drone: its equations, there and back, and what is found by least squares."""

import math

import numpy as np
import pytest

from crazychoir.errors import ConfigError
from crazychoir.mocap.calibration import (
    estimate_from_rest,
    estimate_from_turn,
    mean_attitude,
    roll_pitch_yaw_of,
)
from crazychoir.mocap.mounting import Mounting, quaternion_of_rpy
from crazychoir.numerics.math3d import (
    quaternion_of_yaw,
    quaternion_product,
    rotation,
    rotation_exponential,
)

MOUNTINGS = [
    Mounting(),
    Mounting((0.0, 0.0, 0.03), (0.0, 0.0, 0.0)),
    Mounting((0.012, -0.02, 0.03), (0.05, -0.08, 1.9)),
]
TRIMMED_MOUNTING = Mounting((0.012, -0.02, 0.03), (0.05, -0.08, 1.9), (0.02, -0.03))


def random_pose(draw):
    q = draw.normal(size=4)
    return np.array([*draw.normal(size=3), *(q / np.linalg.norm(q))])


def rpy(roll, pitch, yaw):
    """R = Rz(yaw) Ry(pitch) Rx(roll), written out."""
    c, s = np.cos, np.sin
    x = np.array([[1, 0, 0], [0, c(roll), -s(roll)], [0, s(roll), c(roll)]])
    y = np.array([[c(pitch), 0, s(pitch)], [0, 1, 0], [-s(pitch), 0, c(pitch)]])
    z = np.array([[c(yaw), -s(yaw), 0], [s(yaw), c(yaw), 0], [0, 0, 1]])
    return z @ y @ x


def test_angles_are_those_of_their_rotation_and_back():
    for roll, pitch, yaw in [(0.1, -0.2, 3.0), (-1.0, 1.2, -2.0), (0.0, 0.0, 0.0)]:
        q = quaternion_of_rpy((roll, pitch, yaw))
        np.testing.assert_allclose(rotation(q), rpy(roll, pitch, yaw), atol=1e-12)
        np.testing.assert_allclose(roll_pitch_yaw_of(q), (roll, pitch, yaw), atol=1e-12)


@pytest.mark.parametrize("mounting", [*MOUNTINGS, TRIMMED_MOUNTING])
def test_the_body_is_where_its_equation_says(mounting):
    """q_b = q q_t q_m,  p_b = p + R(q) o; and the drone is found again."""
    draw = np.random.default_rng(0)
    for _ in range(10):
        drone = random_pose(draw)
        body = mounting.body(drone)
        np.testing.assert_allclose(
            body[0:3], drone[0:3] + rotation(drone[3:7]) @ mounting.offset, atol=1e-12
        )
        np.testing.assert_allclose(
            rotation(body[3:7]),
            rotation(drone[3:7]) @ rpy(*mounting.trim, 0.0) @ rpy(*mounting.rotation),
            atol=1e-12,
        )
        again = mounting.drone(body)
        np.testing.assert_allclose(again[0:3], drone[0:3], atol=1e-12)
        np.testing.assert_allclose(
            rotation(again[3:7]), rotation(drone[3:7]), atol=1e-12
        )


def test_the_mean_attitude_is_nearest_to_all_whatever_their_signs():
    draw = np.random.default_rng(1)
    q = quaternion_of_rpy((0.3, -0.4, 2.0))
    noisy = np.array(
        [
            quaternion_product(
                tuple(q), rotation_exponential(*draw.normal(0.0, 0.05, 3))
            )
            for _ in range(400)
        ]
    )
    noisy *= draw.choice([-1.0, 1.0], 400)[:, None]
    mean = mean_attitude(noisy)
    np.testing.assert_allclose(roll_pitch_yaw_of(mean), (0.3, -0.4, 2.0), atol=0.01)
    value = np.sum((noisy @ mean) ** 2)
    others = [
        quaternion_product(tuple(mean), rotation_exponential(*d))
        for d in 0.01 * np.vstack([np.eye(3), -np.eye(3)])
    ]
    assert all(np.sum((noisy @ np.array(other)) ** 2) < value for other in others)


def noisy(poses, draw, place=0.0005, angle=0.002):
    out = np.array(poses)
    out[:, 0:3] += draw.normal(0.0, place, (len(out), 3))
    out[:, 3:7] = [
        quaternion_product(tuple(q), rotation_exponential(*draw.normal(0.0, angle, 3)))
        for q in out[:, 3:7]
    ]
    return out


@pytest.mark.parametrize("heading", [0.0, 2.5])
def test_a_level_drone_shows_how_its_body_is_tilted(heading):
    mounting = MOUNTINGS[2]
    drone = np.array([1.0, 2.0, 0.1, *quaternion_of_yaw(heading)])
    poses = noisy([mounting.body(drone)] * 300, np.random.default_rng(2))
    found = estimate_from_rest(poses, 0.1, heading)
    np.testing.assert_allclose(found.rotation, mounting.rotation, atol=5e-4)
    assert found.height == pytest.approx(0.03, abs=1e-4)
    assert found.spread == pytest.approx(0.0005 * math.sqrt(3.0), rel=0.1)
    np.testing.assert_allclose(
        estimate_from_rest(poses, 0.1, yaw=0.7).rotation,
        (*mounting.rotation[0:2], 0.7),
        atol=5e-4,
    )


def turning(mounting, angle, drift=(0.0, 0.0, 0.0), seed=3):
    draw, times = np.random.default_rng(seed), np.linspace(0.0, 20.0, 1000)
    drones = []
    for t in times:
        tilt = rotation_exponential(*draw.normal(0.0, 0.01, 2), 0.0)
        q = quaternion_product(tuple(quaternion_of_yaw(0.4 + angle * t / 20.0)), tilt)
        drones.append(
            np.array([0.3, -0.2, 1.0, *q])
            + np.array([*(np.array(drift) * t), 0, 0, 0, 0])
        )
    return times, noisy([mounting.body(drone) for drone in drones], draw)


@pytest.mark.parametrize("mounting", MOUNTINGS)
@pytest.mark.parametrize("angle", [2.0 * math.pi, -1.2 * math.pi])
def test_a_turn_shows_how_far_from_its_centre_the_body_is(mounting, angle):
    """Also of a drone that drifts by 10 cm meanwhile; to what the fit says of itself."""
    times, poses = turning(mounting, angle, (0.005, -0.003, 0.001))
    found = estimate_from_turn(times, poses, mounting.rotation, mounting.offset[2])
    error = math.dist(found.offset, mounting.offset)
    assert error < 3.0 * found.error < 5e-4
    assert found.deviation == pytest.approx(0.0005, rel=0.1)
    assert found.angle == pytest.approx(abs(angle), abs=0.1)


def test_what_says_too_little_is_refused():
    times, poses = turning(MOUNTINGS[2], 2.0)
    with pytest.raises(
        ConfigError, match=r"a turn of 11\d deg; allowed: 180 deg or more"
    ):
        estimate_from_turn(times, poses, (0.0, 0.0, 0.0), 0.0)
    with pytest.raises(ConfigError, match="Put it down"):
        estimate_from_rest(poses, 0.0)
    with pytest.raises(ConfigError, match="10 poses; allowed: 20 or more"):
        estimate_from_rest(poses[:10], 0.0)
