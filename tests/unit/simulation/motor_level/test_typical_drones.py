"""The table [motors] of a swarm file makes typical drones, and switches each imperfection off."""

import msgspec
import numpy as np
import pytest

from crazychoir.config.swarm_config import SwarmConfig
from crazychoir.config.tables import MotorsTable
from crazychoir.platforms import CRAZYFLIE_21, BodyEffects
from crazychoir.simulation.common.world import WorldSetup
from crazychoir.simulation.engines import make_worlds
from crazychoir.simulation.motor_level.crazyflies import CrazyflieWorld
from crazychoir.types import Pose

PERFECT = {
    "speed_moment": 0.0,
    "rate_damping": 0.0,
    "imbalance": 0.0,
    "torque_disturbance": 0.0,
    "force_disturbance": 0.0,
    "vibration": 0.0,
    "pose_latency": 0.0,
    "pose_jitter": 0.0,
}
"""Keys that switch all imperfections off."""


def make_world(**changed):
    options = msgspec.to_builtins(MotorsTable(imperfections=1.0)) | changed
    return CrazyflieWorld.of(
        WorldSetup(
            ids=(2, 5),
            uris=("sim://motors",) * 2,
            homes=((0.0, 0.0, 0.0), (1.0, 0.0, 0.0)),
            yaws=(0.0, 0.0),
            platforms=(CRAZYFLIE_21,) * 2,
            options=options,
            wind=(0.0, 0.0, 0.0),
            seed=4,
            dt=0.01,
        )
    )


def fly_up(world):
    """Return the states after two seconds of flight to a place 0.5 m above the first drone's home."""
    for i in world.ids:
        world.link(i, "xyz").onboard.arm()
    for _ in range(200):
        for i in world.ids:
            x = world.state(i)
            world.see(i, Pose(np.concatenate([x.p, x.q])))
            world.onboard[i].setpoints.position((0.0, 0.0, 0.5), 0.0)
        world.step()
    return world.states.copy()


def test_without_imperfections_it_is_the_perfect_world():
    perfect = CrazyflieWorld(
        (2, 5), np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]]), seed=4
    )
    flown = fly_up(perfect)
    np.testing.assert_array_equal(fly_up(make_world(**PERFECT)), flown)
    np.testing.assert_array_equal(fly_up(make_world(imperfections=0.0)), flown)


@pytest.mark.parametrize("key", PERFECT)
def test_each_imperfection_alone_changes_the_flight(key):
    typical = getattr(MotorsTable(), key)
    assert typical > 0.0
    alone = fly_up(make_world(**PERFECT | {key: typical}))
    assert not np.array_equal(alone, fly_up(make_world(**PERFECT)))


def test_drones_of_one_swarm_differ():
    first, second = (body.effects for body in make_world().platforms)
    assert first.motor_factors != second.motor_factors
    assert first.speed_moment == second.speed_moment != BodyEffects().speed_moment


def test_a_worn_battery_is_an_option():
    drones = [{"id": 2, "home": [0.0, 0.0, 0.0], "uri": "sim://motors"}]
    batteries = []
    for is_worn in (True, False):
        motors = {"worn_battery": is_worn}
        config = SwarmConfig.of({"name": "a", "drones": drones, "motors": motors})
        (world,) = make_worlds(config, (2,))
        batteries.append(world.platforms[0].battery)
    worn, fresh = batteries
    assert worn == fresh.worn
    assert worn.capacity < 0.5 * fresh.capacity
