import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from crazychoir.config.swarm_config import SwarmConfig
from crazychoir.config.tables import MocapTable
from crazychoir.mocap.simulated import CameraErrors, SimulatedMocap
from crazychoir.numerics.math3d import (
    quaternion_conjugate,
    quaternion_product,
    rotation,
    rotation_logarithm,
)


def truth(ids):
    x = np.zeros((len(ids), 13))
    x[:, 0] = ids
    x[:, 9] = 1.0
    return x


def test_the_errors_of_the_cameras_are_those_of_the_swarm_file():
    table = MocapTable(
        noise=0.001,
        noise_angle=0.02,
        dropout=0.1,
        latency=0.04,
        rate=50.0,
        tilt=(0.1, -0.2),
        tilt_spread=0.01,
    )
    errors = CameraErrors.of(table)
    assert errors == CameraErrors(0.001, 0.02, 0.1, 2, (0.1, -0.2), 0.01)


def test_what_is_drawn_depends_on_seed_tick_and_id_alone():
    calls = SimulatedMocap(range(4), 3)
    for k in range(5):
        last = calls.sample(truth(range(4)), k)
    alone = SimulatedMocap([2], 3).sample(truth([2]), 4)
    np.testing.assert_array_equal(alone.flat[0], last.flat[2])
    other = SimulatedMocap([2], 4).sample(truth([2]), 4)
    assert not np.array_equal(other.flat[0], last.flat[2])


def test_the_draws_of_an_exposure_are_those_of_a_new_generator():
    mocap = SimulatedMocap([2, 0], 3, CameraErrors(1.0, 0.0))
    for tick in (7, 5, 7):
        drawn = np.random.Generator(np.random.Philox(key=[3, tick]))
        noise = drawn.standard_normal((3, 7))[[2, 0], 0:3]
        frame = mocap.sample(truth([2, 0]), tick)
        np.testing.assert_array_equal(frame.flat[:, 0:3], truth([2, 0])[:, 0:3] + noise)


@pytest.mark.parametrize("seed", [1 << 63, (1 << 64) - 2, 1 << 200])
def test_large_seeds_differ_from_their_neighbours(seed):
    noises = [
        SimulatedMocap([0], s, CameraErrors(1.0, 0.0)).sample(truth([0]), 0).flat[0, 0]
        for s in (seed, seed + 1)
    ]
    assert noises[0] != noises[1]


def test_the_noise_has_the_asked_deviations():
    mocap = SimulatedMocap(range(50), 0, CameraErrors(noise_p=0.001, noise_angle=0.01))
    flat = np.concatenate([mocap.sample(truth(range(50)), k).flat for k in range(100)])
    at = np.tile(np.arange(50.0), 100)
    assert np.std(flat[:, 0] - at) == pytest.approx(0.001, rel=0.05)
    turns = np.array(
        [
            rotation_logarithm(
                quaternion_product(quaternion_conjugate((0.0, 0.0, 0.0, 1.0)), tuple(q))
            )
            for q in flat[:, 3:]
        ]
    )
    np.testing.assert_allclose(np.std(turns, axis=0), 0.01, rtol=0.05)


def test_dropouts_are_independent_of_each_other_and_as_frequent_as_asked():
    mocap = SimulatedMocap(range(20), 0, CameraErrors(dropout=0.3))
    gone = np.array([~mocap.sample(truth(range(20)), k).seen for k in range(1000)])
    assert gone.mean() == pytest.approx(0.3, abs=0.01)
    between = np.corrcoef(gone.T)[np.triu_indices(20, 1)]
    assert np.abs(between).max() < 0.15


def test_poses_arrive_late_with_their_age():
    mocap = SimulatedMocap([0], 0, CameraErrors(0.0, 0.0, latency_steps=3))
    x, seen = truth([0]), []
    for k in range(6):
        x[0, 0] = k
        seen.append(mocap.sample(x, k))
    assert seen[:3] == [None, None, None]
    assert [frame.flat[0, 0] for frame in seen[3:]] == [0.0, 1.0, 2.0]
    assert seen[3].age == pytest.approx(0.03)


def test_a_body_that_is_mounted_askew_is_seen_turned_by_the_same_angles_whatever_way_the_drone_looks():
    x = truth([0, 1])
    x[:, 6:10] = [[0.1, -0.2, 0.3, np.sqrt(0.86)], [0.0, 0.0, 0.9, np.sqrt(0.19)]]
    mocap = SimulatedMocap([0, 1], 0, CameraErrors(0.0, 0.0, tilt=(0.02, -0.05)))
    frame = mocap.sample(x, 0)
    for row, pose in zip(x, (frame.pose(0), frame.pose(1)), strict=True):
        r = rotation(row[6:10]).T @ rotation(pose.q)
        # R = Ry(pitch) Rx(roll): its last row is (-sin pitch, cos pitch sin roll, cos pitch cos roll), its first column
        # (cos pitch, 0, -sin pitch).
        np.testing.assert_allclose(
            r[2],
            [-np.sin(-0.05), np.cos(0.05) * np.sin(0.02), np.cos(0.05) * np.cos(0.02)],
        )
        np.testing.assert_allclose(
            r[:, 0], [np.cos(0.05), 0.0, np.sin(0.05)], atol=1e-15
        )
        np.testing.assert_array_equal(pose.p, row[0:3])


def test_bodies_are_mounted_askew_by_angles_of_their_own():
    errors = CameraErrors(0.0, 0.0, tilt_spread=0.01)
    frame = SimulatedMocap(range(400), 3, errors).sample(truth(range(400)), 0)
    angles = Rotation.from_quat(frame.flat[:, 3:]).as_euler("ZYX")
    yaw, *tilts = (angles - Rotation.from_quat(truth([0])[0, 6:10]).as_euler("ZYX")).T
    np.testing.assert_allclose(yaw, 0.0, atol=2e-4)
    np.testing.assert_allclose(np.std(tilts, axis=1), 0.01, rtol=0.1)
    alone = SimulatedMocap([7], 3, errors).sample(truth([7]), 5)
    np.testing.assert_array_equal(alone.flat[0, 3:], frame.flat[7, 3:])


def test_a_calibrated_drone_is_seen_with_the_noise_that_was_found():
    drones = [
        {"id": 0, "home": [0.0, 0.0, 0.0]},
        {
            "id": 1,
            "home": [1.0, 0.0, 0.0],
            "calibration": {"noise": [0.001, 0.02, 0.0]},
        },
    ]
    config = SwarmConfig.of({"name": "a", "drones": drones, "mocap": {"noise": 2e-4}})
    mocap = SimulatedMocap.of(config, (1, 0))
    np.testing.assert_array_equal(mocap.noises, [[0.001, 0.02], [2e-4, 0.00175]])
    plain = SimulatedMocap((1, 0), config.seed, CameraErrors.of(config.mocap))
    far, near = mocap.sample(truth([1, 0]), 0).flat
    expected, same = plain.sample(truth([1, 0]), 0).flat
    np.testing.assert_array_equal(near, same)
    np.testing.assert_allclose(far[:3] - [1, 0, 0], 5.0 * (expected[:3] - [1, 0, 0]))
