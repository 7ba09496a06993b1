"""PDVRPGuidance: the team solves one pickup-and-delivery problem together, then each drone flies its route."""

from typing import Any

import numpy as np

from crazychoir.errors import ConfigError
from crazychoir.guidance.guidance import CFGuidance
from crazychoir.guidance.member import Member
from crazychoir.routing.distributed.pickup_delivery import METHODS, PickupDelivery
from crazychoir.routing.distributed.plain_loop import warm
from crazychoir.routing.instance.instance import LocalProblem
from crazychoir.routing.instance.plan import Route, Solution, Stop
from crazychoir.types import Vec

DEADLINE = 120.0
"""s for one round: the slowest neighbour prices its routes in it."""


class PDVRPGuidance(CFGuidance):
    """Robot i: its own home, capacity and capability, and the public task list; nothing of the other robots.

    service_time: s at each stop, at least: where the instance says more for a pickup or a delivery, it holds;
    method: how the integer plan is recovered, see PickupDelivery.
    It recharges, and ends, where the instance says: above its end, without one above its home; there it lands at last.
    """

    def __init__(
        self, problem: LocalProblem, method: str = METHODS[0], service_time: float = 1.0
    ) -> None:
        self.problem = problem
        self.method = method
        self.service_time = service_time
        self.served: list[dict[str, Any]] = []
        self._stops: tuple[Stop, ...] = ()  # of the route that it flies, or will
        self.history: list[tuple[int, float | None, float | None]] = []

    def foresee(self, member: Member) -> None:
        """Compile the route search, or load it, before anybody waits for this robot."""
        warm(self.problem, self.method)

    async def mission(self) -> dict[str, Any]:
        """Plan together, then fly, each its own route at once: the collision filter keeps them apart."""
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
        """The distributed mixed-integer program."""
        graph = self.graph
        solver = PickupDelivery(
            self.problem,
            neighbors=list(graph.neighbors(self.id)),
            n=len(graph.ids),
            diameter=graph.diameter(),
            degree_of={j: len(graph.neighbors(j)) for j in graph.neighbors(self.id)},
            method=self.method,
        )
        self.member.report = lambda: {
            "task": f"planning: {solver.progress.phase}",
            "round": solver.progress.round,
            "cost": solver.progress.cost,
            "relaxed": solver.progress.relaxed,
        }
        await self.optimize(solver, channel="pickup_delivery", deadline=DEADLINE)
        self.history = solver.history
        return solver.solution

    async def fly_route(self, route: Route, solution: Solution) -> None:
        """Take off, serve stop by stop, go to where it ends, land."""
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
        """Over the stops that are left to where it ends."""
        left = self._stops[len(self.served) :]
        return [*map(self.place, left), self.above_end()] if self._stops else []

    def news(self, task: str, solution: Solution) -> dict[str, Any]:
        """Of a mission that flies its plan."""
        return {"task": task, "cost": solution.cost, "relaxed": solution.lower_bound}

    def place(self, stop: Stop) -> Vec:
        """(3,) m where it stands at a stop; a point of the plane is visited at take-off height.

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
        """How long it stays at a stop."""
        if stop.kind == "recharge":
            return self.service_time
        service = self.problem.tasks.service
        return max(
            self.service_time,
            float(service[stop.task + (stop.kind == "delivery") * (len(service) // 2)]),
        )

    def above_end(self) -> Vec:
        """(3,) m where the flight ends: over the end that the instance gives, else over where it stood."""
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
        """m, world frame, of the take-off."""
        flight = self.member.config.flight
        return flight.ground + flight.takeoff_height

    def outcome(self, solution: Solution, route: Route) -> dict[str, Any]:
        """This drone's part of the report."""
        return {
            "served": self.served,
            "route": route.to_json(),
            "cost": solution.cost,
            "lower_bound": solution.lower_bound,
            "bound_exact": solution.bound_exact,
            "disclosed": list(solution.disclosed),
            "rounds": solution.rounds,
            "history": self.history,
            "objective": list(self.problem.objective),
            "plan_digest": solution.plan_digest,
        }
