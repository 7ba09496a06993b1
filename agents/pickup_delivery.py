"""Pickup and delivery: the team shares out the goods by one distributed mixed-integer program, and flies them home.

crazychoir run pickup_delivery --loss 0.2
"""

from pathlib import Path
from typing import Any

import numpy as np

from crazychoir import PDVRPGuidance, SwarmConfig
from crazychoir.errors import ConfigError
from crazychoir.routing.checker import check as violations
from crazychoir.routing.instance import Instance
from crazychoir.routing.pickup_delivery import METHODS
from crazychoir.routing.picture import draw_routes
from crazychoir.routing.plan import Plan, Route

Results = dict[int, dict[str, Any]]
DEMO = Path(__file__).parent / "data" / "lab6.json"
FLIGHT = {"takeoff_height": 0.5, "speed_limit": 0.8, "acceleration_limit": 2.0, "landing_speed": 0.4}


def guidance(i: int, config: SwarmConfig) -> PDVRPGuidance:
    """Robot i, with its own part of the instance."""
    options = config.mission_options
    return PDVRPGuidance(
        instance(config).local(i), options.get("method", METHODS[0]), options.get("service_time", 1.0)
    )


def instance(config: SwarmConfig) -> Instance:
    """The instance that the swarm's options name."""
    return Instance.load(config.mission_options.get("instance", DEMO))


def swarm(drones: int | None = None, path: str | Path = DEMO) -> SwarmConfig:
    """A drone at each home of the instance, in a ring."""
    homes = [[*home, 0.0][:3] for home in Instance.load(path).home.tolist()]
    low, high = np.min(homes, axis=0) - 3.0, np.max(homes, axis=0) + 3.0
    return SwarmConfig.of(
        {
            "name": "pickup",
            "mission": "pickup_delivery",
            "mission_options": {"instance": str(path)},
            "drones": [{"id": i, "home": [*home[:2], 0.0]} for i, home in enumerate(homes)],
            "flight": FLIGHT,
            "fence": {"min": [*low[:2].tolist(), 0.0], "max": [*high[:2].tolist(), 3.0]},
        }
    )


def check(config: SwarmConfig, force: bool = False) -> list[str]:
    """The drones stand where the instance says."""
    homes = instance(config).home
    if config.ids != tuple(range(len(homes))):
        raise ConfigError(f"swarm {config.name}: drones", list(config.ids), f"0 to {len(homes) - 1}, as the instance")
    for i, home in enumerate(homes):
        if np.linalg.norm(np.subtract(config.drone(i).home[:2], home[:2])) > 0.05:
            found = config.drone(i).home
            raise ConfigError(f"swarm {config.name}: drones[{i}].home", found, f"{home.tolist()}, as the instance")
    return []


def report(config: SwarmConfig, results: Results) -> dict[str, Any]:
    """Cost, plan, and whether every good was served once."""
    problem = instance(config)
    plan = _plan(results)
    stops = [stop for r in results.values() for stop in r.get("served", [])]
    served = sorted(stop["task"] for stop in stops if stop["kind"] == "delivery")
    total = len(problem.tasks)
    found = violations(problem, plan) if plan else ["no plan"]
    return {
        "success": not found and served == list(range(total)),
        "tasks": {"total": total, "served": len(set(served))},
        "cost": plan.cost if plan else None,
        "plan_digest": plan.digest if plan else None,
        "planned_m": {r.robot: r.length for r in plan.routes} if plan else {},
        "violations": found,
    }


def picture(config: SwarmConfig, results: Results, path: str) -> None:
    """The planned routes."""
    plan = _plan(results)
    if plan:
        draw_routes(instance(config), plan, path)


def _plan(results: Results) -> Plan | None:
    routes = [Route.from_json(r["route"]) for r in results.values() if r.get("route")]
    digests = {r.get("plan_digest") for r in results.values()}
    plan = Plan(tuple(route for route in routes if route.stops))
    return plan if digests == {plan.digest} else None
