"""Check that the optional packages of a run are installed, before any process is started."""

import importlib.util
from collections.abc import Iterable

from crazychoir.config.checks import WORLD_URIS
from crazychoir.config.swarm_config import SwarmConfig
from crazychoir.errors import ConfigError
from crazychoir.launch.processes import WORLD_OWNER, Owner
from crazychoir.mocap.system import MOCAP_EXTRA, MOCAP_LIBRARY

SOURCES_WITHOUT_EXTRA = ("virtual", "replay")
"""Sources of [mocap] that need no extra."""


def require_extras(config: SwarmConfig, owners: Iterable[Owner], fast: bool) -> None:
    """Raise ConfigError for an extra that this run needs on this machine and that is not installed.

    config: the swarm
    owners: owner processes that this run starts
    fast: whether it flies in this process, in virtual time
    """
    started = {owner.name for owner in owners}
    in_mujoco = [
        drone.id for drone in config.drones if drone.uri.startswith(WORLD_URIS.mujoco)
    ]
    if in_mujoco and (fast or WORLD_OWNER.name in started):
        where = f'swarm {config.name}: drone {in_mujoco[0]}: uri = "{config.drone(in_mujoco[0]).uri}"'
        _require(where, "mujoco", "mujoco")
    source = config.mocap.source
    if not fast and "mocap" in started and source not in SOURCES_WITHOUT_EXTRA:
        _require(
            f'swarm {config.name}: [mocap] source = "{source}"',
            MOCAP_LIBRARY,
            MOCAP_EXTRA,
        )


def _require(where: str, module: str, extra: str) -> None:
    """Raise ConfigError if a module of this extra is not installed."""
    if importlib.util.find_spec(module) is None:
        do = f"pip install 'crazychoir[{extra}]'."
        raise ConfigError(
            where,
            f"no module {module}",
            f"the extra {extra}, installed on this machine",
            do,
        )
