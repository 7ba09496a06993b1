"""The files that a swarm file names, with their full paths."""

from pathlib import Path
from typing import TypeVar

import msgspec

from crazychoir.config.checks import WORLD_URIS, is_secured
from crazychoir.config.tables import DroneTable, Swarm
from crazychoir.errors import ConfigError
from crazychoir.files.path_texts import as_path

AnySwarm = TypeVar("AnySwarm", bound=Swarm)
FILE_OPTIONS = ("instance", "drawing")
"""Options of missions that name a file."""
SHAPE_FILE_KEYS = ("model", "scene")
"""Keys of [mujoco] that name a file; only the host of the world's owner needs these files."""


def resolve_paths(swarm: AnySwarm, folder: Path) -> AnySwarm:
    """Return the swarm with the full paths of its files.

    folder: folder to which the paths in the swarm are relative
    """
    swarm = resolve_mission(swarm, folder)
    swarm = _resolve_files(swarm, folder)
    swarm = _resolve_shapes(swarm, folder)
    return _resolve_keys(swarm, folder)


def list_files(swarm: Swarm) -> dict[str, Path]:
    """Return the files that a flight needs in addition to its mission, by the keys that name them."""
    options = swarm.mission_options
    mujoco = swarm.mujoco
    named = {
        f"mission_options.{key}": options[key]
        for key in FILE_OPTIONS
        if isinstance(options.get(key), str)
    }
    named |= {
        f"mujoco.{key}": name
        for key in SHAPE_FILE_KEYS
        if (name := getattr(mujoco, key))
    }
    for drone in swarm.drones:
        if drone.uri.startswith(WORLD_URIS.replay):
            named[f"drone {drone.id}: uri"] = drone.uri.removeprefix(
                WORLD_URIS.replay
            ).partition("?")[0]
    return {key: Path(name) for key, name in named.items()}


def resolve_mission(swarm: AnySwarm, folder: Path) -> AnySwarm:
    """Return the swarm with the full path of its mission."""
    if swarm.mission is None or not swarm.mission.endswith(".py"):
        return swarm
    return msgspec.structs.replace(
        swarm, mission=_full_path(folder, swarm.mission, "mission")
    )


def _resolve_files(swarm: AnySwarm, folder: Path) -> AnySwarm:
    """Return the swarm with the full paths of its files."""
    named = {
        key: value
        for key, value in swarm.mission_options.items()
        if key in FILE_OPTIONS and isinstance(value, str)
    }
    found = {
        key: _full_path(folder, value, f"mission_options.{key}")
        for key, value in named.items()
    }
    drones = tuple(_resolve_replay(drone, folder) for drone in swarm.drones)
    mocap = swarm.mocap
    if mocap.file:
        mocap = msgspec.structs.replace(
            mocap, file=_full_path(folder, mocap.file, "mocap.file")
        )
    return msgspec.structs.replace(
        swarm,
        mission_options=swarm.mission_options | found,
        drones=drones,
        mocap=mocap,
    )


def _resolve_shapes(swarm: AnySwarm, folder: Path) -> AnySwarm:
    """Return the swarm with the full paths of the files of [mujoco]."""
    named = {
        key: value for key in SHAPE_FILE_KEYS if (value := getattr(swarm.mujoco, key))
    }
    found = {
        key: _full_path(folder, value, f"mujoco.{key}") for key, value in named.items()
    }
    mujoco = msgspec.structs.replace(swarm.mujoco, **found)
    return msgspec.structs.replace(swarm, mujoco=mujoco) if found else swarm


def _resolve_keys(swarm: AnySwarm, folder: Path) -> AnySwarm:
    """Return the swarm with the full path of its folder of keys."""
    if not is_secured(swarm):
        return swarm
    keys = _full_path(folder, swarm.security.keys, "security.keys")
    return msgspec.structs.replace(
        swarm, security=msgspec.structs.replace(swarm.security, keys=keys)
    )


def _resolve_replay(drone: DroneTable, folder: Path) -> DroneTable:
    """Return the drone with the full path of the recording that it replays, if it replays one."""
    name = drone.uri.removeprefix(WORLD_URIS.replay)
    if name == drone.uri:
        return drone
    return msgspec.structs.replace(
        drone,
        uri=f"{WORLD_URIS.replay}{_full_path(folder, name, f'drone {drone.id}: uri')}",
    )


def _full_path(folder: Path, name: str, key: str) -> str:
    """Return the full path of a file.

    key: the key that names the file, for the error
    Raises ConfigError for a name that no file here can have.
    """
    try:
        return str((folder / as_path(name)).resolve())
    except (ValueError, OSError, RuntimeError) as error:
        do = "Rename the file; or, for letters that this system does not know, set PYTHONUTF8=1 or LC_ALL=C.UTF-8."
        raise ConfigError(
            key, ascii(name), f"the name of a file ({error})", do
        ) from error
