"""The world mujoco://: masses, sensors, contacts with the floor, each other and a scene; options that are refused."""

import importlib
import math
import sys

import mujoco
import numpy as np
import pytest

from crazychoir.config.checks import WORLD_URIS
from crazychoir.config.digest import compute_digest
from crazychoir.config.swarm_config import SwarmConfig
from crazychoir.errors import ConfigError
from crazychoir.numerics.math3d import STANDARD_GRAVITY
from crazychoir.platforms import CRAZYFLIE_21, PLATFORM_BY_NAME
from crazychoir.simulation.engines import make_worlds
from crazychoir.simulation.motor_level.imu import Imu
from crazychoir.simulation.motor_level.motors import MotorConditions
from crazychoir.simulation.mujoco.model import body_name
from crazychoir.simulation.mujoco.shape import CRAZYFLIE_LOOK
from crazychoir.simulation.mujoco.world import MujocoWorld

STILL = Imu(0.0, 0.0, 0.0, 0.0)
SCENE = """<mujoco><worldbody><geom name="wall" type="box" size="0.05 1 1" pos="1 0 1"/>
  <body name="ball" pos="5 0 1"><freejoint/><geom size="0.05"/></body></worldbody>
  <keyframe><key qpos="5 0 1 1 0 0 0"/></keyframe></mujoco>"""


def swarm(n=1, **tables):
    """Drones one metre apart, one a platform."""
    names = list(PLATFORM_BY_NAME)
    drones = [
        {
            "id": 3 + k,
            "home": [float(k), 0.0, 0.0],
            "uri": WORLD_URIS.mujoco,
            "platform": names[k % len(names)],
        }
        for k in range(n)
    ]
    fence = {"min": [-5.0, -5.0, 0.0], "max": [5.0, 5.0, 3.0]}
    perfect = {"imperfections": 0.0}
    whole = {"name": "a", "drones": drones, "fence": fence, "motors": perfect}
    return SwarmConfig.of({**whole, **tables})


def in_mujoco(n=1, **tables):
    (world,) = make_worlds(swarm(n, **tables), tuple(range(3, 3 + n)))
    return world


def falling(*states, **options):
    """Return a world of drones with cut motors, from these p and v."""
    world = MujocoWorld(
        range(len(states)),
        np.array([p for p, _ in states], float),
        conditions=MotorConditions(imu=STILL),
        **options,
    )
    for row, (_, v) in enumerate(states):
        world.states[row, 3:6] = v
        world.cut(row)
    return world


def run(world, seconds):
    for _ in range(round(seconds / world.dt)):
        world.step()
    return world


def test_masses_and_inertias_are_those_of_the_platforms_and_of_what_they_are_off_by():
    world = in_mujoco(5, plant={"mass_error": 0.1})
    for i, platform in zip(world.ids, PLATFORM_BY_NAME.values(), strict=True):
        body = world.model.body(body_name(i))
        assert body.mass[0] == pytest.approx(1.1 * platform.mass, rel=1e-12)
        assert body.subtreemass[0] == body.mass[0]
        np.testing.assert_allclose(
            sorted(body.inertia), sorted(platform.inertia), rtol=1e-9
        )
        np.testing.assert_array_equal(body.ipos, 0.0)


def test_a_drone_that_stands_stays_and_feels_its_weight():
    world = run(in_mujoco(2), 1.0)
    assert np.abs(world.states[:, :2] - [[0, 0], [1, 0]]).max() < 1e-6
    assert np.abs(world.states[:, 2]).max() < 2e-4
    assert np.abs(world.states[:, 3:6]).max() < 1e-6
    assert world.resting(3)
    assert (world.crashed, world.harm(3)) == ([], "")
    sensed = world.sensed(4)
    np.testing.assert_allclose(
        sensed["accelerometer"], [0, 0, STANDARD_GRAVITY], atol=1e-3
    )
    np.testing.assert_allclose(
        sensed["position"], [1, 0, CRAZYFLIE_LOOK.centre_height], atol=2e-4
    )
    np.testing.assert_allclose(sensed["gyro"], 0.0, atol=1e-6)


def test_a_dropped_drone_hits_the_floor_bounces_and_rests_there():
    world = falling(([0, 0, 0.3], [0, 0, 0]))
    heights, fastest = [], 0.0
    for _ in range(150):
        world.step()
        heights.append(world.states[0, 2])
        fastest = max(fastest, -world.states[0, 5])
    lands = int(np.argmin(heights[:40]))
    assert max(heights[lands:]) > 0.002, "it bounces"
    assert fastest <= world.impact[0] <= fastest + STANDARD_GRAVITY * world.dt
    assert 2.0 < fastest < math.sqrt(2 * STANDARD_GRAVITY * 0.3), (
        "its rotors slow down while it falls"
    )
    assert (
        world.harm(0)
        == f"crashed: hit the floor at {world.impact[0]:.2f} m/s, allowed 1 m/s"
    )
    assert world.resting(0)
    assert abs(heights[-1]) < 3e-4


def test_two_that_collide_bounce_apart_and_are_broken_by_each_other():
    world = run(falling(([0, 0, 5], [0.8, 0, 0]), ([0.2, 0, 5], [-0.8, 0, 0])), 0.3)
    v = world.states[:, 3]
    assert v[0] + v[1] == pytest.approx(0.0, abs=1e-2), "momentum"
    assert 0.1 < (v[1] - v[0]) / 1.6 < 0.3, "of the speed is left"
    assert world.states[1, 0] - world.states[0, 0] > 2 * CRAZYFLIE_21.radius
    assert world.harm(0).startswith("crashed: hit drone 1 at 1.5"), world.harm(0)
    assert world.harm(1).startswith("crashed: hit drone 0 at 1.5")


def test_what_stands_in_the_room_is_hit_by_its_name_and_what_lies_there_falls(tmp_path):
    (tmp_path / "room.xml").write_text(SCENE)
    world = run(falling(([0, 0, 1], [3, 0, 0]), scene=tmp_path / "room.xml"), 0.5)
    assert world.states[0, 0] < 0.95
    assert world.harm(0).startswith("crashed: hit wall at 2.")
    ball = world.data.body("scene/ball").xpos
    assert ball[2] < 0.3


def test_equal_seeds_give_equal_flights_and_another_seed_another_flight():
    def flown(seed):
        world = MujocoWorld([0, 1], np.array([[0, 0, 1], [0.1, 0, 1.2]]), seed=seed)
        for i in (0, 1):
            world.link(i).onboard.setpoints.fpqr(0.0, 0.0, 0.0, 0.0)
            world.link(i).onboard.setpoints.fpqr(0.3, 0.1, 0.0, 0.0)
        return run(world, 0.6).states.tobytes()

    assert flown(1) == flown(1) != flown(2)


def test_what_mujoco_cannot_do_or_read_is_refused(tmp_path):
    with pytest.raises(
        ConfigError, match=r"motors.floor_tilt: found .*in MuJoCo the floor is level"
    ):
        in_mujoco(motors={"floor_tilt": [0.1, 0.0]})
    with pytest.raises(
        ConfigError, match=r"mujoco.scene .*room.xml: found no such file"
    ):
        in_mujoco(mujoco={"scene": str(tmp_path / "room.xml")})
    (tmp_path / "room.xml").write_text(
        '<mujoco><worldbody><geom type="nothing"/></worldbody></mujoco>'
    )
    with pytest.raises(ConfigError, match=r"mujoco.scene .*MuJoCo says"):
        in_mujoco(mujoco={"scene": str(tmp_path / "room.xml")})


def test_files_of_shapes_are_relative_to_the_swarm_file(tmp_path):
    config = swarm(mujoco={"model": "../drone.stl", "scene": "room.xml"})
    (tmp_path / "lab").mkdir()
    (tmp_path / "lab" / "swarm.json").write_text(config.dumps())
    loaded = SwarmConfig.load(tmp_path / "lab" / "swarm.json")
    assert loaded.mujoco.model == str(tmp_path / "drone.stl")
    assert loaded.mujoco.scene == str(tmp_path / "lab" / "room.xml")
    assert compute_digest(loaded) == compute_digest(config), (
        "hosts that have them in other folders agree"
    )
    assert compute_digest(loaded) != compute_digest(
        swarm(mujoco={"model": "other.stl", "scene": "room.xml"})
    )


def test_without_mujoco_it_is_said_how_to_get_it(monkeypatch):
    for name in [
        name for name in sys.modules if name.startswith("crazychoir.simulation.mujoco")
    ]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "mujoco", None)
    with pytest.raises(ConfigError, match=r"pip install 'crazychoir\[mujoco\]'"):
        in_mujoco()
    monkeypatch.undo()
    assert importlib.import_module("mujoco") is mujoco
