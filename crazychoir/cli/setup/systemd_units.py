"""The processes of a swarm under systemd: their names, units and command lines."""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from crazychoir.config.swarm_config import SwarmConfig

# Numbers of processes, equal to those in config/swarm_config.py, which takes 1 s to import.
WORLD = -1
MOCAP = -2
DONGLES = -3
"""Number of dongle 0; dongle k has the number DONGLES - k."""
ROUTER = -19


def name_of(process: int) -> str:
    """Return the name of a process in words."""
    owners = {WORLD: "the world's owner", MOCAP: "motion capture", ROUTER: "the router"}
    if process >= 0:
        return f"drone {process}"
    return owners.get(process, f"dongle {DONGLES - process}")


def unit_of(process: int) -> str:
    """Return the systemd unit of a process."""
    owners = {
        WORLD: "crazychoir-world",
        MOCAP: "crazychoir-mocap",
        ROUTER: "crazychoir-router",
    }
    if process >= 0:
        return f"crazychoir-agent@{process}.service"
    return owners.get(process, f"crazychoir-radio@{DONGLES - process}") + ".service"


def units(config: "SwarmConfig", host: str) -> list[str]:
    """Return the units of a host, owners first, because agents wait for them."""
    return [
        unit_of(process)
        for process in config.endpoints()
        if config.host_of(process) == host
    ]
