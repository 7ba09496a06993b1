"""What goes to MuJoCo and comes back: mean wrenches, places between velocities, speeds of impact; and free flight."""

import mujoco
import numpy as np
import pytest

from crazychoir.numerics.math3d import STANDARD_GRAVITY, rotation, rotation_exponential
from crazychoir.platforms import CRAZYFLIE_21, CRAZYFLIE_21_BRUSHLESS
from crazychoir.simulation.motor_level.crazyflies import CrazyflieWorld
from crazychoir.simulation.motor_level.imu import Imu
from crazychoir.simulation.motor_level.motors import MotorConditions
from crazychoir.simulation.mujoco.world import MujocoWorld
from crazychoir.simulation.mujoco.wrench import (
    find_contacts,
    read_joint_states,
    write_mean_wrenches,
)

H = 0.001
STILL = Imu(0.0, 0.0, 0.0, 0.0)
BEFORE = np.array(
    [
        [
            0.3,
            -0.2,
            2.0,
            0.8,
            -0.5,
            0.9,
            *rotation_exponential(0.2, -0.3, 0.5),
            2.0,
            -3.0,
            4.0,
        ]
    ]
)
CHANGE = np.array([0.004, -0.006, 0.01]), np.array([0.05, -0.04, 0.06])


def body(platform):
    spec = mujoco.MjSpec()
    spec.option.timestep, spec.option.gravity = H, [0, 0, -STANDARD_GRAVITY]
    one = spec.worldbody.add_body()
    one.add_freejoint()
    one.explicitinertial, one.ipos, one.iquat = True, [0, 0, 0], [1, 0, 0, 0]
    one.mass, one.inertia = platform.mass, platform.inertia
    model = spec.compile()
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:] = (
        BEFORE[0, [0, 1, 2, 9, 6, 7, 8]],
        BEFORE[0, [3, 4, 5, 10, 11, 12]],
    )
    return model, data


@pytest.mark.parametrize(
    "platform", [CRAZYFLIE_21, CRAZYFLIE_21_BRUSHLESS], ids=lambda row: row.name
)
def test_the_mean_wrench_brings_mujoco_to_the_velocities_that_it_was_made_of(platform):
    model, data = body(platform)
    after = BEFORE.copy()
    after[0, 3:6] += CHANGE[0]
    after[0, 10:13] += CHANGE[1]
    inertia = np.array([[platform.mass, *platform.inertia]])
    write_mean_wrenches(BEFORE, after, inertia, np.array([1]), H, data.xfrc_applied)
    r, j = rotation(BEFORE[0, 6:10]), np.array(platform.inertia)
    w = BEFORE[0, 10:13]
    force = platform.mass * (CHANGE[0] / H + [0, 0, STANDARD_GRAVITY])
    torque = r @ (j * CHANGE[1] / H + np.cross(w, j * w))
    np.testing.assert_allclose(data.xfrc_applied[1], [*force, *torque], rtol=1e-9)
    mujoco.mj_step(model, data)
    np.testing.assert_allclose(data.qvel[:3], after[0, 3:6], atol=1e-12)
    np.testing.assert_allclose(data.qvel[3:], after[0, 10:13], atol=1e-9)


def test_places_go_on_by_the_mean_of_two_velocities():
    v, w = BEFORE[0, 3:6] + CHANGE[0], BEFORE[0, 10:13] + CHANGE[1]
    world = CrazyflieWorld([0], np.array([[0.0, 0.0, 1.0]]))
    after = np.zeros((1, 13))
    read_joint_states(
        BEFORE,
        np.array([*v, *w]),
        np.array([0]),
        H,
        np.array([1.0, 2.0, 3.0]),
        after,
        world._lanes,
    )
    x = BEFORE[0]
    np.testing.assert_allclose(after[0, :3], x[:3] + H * (x[3:6] + v) / 2, atol=1e-15)
    np.testing.assert_allclose(after[0, [3, 4, 5, 10, 11, 12]], [*v, *w])
    turned = rotation(x[6:10]) @ rotation(
        np.array(rotation_exponential(*(H * (x[10:13] + w) / 2)))
    )
    np.testing.assert_allclose(rotation(after[0, 6:10]), turned, atol=1e-14)


def test_the_speed_of_an_impact_is_that_of_two_points_along_the_normal():
    rng = np.random.default_rng(1)
    twists, centres = rng.normal(size=(3, 6)), rng.normal(size=(3, 3))
    p, n = rng.normal(size=3), np.array([0.6, 0.0, 0.8])
    v = [twists[b, 3:] + np.cross(twists[b, :3], p - centres[b]) for b in range(3)]
    touching, impact, against = np.zeros(1), np.zeros(1), np.zeros(1, np.int64)
    for geoms in ((1, 2), (2, 1)):
        impact[:] = 0.0
        find_contacts(
            np.array([geoms], np.int32),
            p[None],
            np.array([[*n, *np.zeros(6)]]),
            np.array([0, 1, 2], np.int32),
            np.array([0, 1, 2], np.int32),
            twists,
            centres,
            np.array([-1, 0, -1]),
            touching,
            impact,
            against,
        )
        assert impact[0] == pytest.approx(max(n @ (v[geoms[0]] - v[geoms[1]]), 0.0))
        assert touching[0] == 1.0
    assert against[0] == 2


class EachMillisecond(CrazyflieWorld):
    """The motor level with its battery asked in each millisecond, as MujocoWorld does."""

    def _advance(self, time, steps):
        if steps == 0:
            super()._advance(time, 0)
        for k in range(steps):
            super()._advance(time + k, 1)


def flown(kind, seconds):
    world = kind(
        [0], np.array([[0.0, 0.0, 20.0]]), conditions=MotorConditions(imu=STILL)
    )
    link, draw, states = world.link(0), np.random.default_rng(0), []
    link.onboard.setpoints.fpqr(0.0, 0.0, 0.0, 0.0)
    for k in range(round(seconds * 100)):
        if k % 10 == 0:
            u = (
                CRAZYFLIE_21.weight * draw.uniform(0.8, 1.3),
                *draw.uniform(-4.0, 4.0, 3),
            )
        link.onboard.setpoints.fpqr(*u)
        world.step()
        states.append(world.states[0].copy())
    return np.array(states)


def test_two_seconds_of_aggressive_free_flight_are_those_of_the_motor_level_to_a_twentieth_of_a_millimetre():
    """Measured: 6e-6 m after 1 s, 3.4e-5 m after 2 s."""
    expected, found = flown(EachMillisecond, 2.0), flown(MujocoWorld, 2.0)
    assert np.abs(expected[:, 10:12]).max() > 3.5
    assert np.abs(expected[:, 3:6]).max() > 5.0
    apart = np.linalg.norm(found[:, :3] - expected[:, :3], axis=1)
    assert apart[100] < 1e-5, apart[100]
    assert apart.max() < 5e-5, apart.max()
