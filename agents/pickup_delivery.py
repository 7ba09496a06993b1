"""Pickup and delivery: the team shares out the goods by one distributed mixed-integer program, and flies them home.

crazychoir run pickup_delivery --loss 0.2
"""

from pathlib import Path
from typing import Any

import numpy as np

from crazychoir import PDVRPGuidance, SwarmConfig
from crazychoir.config.reader import read
from crazychoir.guidance.delivery.pickup_checks import require_ready
from crazychoir.guidance.delivery.pickup_options import PickupOptions
from crazychoir.routing.instance.checker import check as violations
from crazychoir.routing.instance.instance import Instance
from crazychoir.routing.instance.picture import draw_routes
from crazychoir.routing.instance.plan import Plan, Route

Results = dict[int, dict[str, Any]]
DEMO = Path(__file__).parent / "data" / "lab6.json"
FLIGHT = {
    "takeoff_height": 0.5,
    "speed_limit": 0.8,
    "acceleration_limit": 2.0,
    "landing_speed": 0.4,
}


def guidance(i: int, config: SwarmConfig) -> PDVRPGuidance:
    """Robot i, with its own part of the instance."""
    options = given(config)
    return PDVRPGuidance(
        instance(config).local(i), options.method, options.service_time
    )


def given(config: SwarmConfig) -> PickupOptions:
    """[mission_options]; raises ConfigError that names the key."""
    return read(
        config.mission_options, PickupOptions, f"swarm {config.name}", "mission_options"
    )


def instance(config: SwarmConfig) -> Instance:
    """The instance that the swarm's options name."""
    return Instance.load(given(config).instance or DEMO)


def swarm(drones: int | None = None, path: str | Path = DEMO) -> SwarmConfig:
    """A drone at each home of the instance, in a ring."""
    homes = [[*home, 0.0][:3] for home in Instance.load(path).home.tolist()]
    low = np.min(homes, axis=0) - 3.0
    high = np.max(homes, axis=0) + 3.0
    return SwarmConfig.of(
        {
            "name": "pickup",
            "mission": "pickup_delivery",
            "mission_options": {"instance": str(path)},
            "drones": [
                {"id": i, "home": [*home[:2], 0.0]} for i, home in enumerate(homes)
            ],
            "flight": FLIGHT,
            "fence": {
                "min": [*low[:2].tolist(), 0.0],
                "max": [*high[:2].tolist(), 3.0],
            },
        }
    )


def check(config: SwarmConfig, force: bool = False) -> list[str]:
    """The drones stand where the instance says, and can fly all that it asks for."""
    options = given(config)
    require_ready(
        config,
        instance(config),
        options.method,
        f"swarm {config.name}: mission_options.instance",
    )
    return []


def report(config: SwarmConfig, results: Results) -> dict[str, Any]:
    """Cost, plan, and whether each drone has flown its part of it, stop by stop."""
    problem = instance(config)
    plan = _plan(problem, results)
    stops = [stop for r in results.values() for stop in r.get("served", [])]
    served = {stop["task"] for stop in stops if stop["kind"] == "delivery"}
    found = violations(problem, plan) if plan else []
    reasons = _unflown(results)
    if found and not reasons:
        reasons = dict.fromkeys(
            results, f"the plan of the team is wrong: {'; '.join(found)}"
        )
    return {
        "success": plan is not None and not found and not reasons,
        "reasons": reasons,
        "tasks": {"total": len(problem.tasks), "served": len(served)},
        "cost": plan.cost if plan else None,
        "plan_digest": plan.digest if plan else None,
        "planned_m": {r.robot: r.length for r in plan.routes} if plan else {},
        "violations": found if plan else None,
    }


def _unflown(results: Results) -> dict[int, str]:
    """Why, by drone, the stops of its route are not those that it served, in their order."""
    reasons = {}
    for i, result in sorted(results.items()):
        if "route" not in result:
            reasons[i] = "has ended without a route"
        elif (stops := result["route"]["stops"]) != (done := result.get("served", [])):
            reasons[i] = f"served {_shown(done)}; its route: {_shown(stops)}"
    return reasons


def _shown(stops: list[dict[str, Any]]) -> str:
    names = [
        stop["kind"] if stop["kind"] == "recharge" else f"{stop['kind']} {stop['task']}"
        for stop in stops
    ]
    return ", ".join(names) or "nothing"


def picture(config: SwarmConfig, results: Results, path: str) -> None:
    """The planned routes."""
    problem = instance(config)
    plan = _plan(problem, results)
    if plan:
        draw_routes(problem, plan, path)


def _plan(problem: Instance, results: Results) -> Plan | None:
    routes = [Route.from_json(r["route"]) for r in results.values() if r.get("route")]
    digests = {r.get("plan_digest") for r in results.values()}
    plan = problem.plan(route for route in routes if route.stops)
    return plan if digests == {plan.digest} else None
