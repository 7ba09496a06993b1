"""Paths that a mission plans before take-off: inside the room of the drone that flies them, as its guard has it."""

from crazychoir.config.drone_room import room_of
from crazychoir.config.swarm_config import SwarmConfig
from crazychoir.planning.feasibility import Limits, sample_references
from crazychoir.planning.trajectory import Trajectory


def get_place_limits(config: SwarmConfig, i: int) -> Limits:
    """Return limits of places alone: those of the room in which drone i may be sent."""
    low, high = room_of(config, i)
    return Limits(low=low, high=high)


def require_inside(path: Trajectory, config: SwarmConfig, i: int, where: str) -> None:
    """Raise ConfigError that names the first set-point of a path at which the guard of drone i would brake."""
    get_place_limits(config, i).check_places(
        sample_references(path)[1][:, 0:3], f"{where}: set-point"
    )
