"""Checks of options, instance and swarm of pickup and delivery, before any drone flies."""

import math
from itertools import combinations

import numpy as np

from crazychoir.config.drone_room import shared_room
from crazychoir.config.swarm_config import SwarmConfig
from crazychoir.errors import ConfigError
from crazychoir.guidance.delivery.delivery_checks import require_flyable_features
from crazychoir.guidance.delivery.site import DeliverySite
from crazychoir.routing.distributed.pickup_delivery import PickupDelivery
from crazychoir.routing.instance.instance import Instance
from crazychoir.types import Vec

OBEYED_FEATURES = ("end", "service_time", "penalty", "recharge")
"""Features of an instance, of those in `require_flyable_features`, that robots obey in flight."""
LANDING_CLEARANCE = 0.4
"""m, in the plane: distance of a landing place from the places where others stand and land."""
LOWEST_STOP = 0.1
"""m above the ground: lowest stop, since no drone touches down at a stop."""


def require_ready(
    config: SwarmConfig, problem: Instance, method: str, where: str
) -> None:
    """Check the swarm and the method against the instance, and that all of it can be flown.

    where: the key of the instance, for the error.
    Raises ConfigError if the swarm is not that of the instance, if the method does not fit, or if a
    part of the instance cannot be flown.
    """
    allowed = "robots in flight fly straight, start as soon as they can, and land at home or at their end"
    require_flyable_features(problem, where, OBEYED_FEATURES, allowed)
    _require_homes(config, problem)
    _require_graph(config)
    PickupDelivery(
        problem.local(0), [], problem.robots, 1, {}, method
    )  # raises ConfigError if the method does not fit
    _require_places(config, problem, where)
    _require_ends(config, problem, where)


def _require_homes(config: SwarmConfig, problem: Instance) -> None:
    if config.ids != tuple(range(problem.robots)):
        allowed = f"0 to {problem.robots - 1}, as the instance"
        raise ConfigError(f"swarm {config.name}: drones", list(config.ids), allowed)
    for i, home in enumerate(problem.home):
        stands = config.drone(i).home
        if np.linalg.norm(np.subtract(stands[:2], home[:2])) > 0.05:
            raise ConfigError(
                f"swarm {config.name}: drones[{i}].home",
                stands,
                f"{home.tolist()}, as the instance",
            )


def _require_graph(config: SwarmConfig) -> None:
    graph = config.graph()
    key = f"swarm {config.name}: graph"
    if not graph.is_undirected:
        raise ConfigError(key, "a directed graph", "an undirected one")
    if not graph.is_connected:
        raise ConfigError(
            key,
            "a drone that cannot reach all others",
            "a connected graph",
            "Add an edge.",
        )


def _require_places(config: SwarmConfig, problem: Instance, where: str) -> None:
    site = DeliverySite(config, 0.0, problem)  # drones wait for each other above homes
    for name, points in (
        ("pickup", problem.tasks.pickup),
        ("delivery", problem.tasks.delivery),
    ):
        for j, p in enumerate(points):
            if found := site.objection((p[0], p[1])) or _explain_height(config, p):
                allowed = f"places inside the fence, {LOWEST_STOP:g} m or more above the ground"
                raise ConfigError(
                    f"{where}: {name}[{j}]",
                    p.tolist(),
                    allowed,
                    "Move it, or widen [fence].",
                    found,
                )


def _explain_height(config: SwarmConfig, p: Vec) -> str:
    """Return why no drone may stand at the height of a place in space. Empty if it may."""
    (_, _, low), (_, _, high) = shared_room(config)
    return (
        f"at a height of {p[2]:g} m, not {low:g} to {high:g} m"
        if len(p) == 3 and not low <= p[2] <= high
        else ""
    )


def _require_ends(config: SwarmConfig, problem: Instance, where: str) -> None:
    """Raise ConfigError if a robot's end is too near to the home or the end of another robot.

    Drones rise above their homes.
    """
    if problem.end is None:
        return
    site = DeliverySite(config, LANDING_CLEARANCE, problem)
    ends = [(float(p[0]), float(p[1])) for p in problem.end]
    moved = [i for i in config.ids if math.dist(ends[i], problem.home[i][:2]) > 0.0]
    allowed = f"places inside the fence, {LANDING_CLEARANCE:g} m away from homes and ends of others"
    for i in moved:
        if found := site.objection(ends[i], i):
            raise ConfigError(
                f"{where}: end[{i}]", list(ends[i]), allowed, "Move it.", found
            )
    for i, j in combinations(moved, 2):
        if (gap := math.dist(ends[i], ends[j])) < LANDING_CLEARANCE:
            found = f"{gap:.2f} m from the end of drone {j}"
            raise ConfigError(
                f"{where}: end[{i}]", list(ends[i]), allowed, "Move one of them.", found
            )
