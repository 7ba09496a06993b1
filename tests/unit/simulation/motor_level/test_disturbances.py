"""Slow random torques and forces, vibration in the sensors, and late poses."""

from itertools import pairwise

import numpy as np
import pytest

from crazychoir.platforms import CRAZYFLIE_21
from crazychoir.simulation.motor_level.crazyflies import CrazyflieWorld
from crazychoir.simulation.motor_level.disturbances import (
    Disturbances,
    DisturbedWrenches,
    ExternalWrenches,
)
from crazychoir.simulation.motor_level.imu import VIBRATING_IMU
from crazychoir.simulation.motor_level.motors import MotorConditions, MotorWorld
from crazychoir.simulation.motor_level.pose_delay import PoseDelay
from crazychoir.types import Pose

P = CRAZYFLIE_21
STRONG = Disturbances(torque=3.0, force=0.1, time=0.5)


def draw(ids, steps, resting=0.0, seed=1):
    still = ExternalWrenches(np.zeros((len(ids), 3)), np.zeros((len(ids), 3)))
    wrenches = DisturbedWrenches(still, ids, [P] * len(ids), STRONG, seed, 0.01)
    drawn = []
    for tick in range(steps):
        wrenches.advance(tick, np.full(len(ids), resting))
        drawn.append(np.hstack([wrenches.force, wrenches.torque]))
    return np.array(drawn)


def test_they_are_as_strong_and_as_slow_as_asked_from_the_first_step():
    drawn = draw(range(400), 100)
    inertia = np.array(P.inertia)
    wanted = [0.1 * P.mass] * 3 + list(3.0 * inertia * [1.0, 1.0, 1.0 / 3.0])
    np.testing.assert_allclose(drawn[0].std(axis=0), wanted, rtol=0.12)
    np.testing.assert_allclose(drawn[-1].std(axis=0), wanted, rtol=0.12)
    later = (drawn[0] * drawn[50]).mean(axis=0) / np.square(wanted)
    np.testing.assert_allclose(later, np.exp(-1.0), atol=0.15)


def test_a_drone_has_its_own_whatever_other_drones_are_there():
    np.testing.assert_array_equal(draw([3], 20)[:, 0], draw([0, 3, 9], 20)[:, 1])
    assert not np.array_equal(draw([3], 20), draw([3], 20, seed=2))


def test_a_drone_on_the_floor_feels_none():
    assert not draw(range(3), 5, resting=1.0).any()


def test_external_wrenches_are_kept():
    push = np.array([[1.0, 2.0, 3.0]])
    twist = np.array([[4.0, 5.0, 6.0]])
    external = ExternalWrenches(push, twist)
    wrenches = DisturbedWrenches(external, [0], [P], STRONG, 1, 0.01)
    wrenches.advance(0, np.ones(1))
    np.testing.assert_array_equal(wrenches.force, push)
    np.testing.assert_array_equal(wrenches.torque, twist)


def test_a_world_moves_by_them_and_by_what_is_outside():
    places = np.array([[0.0, 0.0, 20.0]])
    worlds = [
        MotorWorld([0], places, conditions=MotorConditions(disturbances=d), seed=3)
        for d in (None, STRONG)
    ]
    for world in worlds:
        for _ in range(30):
            world.step()
    calm, shaken = (world.state(0) for world in worlds)
    assert 1e-4 < np.linalg.norm(calm.p - shaken.p) < 0.05


@pytest.mark.parametrize(("z", "gyro", "acc"), [(0.0, 1.0, 1.0), (20.0, 4.6, 2.8)])
def test_sensors_vibrate_in_flight_alone(z, gyro, acc):
    """Densities in flight over those at rest: 1.1e-3 over 2.4e-4 rad/s/sqrt(Hz), 4.9e-3 over 1.9e-3 m/s2/sqrt(Hz)."""

    def deviations(imu):
        world = MotorWorld(
            range(8),
            np.array([[3.0 * i, 0.0, z] for i in range(8)]),
            dt=0.001,
            conditions=MotorConditions(imu=imu, has_downwash=False),
        )
        seen = []
        for _ in range(300):
            world.step()
            seen.append([[*world.gyro(i), *world.accelerometer(i)] for i in range(8)])
        fast = np.diff(seen, axis=0).std(axis=(0, 1))
        return fast[:3].mean(), fast[3:].mean()

    calm = deviations(VIBRATING_IMU.scaled(1.0, 0.0))
    shaken = deviations(VIBRATING_IMU)
    assert shaken[0] / calm[0] == pytest.approx(gyro, rel=0.05)
    assert shaken[1] / calm[1] == pytest.approx(acc, rel=0.05)


def arrivals(latency, jitter, frames=200):
    delay = PoseDelay(latency, jitter, 1, 0.01)
    found = {}
    for tick in range(frames + 20):
        if tick < frames:
            delay.send(tick, np.full((1, 7), tick), np.ones(1, bool))
        for flat, _ in delay.receive(tick):
            found[int(flat[0, 0])] = tick
    return [found[tick] - tick for tick in range(frames)]


def test_poses_are_late_by_latency_and_jitter_in_their_order():
    late = arrivals(0.03, 0.02)
    assert {1, 2, 3, 4, 5} >= set(late) >= {2, 3, 4}
    assert np.mean(late) == pytest.approx(3.3, abs=0.4)
    assert all(b >= a - 1 for a, b in pairwise(late))


def test_without_latency_and_jitter_they_arrive_in_their_step():
    assert set(arrivals(0.0, 0.0)) == {0}


def test_the_estimator_on_board_gets_a_late_pose_late():
    def first_step_at_two_metres(pose_delay):
        world = CrazyflieWorld([4], np.array([[0.0, 0.0, 0.0]]), pose_delay=pose_delay)
        world.link(4, "xyz")
        pose = Pose(np.array([2.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]))
        for step in range(20):
            world.see(4, pose)
            world.step()
            if world.log(4, "stateEstimate.x") > 0.1:
                return step
        raise AssertionError("the pose did not arrive")

    assert first_step_at_two_metres(None) + 4 == first_step_at_two_metres(
        PoseDelay(0.04, 0.0, 0, 0.01)
    )
