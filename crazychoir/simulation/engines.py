"""Choose the engine that simulates a drone by the uri of the drone.

Engines are entry points: the built-in engines and those of other packages alike.
"""

from collections.abc import Callable
from importlib.metadata import EntryPoint, entry_points
from typing import Any

import msgspec
import numpy as np

from crazychoir.config.calibrated import build_body, find_thrust_factor
from crazychoir.config.checks import (
    WORLD_ENTRY_POINTS,
    WORLD_STEP,
    WORLD_URIS,
)
from crazychoir.config.swarm_config import SwarmConfig
from crazychoir.config.tables import DroneTable, SwarmTable
from crazychoir.errors import ConfigError, CrazyChoirError, error_text
from crazychoir.platforms import find_platform
from crazychoir.simulation.common.mismatch import find_lightweight_platform
from crazychoir.simulation.common.world import World, WorldSetup
from crazychoir.simulation.lightweight.integrator import CFIntegrator, InputLags

Engine = Callable[[WorldSetup], World]

BUILT_IN_ENGINES = {
    WORLD_URIS.lightweight: EntryPoint(
        WORLD_URIS.lightweight,
        "crazychoir.simulation.engines:lightweight",
        WORLD_ENTRY_POINTS,
    ),
    WORLD_URIS.motor_level: EntryPoint(
        WORLD_URIS.motor_level,
        "crazychoir.simulation.engines:motors",
        WORLD_ENTRY_POINTS,
    ),
    WORLD_URIS.mujoco: EntryPoint(
        WORLD_URIS.mujoco,
        "crazychoir.simulation.mujoco.world:engine",
        WORLD_ENTRY_POINTS,
    ),
    WORLD_URIS.replay: EntryPoint(
        WORLD_URIS.replay, "crazychoir.recording.replay:engine", WORLD_ENTRY_POINTS
    ),
    WORLD_URIS.single_integrator: EntryPoint(
        WORLD_URIS.single_integrator,
        "crazychoir.simulation.lightweight.points:single_integrators",
        WORLD_ENTRY_POINTS,
    ),
    WORLD_URIS.double_integrator: EntryPoint(
        WORLD_URIS.double_integrator,
        "crazychoir.simulation.lightweight.points:double_integrators",
        WORLD_ENTRY_POINTS,
    ),
    WORLD_URIS.unicycle: EntryPoint(
        WORLD_URIS.unicycle,
        "crazychoir.simulation.lightweight.points:unicycles",
        WORLD_ENTRY_POINTS,
    ),
}


def lightweight(setup: WorldSetup) -> World:
    """Make a world with the paper's integrator."""
    homes = np.array(setup.homes, dtype=float)
    bodies = setup.build_bodies(find_lightweight_platform)
    return CFIntegrator(
        setup.ids,
        homes,
        np.array(setup.yaws),
        bodies,
        setup.dt,
        lags=InputLags(
            rates=setup.options["rate_lag"], delay=setup.options["command_delay"]
        ),
        inputs=setup.options["inputs"],
    )


def motors(setup: WorldSetup) -> World:
    """Make a world with rotors, batteries, sensors, air, and the firmware on board."""
    from crazychoir.simulation.motor_level.crazyflies import (
        CrazyflieWorld,  # kernels that a lightweight world does not need
    )

    return CrazyflieWorld.of(setup)


def make_worlds(config: SwarmConfig, ids: tuple[int, ...]) -> list[World]:
    """Make the worlds of these drones, one world an engine.

    Raises ConfigError if an engine is not available.
    """
    together: dict[str, list[DroneTable]] = {}
    for drone in (config.drone(i) for i in ids):
        together.setdefault(_entry_point(drone.uri).name, []).append(drone)
    return [_world(config, tuple(drones)) for drones in together.values()]


def count_delay_steps(config: SwarmConfig, world: World) -> int:
    """Return the number of world steps by which commands arrive late.

    It is 0 for the lightweight world, which has this delay in its own model.
    """
    return (
        0
        if isinstance(world, CFIntegrator)
        else round(config.plant.command_delay / world.dt)
    )


def _entry_point(uri: str) -> EntryPoint:
    """Return the entry point of the engine for a uri that the swarm file allows."""
    uri = WORLD_URIS.replay if uri.startswith(WORLD_URIS.replay) else uri
    return (
        BUILT_IN_ENGINES[uri]
        if uri in BUILT_IN_ENGINES
        else entry_points(group=WORLD_ENTRY_POINTS)[uri.partition("://")[0]]
    )


def _world(config: SwarmConfig, drones: tuple[DroneTable, ...]) -> World:
    """Make one world of these drones and check that it has the requested drones and step.

    Raises ConfigError if the engine fails or makes a different world.
    """
    uri = drones[0].uri
    ids = tuple(drone.id for drone in drones)
    entry = _entry_point(uri)
    setup = WorldSetup(
        ids=ids,
        uris=tuple(drone.uri for drone in drones),
        homes=tuple(drone.home for drone in drones),
        yaws=tuple(drone.yaw for drone in drones),
        platforms=tuple(find_platform(drone.platform) for drone in drones),
        options=_options(config, uri),
        wind=config.motors.wind,
        seed=config.seed,
        dt=WORLD_STEP,
        mass_error=config.plant.mass_error,
        thrust_error=config.plant.thrust_error,
        bodies=tuple(build_body(drone, config.motors.worn_battery) for drone in drones),
        thrust_factors=tuple(find_thrust_factor(drone) for drone in drones),
    )
    try:
        world: World = entry.load()(setup)
    except CrazyChoirError:
        raise
    except Exception as error:
        found = error_text(error)
        allowed = (
            f"an engine that makes a world: {entry.value} is a function of a WorldSetup"
        )
        raise ConfigError(
            f"uri {uri}",
            found,
            allowed,
            "Correct or update the package that it is from.",
        ) from error
    if (tuple(world.ids), world.dt) != (ids, setup.dt):
        found = f"a world of drones {list(world.ids)}, steps of {world.dt:g} s"
        asked = f"what it was asked for: {list(ids)}, {setup.dt:g} s"
        raise ConfigError(f"uri {uri}", found, asked, "Correct the engine.")
    return world


def _options(config: SwarmConfig, uri: str) -> dict[str, Any]:
    """Return the options of the swarm file that belong to the engine of this uri."""
    plant = config.plant
    motors = config.motors
    shapes = config.mujoco
    ours: dict[str, tuple[SwarmTable, ...]] = {
        WORLD_URIS.lightweight: (plant,),
        WORLD_URIS.motor_level: (motors,),
        WORLD_URIS.mujoco: (motors, shapes),
    }
    if uri not in ours:
        return config.world.options
    return {
        name: value
        for table in ours[uri]
        for name, value in msgspec.to_builtins(table).items()
    }
