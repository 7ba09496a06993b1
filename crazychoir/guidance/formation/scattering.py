"""Random starts, clear of each other: a formation that begins in its places would show nothing."""

from dataclasses import dataclass
from typing import NamedTuple

import msgspec
import numpy as np

from crazychoir.config.swarm_config import SwarmConfig
from crazychoir.errors import Refused
from crazychoir.guidance.formation.leader import places
from crazychoir.types import Vec


@dataclass(frozen=True, slots=True)
class ScatterLimits:
    """How far apart and how high scattered starts are, and how often they are drawn."""

    clear_distance: float = 0.35
    """m: smallest distance between two starts, seen from above. The collision filter keeps less.
    """
    lowest_start: float = 0.3
    """m above the ground: lowest start. Below, the air is rough."""
    most_draws: int = 10_000
    """Number of draws after which there is no free place."""


SCATTER_LIMITS = ScatterLimits()


class Scatter(NamedTuple):
    """The largest shift of a start."""

    x: float
    """m."""
    y: float
    """m."""
    z: float
    """m."""


def scatter_swarm(config: SwarmConfig, by: Scatter) -> SwarmConfig:
    """Return the swarm with its followers' homes and heights moved by up to `by`.

    The seed of the swarm determines the places.

    Each drone takes off straight up, so two starts are at least SCATTER_LIMITS.clear_distance apart, seen from above.
    Raises Refused if there is no room.
    """
    draw = np.random.default_rng(config.seed)
    at = places(config)
    taken = [at[drone.id] for drone in config.drones if drone.leader]
    moved = {}
    for drone in config.drones:
        if not drone.leader:
            moved[drone.id] = _draw_clear_place(draw, drone.id, at[drone.id], by, taken)
            taken.append(moved[drone.id])
    drones = []
    for drone in config.drones:
        row = {
            key: value
            for key, value in msgspec.to_builtins(drone).items()
            if value is not None
        }
        if drone.id in moved:
            x, y, z = moved[drone.id].tolist()
            height = max(z - config.flight.ground, SCATTER_LIMITS.lowest_start)
            row |= {
                "home": [x, y, drone.home[2]],
                "options": {**drone.options, "height": height},
            }
        drones.append(row)
    return config.replace(drones=drones)


def _draw_clear_place(
    draw: np.random.Generator, i: int, center: Vec, by: Scatter, taken: list[Vec]
) -> Vec:
    for _ in range(SCATTER_LIMITS.most_draws):
        place: Vec = center + draw.uniform(-1.0, 1.0, 3) * by
        if all(
            np.hypot(*(place - other)[:2]) > SCATTER_LIMITS.clear_distance
            for other in taken
        ):
            return place
    raise Refused(
        f"drone {i}",
        f"no start within {by[0]:g} m that is {SCATTER_LIMITS.clear_distance} m from the others. Scatter less.",
    )
