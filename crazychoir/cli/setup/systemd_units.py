"""The processes of a swarm, as systemd runs them: their names, units and command lines."""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from crazychoir.config.swarm_config import SwarmConfig

WORLD, MOCAP, DONGLES, ROUTER = -1, -2, -3, -19
"""As in config/swarm_config.py, which takes 1 s to import."""


def name_of(process: int) -> str:
    """What listens there, in words."""
    owners = {WORLD: "the world's owner", MOCAP: "motion capture", ROUTER: "the router"}
    if process >= 0:
        return f"drone {process}"
    return owners.get(process, f"dongle {DONGLES - process}")


def unit_of(process: int) -> str:
    """The systemd unit of a process."""
    owners = {
        WORLD: "crazychoir-world",
        MOCAP: "crazychoir-mocap",
        ROUTER: "crazychoir-router",
    }
    if process >= 0:
        return f"crazychoir-agent@{process}.service"
    return owners.get(process, f"crazychoir-radio@{DONGLES - process}") + ".service"


def units(config: "SwarmConfig", host: str) -> list[str]:
    """Those of a host; owners first: agents wait for them."""
    return [
        unit_of(process)
        for process in config.endpoints()
        if config.host_of(process) == host
    ]
