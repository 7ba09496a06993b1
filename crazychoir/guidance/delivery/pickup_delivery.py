"""PDVRPGuidance: the team solves a pickup-and-delivery problem, then each drone flies its route."""

from typing import Any

import numpy as np

from crazychoir.errors import ConfigError
from crazychoir.guidance.guidance import CFGuidance
from crazychoir.guidance.member import Member
from crazychoir.routing.distributed.member import RoutingSettings
from crazychoir.routing.distributed.pickup_delivery import (
    PLANNING_METHODS,
    PickupDelivery,
)
from crazychoir.routing.distributed.plain_loop import compile_routing_kernels
from crazychoir.routing.instance.instance import LocalProblem
from crazychoir.routing.instance.plan import Route, Solution, Stop
from crazychoir.types import Vec

PICKUP_ROUND_DEADLINE = 120.0
"""s for one round, in which the slowest neighbour prices its routes."""


class PDVRPGuidance(CFGuidance):
    """Robot i knows its own home, capacity and capability, and the public task list.

    It knows nothing of the other robots. It recharges and ends where the instance says: above its
    end, or above its home without an end. There it lands at last.

    problem: this robot's part of the instance.
    method: how the integer plan is recovered, see PickupDelivery.
    service_time: s at each stop, at least. A longer time of the instance holds.
    settings: constants of the method, the same at all robots.
    """

    def __init__(
        self,
        problem: LocalProblem,
        method: str = PLANNING_METHODS[0],
        service_time: float = 1.0,
        settings: RoutingSettings | None = None,
    ) -> None:
        self.problem = problem
        self.method = method
        self.service_time = service_time
        self.settings = settings
        self.served: list[dict[str, Any]] = []
        self._stops: tuple[Stop, ...] = ()  # stops of its present or next route
        self.history: list[tuple[int, float | None, float | None]] = []

    def foresee(self, member: Member) -> None:
        """Compile or load the route search before another robot waits for this one."""
        compile_routing_kernels(self.problem, self.method)

    async def mission(self) -> dict[str, Any]:
        """Plan together, then fly the routes, all at the same time.

        The collision filter keeps the drones apart.
        """
        solution = await self.plan()
        route = solution.routes[0] if solution.routes else Route(self.id, (), 0.0)
        self._stops = route.stops
        try:
            await self.wait_for_start()
            if route.stops:
                await self.fly_route(route, solution)
        finally:
            self._stops = ()
        self.member.report = lambda: self.news(
            f"done: {len(self.served)} stops", solution
        )
        return self.outcome(solution, route)

    async def plan(self) -> Solution:
        """Solve the distributed mixed-integer program, and return its solution."""
        graph = self.graph
        solver = PickupDelivery(
            self.problem,
            neighbors=list(graph.neighbors(self.id)),
            n=len(graph.ids),
            diameter=graph.diameter(),
            degree_of={j: len(graph.neighbors(j)) for j in graph.neighbors(self.id)},
            method=self.method,
            settings=self.settings,
        )
        self.member.report = lambda: {
            "task": f"planning: {solver.progress.phase}",
            "round": solver.progress.round,
            "cost": solver.progress.cost,
            "relaxed": solver.progress.relaxed,
        }
        await self.optimize(
            solver, channel="pickup_delivery", deadline=PICKUP_ROUND_DEADLINE
        )
        self.history = solver.history
        return solver.solution

    async def fly_route(self, route: Route, solution: Solution) -> None:
        """Take off, serve stop by stop, go to the end, land."""
        self.member.report = lambda: self.news(
            f"flying: {len(self.served)}/{len(route.stops)} stops", solution
        )
        await self.take_off()
        for stop in route.stops:
            await self.go_to(self.place(stop))
            await self.sleep(self.seconds(stop))
            self.served.append({"task": stop.task, "kind": stop.kind})
        await self.go_to(self.above_end())
        self.member.report = lambda: self.news(
            f"landing: {len(self.served)} stops", solution
        )
        await self.land()

    def route(self) -> list[Vec]:
        """Return the stops that are left, then the end."""
        left = self._stops[len(self.served) :]
        return [*map(self.place, left), self.above_end()] if self._stops else []

    def news(self, task: str, solution: Solution) -> dict[str, Any]:
        """Return the status of a mission that flies its plan."""
        return {"task": task, "cost": solution.cost, "relaxed": solution.lower_bound}

    def place(self, stop: Stop) -> Vec:
        """Return where the robot stands at a stop, (3,) m.

        A point in the plane is visited at take-off height.
        Raises ConfigError for a kind of stop that it cannot fly.
        """
        tasks = self.problem.tasks
        match stop.kind:
            case "pickup":
                p = tasks.pickup[stop.task]
            case "delivery":
                p = tasks.delivery[stop.task]
            case "recharge":
                return self.above_end()
            case unknown:
                raise ConfigError(
                    f"drone {self.id}: kind of a stop",
                    unknown,
                    "pickup, delivery, recharge",
                )
        return np.array([*p[:2], p[2] if len(p) == 3 else self._height])

    def seconds(self, stop: Stop) -> float:
        """Return how long the robot stays at a stop, in s."""
        if stop.kind == "recharge":
            return self.service_time
        service = self.problem.tasks.service
        return max(
            self.service_time,
            float(service[stop.task + (stop.kind == "delivery") * (len(service) // 2)]),
        )

    def above_end(self) -> Vec:
        """Return where the flight ends, (3,) m.

        It is above the end of the instance, else above the home of the drone.
        """
        home = self.problem.home
        end = self.problem.end
        elsewhere = end is not None and not np.array_equal(end, home)
        x, y = (
            end[:2]
            if end is not None and elsewhere
            else self.member.config.drone(self.id).home[:2]
        )
        return np.array([x, y, self._height])

    @property
    def _height(self) -> float:
        """m, world: height of the take-off."""
        flight = self.member.config.flight
        return flight.ground + flight.takeoff_height

    def outcome(self, solution: Solution, route: Route) -> dict[str, Any]:
        """Return this drone's part of the report."""
        return {
            "served": self.served,
            "route": route.to_json(),
            "cost": solution.cost,
            "lower_bound": solution.lower_bound,
            "bound_exact": solution.bound_exact,
            "disclosed": list(solution.disclosed),
            "rounds": solution.rounds,
            "ended_by": solution.ended_by,
            "work_curve": [list(point) for point in solution.work_curve],
            "history": self.history,
            "objective": list(self.problem.objective),
            "plan_digest": solution.plan_digest,
        }
