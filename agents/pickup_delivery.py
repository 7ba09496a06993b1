"""Pickup and delivery: the team shares out the goods, then each drone flies its part of the plan.

One distributed mixed-integer program gives the plan.

crazychoir run pickup_delivery --loss 0.2
"""

from pathlib import Path
from typing import Any

import numpy as np

from crazychoir import PDVRPGuidance, SwarmConfig
from crazychoir.config.reader import read_table
from crazychoir.guidance.delivery.pickup_checks import require_ready
from crazychoir.guidance.delivery.pickup_options import PickupOptions
from crazychoir.routing.instance.checker import check_plan as violations
from crazychoir.routing.instance.instance import Instance
from crazychoir.routing.instance.picture import draw_routes
from crazychoir.routing.instance.plan import Route, RoutePlan

Options = PickupOptions
"""The table of [mission_options]."""
Results = dict[int, dict[str, Any]]
"""The results of all drones, by id."""
DEMO_INSTANCE = Path(__file__).parent / "data" / "lab6.json"
"""The instance of the demonstration."""
PICKUP_FLIGHT_TABLE = {
    "takeoff_height": 0.5,
    "speed_limit": 0.8,
    "acceleration_limit": 2.0,
    "landing_speed": 0.4,
}
"""[flight] of this mission's own swarm."""


def guidance(i: int, config: SwarmConfig) -> PDVRPGuidance:
    """Return the guidance of robot i, with its own part of the instance."""
    options = given(config)
    return PDVRPGuidance(
        instance(config).local(i), options.method, options.service_time
    )


def given(config: SwarmConfig) -> PickupOptions:
    """Return [mission_options]. Raises ConfigError with the key that is wrong."""
    return read_table(
        config.mission_options, PickupOptions, f"swarm {config.name}", "mission_options"
    )


def instance(config: SwarmConfig) -> Instance:
    """Return the instance that the swarm's options name, or that of the demonstration."""
    return Instance.load(given(config).instance or DEMO_INSTANCE)


def swarm(drones: int | None = None, path: str | Path = DEMO_INSTANCE) -> SwarmConfig:
    """Return a swarm with a drone at each home of the instance, in a ring graph."""
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
            "flight": PICKUP_FLIGHT_TABLE,
            "fence": {
                "min": [*low[:2].tolist(), 0.0],
                "max": [*high[:2].tolist(), 3.0],
            },
        }
    )


def check(config: SwarmConfig, force: bool = False) -> list[str]:
    """Check that the drones stand where the instance says, and can fly all that it asks for.

    Raises ConfigError if not.
    """
    options = given(config)
    require_ready(
        config,
        instance(config),
        options.method,
        f"swarm {config.name}: mission_options.instance",
    )
    return []


def report(config: SwarmConfig, results: Results) -> dict[str, Any]:
    """Report cost and plan, and whether each drone has flown its part of the plan, stop by stop."""
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
    """Return by drone why the stops that it served differ from the stops of its route, in order."""
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
    """Draw the planned routes."""
    problem = instance(config)
    plan = _plan(problem, results)
    if plan:
        draw_routes(problem, plan, path)


def _plan(problem: Instance, results: Results) -> RoutePlan | None:
    routes = [Route.from_json(r["route"]) for r in results.values() if r.get("route")]
    digests = {r.get("plan_digest") for r in results.values()}
    plan = problem.plan(route for route in routes if route.stops)
    return plan if digests == {plan.digest} else None
