"""Checks of planned paths before any drone flies.

Paths must lie inside the fence by the margins of the guard, see flight_room.
"""

from crazychoir.config.flight_room import room_of
from crazychoir.config.swarm_config import SwarmConfig
from crazychoir.planning.feasibility import Limits, references
from crazychoir.planning.trajectory import Trajectory


def inside(config: SwarmConfig) -> Limits:
    """Return limits on places alone: the room in which drones may be sent."""
    low, high = room_of(config)
    return Limits(low=low, high=high)


def require_inside(path: Trajectory, config: SwarmConfig, where: str) -> None:
    """Raise ConfigError with the first set-point of a path at which the guard would brake."""
    inside(config).check_places(references(path)[1][:, 0:3], f"{where}: set-point")
