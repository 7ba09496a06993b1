"""What pickup and delivery needs beside its guidance: options, swarm, checks, report, picture."""

from pathlib import Path
from typing import Any

import numpy as np

from crazychoir.config.reader import read_table
from crazychoir.config.swarm_config import SwarmConfig
from crazychoir.guidance.delivery.pickup_setup import PickupOptions, require_ready
from crazychoir.guidance.mission_report import Results
from crazychoir.routing.distributed.plain_loop import compile_routing_kernels
from crazychoir.routing.instance.checker import check_plan
from crazychoir.routing.instance.instance import Instance
from crazychoir.routing.instance.picture import draw_routes
from crazychoir.routing.instance.plan import Route, RoutePlan

PICKUP_FLIGHT_TABLE = {
    "takeoff_height": 0.5,
    "speed_limit": 0.8,
    "acceleration_limit": 2.0,
    "landing_speed": 0.4,
}
"""[flight] of this mission's own swarm."""
PICKUP_ROOM_MARGIN = 3.0
"""m: distance of the fence from the homes, and its height."""


class PickupHooks:
    """The hooks of a mission that flies an instance.

    demo: file of the instance if the options name none.
    """

    def __init__(self, demo: str | Path) -> None:
        self.demo = demo

    def given(self, config: SwarmConfig) -> PickupOptions:
        """Return [mission_options]. Raises ConfigError with the key that is wrong."""
        where = f"swarm {config.name}"
        return read_table(
            config.mission_options, PickupOptions, where, "mission_options"
        )

    def instance(self, config: SwarmConfig) -> Instance:
        """Return the instance that the options name, or that of the demonstration."""
        return Instance.load(self.given(config).instance or self.demo)

    def swarm(
        self, drones: int | None = None, path: str | Path | None = None
    ) -> SwarmConfig:
        """Return a swarm with a drone at each home of the instance, in a ring graph.

        path: file of the instance. None: that of the demonstration.
        """
        file = self.demo if path is None else path
        homes = [[*home, 0.0][:3] for home in Instance.load(file).home.tolist()]
        low = np.min(homes, axis=0) - PICKUP_ROOM_MARGIN
        high = np.max(homes, axis=0) + PICKUP_ROOM_MARGIN
        return SwarmConfig.of(
            {
                "name": "pickup",
                "mission": "pickup_delivery",
                "mission_options": {"instance": str(file)},
                "drones": [
                    {"id": i, "home": [*home[:2], 0.0]} for i, home in enumerate(homes)
                ],
                "flight": PICKUP_FLIGHT_TABLE,
                "fence": {
                    "min": [*low[:2].tolist(), 0.0],
                    "max": [*high[:2].tolist(), PICKUP_ROOM_MARGIN],
                },
            }
        )

    def compile(self, config: SwarmConfig) -> None:
        """Compile the route search that the instance needs."""
        problem = self.instance(config).local(0)
        compile_routing_kernels(problem, self.given(config).method)

    def check(self, config: SwarmConfig, force: bool = False) -> list[str]:
        """Check that the drones stand where the instance says, and can fly all that it asks for.

        Raises ConfigError if not.
        """
        where = f"swarm {config.name}: mission_options.instance"
        options = self.given(config)
        method = options.method
        _ = options.settings  # raises ConfigError if the method has no budget
        require_ready(config, self.instance(config), method, where)
        return []

    def report(self, config: SwarmConfig, results: Results) -> dict[str, Any]:
        """Report cost and plan, and whether each drone has flown its part of the plan, stop by stop."""
        problem = self.instance(config)
        plan = find_team_plan(problem, results)
        stops = [stop for r in results.values() for stop in r.get("served", [])]
        served = {stop["task"] for stop in stops if stop["kind"] == "delivery"}
        found = check_plan(problem, plan) if plan else []
        reasons = describe_unflown(results)
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

    def picture(self, config: SwarmConfig, results: Results, path: str) -> None:
        """Draw the planned routes."""
        problem = self.instance(config)
        plan = find_team_plan(problem, results)
        if plan:
            draw_routes(problem, plan, path)


def describe_unflown(results: Results) -> dict[int, str]:
    """Return by drone why the stops that it served differ from the stops of its route, in order."""
    reasons = {}
    for i, result in sorted(results.items()):
        if "route" not in result:
            reasons[i] = "has ended without a route"
        elif (stops := result["route"]["stops"]) != (done := result.get("served", [])):
            reasons[i] = (
                f"served {_describe_stops(done)}; its route: {_describe_stops(stops)}"
            )
    return reasons


def _describe_stops(stops: list[dict[str, Any]]) -> str:
    names = [
        stop["kind"] if stop["kind"] == "recharge" else f"{stop['kind']} {stop['task']}"
        for stop in stops
    ]
    return ", ".join(names) or "nothing"


def find_team_plan(problem: Instance, results: Results) -> RoutePlan | None:
    """Return the plan of the team. None if the drones do not all have this plan."""
    routes = [Route.from_json(r["route"]) for r in results.values() if r.get("route")]
    digests = {r.get("plan_digest") for r in results.values()}
    plan = problem.plan(route for route in routes if route.stops)
    return plan if digests == {plan.digest} else None
