"""The bodies of virtual drones: a motor-level world with the firmware on board, from a swarm file or on a grid."""

from collections.abc import Sequence

import msgspec

from crazychoir.platforms import platform
from crazychoir.simulation.crazyflies import CrazyflieWorld
from crazychoir.simulation.world import WorldSetup
from crazychoir.swarm.checks import WORLD_STEP
from crazychoir.swarm.config import SwarmConfig
from crazychoir.swarm.tables import Drone


def world_of(config: SwarmConfig, drones: Sequence[Drone], seed: int) -> CrazyflieWorld:
    """These drones of a swarm, at home, of their platforms, with the swarm's [motors]."""
    return CrazyflieWorld.of(
        WorldSetup(
            ids=tuple(drone.id for drone in drones),
            uris=tuple(drone.uri for drone in drones),
            homes=tuple(drone.home for drone in drones),
            yaws=tuple(drone.yaw for drone in drones),
            platforms=tuple(platform(drone.platform) for drone in drones),
            options=msgspec.to_builtins(config.motors),
            wind=config.motors.wind,
            seed=seed,
            dt=WORLD_STEP,
            mass_error=config.plant.mass_error,
            thrust_error=config.plant.thrust_error,
        )
    )
