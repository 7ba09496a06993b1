"""The processes of a swarm under systemd: their names, units and command lines."""

from enum import IntEnum
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from crazychoir.config.swarm_config import SwarmConfig


class UnitNumber(IntEnum):
    """Numbers of the processes without drones, equal to those in config/addresses.py."""

    WORLD = -1
    """Numbers of processes, equal to those in config/addresses.py, which takes 1 s to import.
    """
    MOCAP = -2
    FIRST_DONGLE = -3
    """Number of dongle 0; dongle k has the number FIRST_DONGLE - k."""
    ROUTER = -19


def name_of(process: int) -> str:
    """Return the name of a process in words."""
    owners: dict[int, str] = {
        UnitNumber.WORLD: "the world's owner",
        UnitNumber.MOCAP: "motion capture",
        UnitNumber.ROUTER: "the router",
    }
    if process >= 0:
        return f"drone {process}"
    return owners.get(process, f"dongle {UnitNumber.FIRST_DONGLE - process}")


def unit_of(process: int) -> str:
    """Return the systemd unit of a process."""
    owners: dict[int, str] = {
        UnitNumber.WORLD: "crazychoir-world",
        UnitNumber.MOCAP: "crazychoir-mocap",
        UnitNumber.ROUTER: "crazychoir-router",
    }
    if process >= 0:
        return f"crazychoir-agent@{process}.service"
    return (
        owners.get(process, f"crazychoir-radio@{UnitNumber.FIRST_DONGLE - process}")
        + ".service"
    )


def units(config: "SwarmConfig", host: str) -> list[str]:
    """Return the units of a host, owners first, because agents wait for them."""
    from crazychoir.config.addresses import Addresses

    addresses = Addresses(config)
    return [
        unit_of(process)
        for process in addresses.endpoints()
        if addresses.host_of(process) == host
    ]
