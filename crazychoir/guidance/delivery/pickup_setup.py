"""[mission_options] of pickup and delivery, and its checks before any drone flies.

The reader checks keys, units, ranges and defaults with the table.
"""

import math
from collections.abc import Collection
from itertools import combinations
from typing import Annotated

import numpy as np
from msgspec import Meta

from crazychoir.config.drone_room import shared_room
from crazychoir.config.swarm_config import SwarmConfig
from crazychoir.config.tables import Seconds, SwarmTable, Text
from crazychoir.errors import ConfigError
from crazychoir.guidance.delivery.site import DeliverySite
from crazychoir.optimization.rounds.budget import BudgetSettings
from crazychoir.routing.distributed.member import RoutingSettings
from crazychoir.routing.distributed.pickup_delivery import (
    PLANNING_METHODS,
    PickupDelivery,
    choose_routing_settings,
)
from crazychoir.routing.instance.instance import Instance
from crazychoir.routing.instance.vehicle import OBJECTIVE_NAMES
from crazychoir.types import Vec

Method = Annotated[
    str,
    Meta(
        pattern=rf"^({'|'.join(PLANNING_METHODS)})\Z",
        description=", ".join(PLANNING_METHODS),
        examples=[PLANNING_METHODS[0]],
    ),
]
SearchSteps = Annotated[
    int,
    Meta(ge=0, description="a number of steps, not negative", examples=[200_000]),
]


class PickupOptions(SwarmTable, frozen=True, kw_only=True):
    """[mission_options]."""

    instance: Text | None = None
    """File of the instance. None: the instance of the demonstration."""
    method: Method = PLANNING_METHODS[0]
    """How the integer plan is recovered, see PickupDelivery."""
    service_time: Seconds = 1.0
    """s at each stop, at least. A longer time of the instance holds."""
    planning_work: SearchSteps | None = None
    """Steps that the team searches for better plans; the same number gives the same plan on every machine.

    None: the method ends by itself. Only the method columns has a budget. Seconds are none: in simulation the time
    of the flight stands still while a robot computes.
    """

    @property
    def settings(self) -> RoutingSettings:
        """The settings of the method. Raises ConfigError if the method has no budget."""
        budget = BudgetSettings(None, self.planning_work)
        return choose_routing_settings(self.method, budget)


OBEYED_FEATURES = ("end", "service_time", "penalty", "recharge")
"""The features that robots obey in flight; `require_flyable_features` refuses an instance with others."""
LANDING_CLEARANCE = 0.4
"""m, in the plane: distance of a landing place from the places where others stand and land."""
LOWEST_STOP = 0.1
"""m above the ground: lowest stop, since no drone touches down at a stop."""


def require_ready(
    config: SwarmConfig, problem: Instance, method: str, where: str
) -> None:
    """Check that this swarm can fly the instance with this method.

    problem: the instance. Drones 0 to N - 1 must stand at its homes, in a connected, undirected
        graph, and its stops and ends must be places that the drones can reach.
    method: from PLANNING_METHODS.
    where: the key of the instance, for the error.
    Raises ConfigError for the first check that fails.
    """
    allowed = "robots in flight fly straight, start as soon as they can, and land at home or at their end"
    require_flyable_features(problem, where, OBEYED_FEATURES, allowed)
    _require_homes(config, problem)
    _require_graph(config)
    for (
        robot,
        *_,
    ) in problem.kinds():  # raises ConfigError if the method does not fit one
        PickupDelivery(problem.local(robot), [], problem.robots, 1, {}, method)
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
            if found := site.explain_objection((p[0], p[1])) or _explain_height(
                config, p
            ):
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
        if found := site.explain_objection(ends[i], i):
            raise ConfigError(
                f"{where}: end[{i}]", list(ends[i]), allowed, "Move it.", found
            )
    for i, j in combinations(moved, 2):
        if (gap := math.dist(ends[i], ends[j])) < LANDING_CLEARANCE:
            found = f"{gap:.2f} m from the end of drone {j}"
            raise ConfigError(
                f"{where}: end[{i}]", list(ends[i]), allowed, "Move one of them.", found
            )


def require_flyable_features(
    problem: Instance,
    key: str,
    flown: Collection[str],
    allowed: str,
) -> None:
    """Raise ConfigError for features of an instance that no robot obeys in flight.

    Without this error they would be ignored silently.

    problem: the instance.
    key: key of the instance, for the error.
    flown: features that the robots of this mission obey.
    allowed: what the robots do, in words.
    """
    tasks = problem.tasks
    there = {
        "end": problem.end is not None,
        "open_tours": problem.open_tours,
        "distance": problem.distance is not None,
        "service_time": tasks.service.any(),
        "time_windows or release": tasks.earliest.any()
        or np.isfinite(tasks.latest).any(),
        "time_windows of homes": problem.window[:, 0].any()
        or np.isfinite(problem.window[:, 1]).any(),
        "penalty": np.isfinite(tasks.penalty).any(),
        "recharge": problem.recharge != 1,
        "objective": problem.objective != (OBJECTIVE_NAMES.total,),
    }
    if found := [
        name for name, is_there in there.items() if is_there and name not in flown
    ]:
        times = (
            ""
            if "service_time" in flown
            else "; service_time of [mission_options] holds for all stops"
        )
        do = f"Leave it out of the instance{times}."
        raise ConfigError(key, problem.name, allowed, do, f"it has {', '.join(found)}")
