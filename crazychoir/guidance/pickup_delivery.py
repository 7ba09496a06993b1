"""PDVRPGuidance: the team solves one pickup-and-delivery problem together, then each drone flies its route."""

from itertools import pairwise
from typing import Any

import numpy as np

from crazychoir.guidance.base import CFGuidance
from crazychoir.guidance.separation import STEP, start_delays
from crazychoir.math3d import Mat, Vec
from crazychoir.planning.point_to_point import PEAK_SPEED, PointToPoint, duration_for
from crazychoir.routing.instance import LocalProblem
from crazychoir.routing.pickup_delivery import METHODS, PickupDelivery
from crazychoir.routing.plan import Route, Solution
from crazychoir.types import FullState

DEADLINE = 120.0
"""s for one round: the slowest neighbour prices its routes in it."""
CLEARANCE = 0.35
"""m between any two drones on their planned flights, vertical distances halved."""


class PDVRPGuidance(CFGuidance):
    """Robot i: its own home, capacity and capability, and the public task list; nothing of the other robots.

    service_time: s at each pickup and delivery;  method: how the integer plan is recovered, see PickupDelivery.
    """

    def __init__(self, problem: LocalProblem, method: str = METHODS[0], service_time: float = 1.0) -> None:
        self.problem, self.method, self.service_time = problem, method, service_time
        self.served: list[dict[str, Any]] = []

    async def mission(self) -> dict[str, Any]:
        """Plan together, agree on who waits for whom, fly."""
        solution = await self.plan()
        route = solution.routes[0] if solution.routes else Route(self.id, (), 0.0)
        self.member.report = lambda: {"task": "agreeing on start times", "cost": solution.cost}
        delays = await self.agree_on_start(route)
        await self.wait_for_start()
        if route.stops:
            await self.fly_route(route, delays[self.id], solution)
        else:
            await self.member.communicator.close("start")  # a neighbour may still lack our last message
        self.member.report = lambda: {"task": f"done: {len(self.served)} stops", "cost": solution.cost}
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
            "task": f"planning: {solver.progress.phase}", "round": solver.progress.round, "cost": solver.progress.cost,
        }  # fmt: skip
        await self.optimize(solver, channel="pickup_delivery", deadline=DEADLINE)
        return solver.solution

    async def agree_on_start(self, route: Route) -> dict[int, float]:
        """Flood the timed paths of all flights; everybody computes the same delays from them."""
        known: dict[int, Mat] = {self.id: self.timed_path(route)}
        for _ in range(max(1, self.graph.diameter())):
            heard = await self.neighbors_exchange(known, channel="start")
            for paths in heard.values():
                known.update({int(j): np.asarray(path) for j, path in paths.items()})
        flying = {j: path for j, path in known.items() if len(path) > 1}
        delays = await self.member.clock.compute(start_delays, flying, CLEARANCE)
        return {j: delays.get(j, 0.0) for j in known}

    async def fly_route(self, route: Route, delay: float, solution: Solution) -> None:
        """Wait, take off, serve stop by stop, come home, land."""
        self.member.report = lambda: {"task": f"waiting {delay:g} s for its start", "cost": solution.cost}
        await self.sleep(delay)
        self.member.report = lambda: {
            "task": f"flying: {len(self.served)}/{len(route.stops)} stops", "cost": solution.cost,
        }  # fmt: skip
        await self.take_off()
        for stop in route.stops:
            await self.go_to(self.place(stop.task, stop.kind))
            await self.sleep(self.service_time)
            self.served.append({"task": stop.task, "kind": stop.kind})
        await self.go_to(self.above_home())
        self.member.report = lambda: {"task": f"landing: {len(self.served)} stops", "cost": solution.cost}
        await self.land()

    def place(self, task: int, kind: str) -> Vec:
        """(3,) m of a pickup or delivery; a point of the plane is visited at take-off height."""
        tasks = self.problem.tasks
        p = (tasks.pickup if kind == "pickup" else tasks.delivery)[task]
        return np.array([*p[:2], p[2] if len(p) == 3 else self.above_home()[2]])

    def above_home(self) -> Vec:
        """(3,) m where the flight begins and ends."""
        flight, home = self.member.config.flight, self.member.config.drone(self.id).home
        return np.array([home[0], home[1], flight.ground + flight.takeoff_height])

    def timed_path(self, route: Route) -> Mat:
        """(T, 3) m: where the drone will be, every STEP s, from take-off to touch-down; one point if it stays."""
        flight = self.member.config.flight
        home = np.array(self.member.config.drone(self.id).home)
        if not route.stops:
            return home[None, :]
        stops = [self.place(stop.task, stop.kind) for stop in route.stops]
        points = [home, self.above_home(), *stops, self.above_home()]
        pauses = [0.0, *[self.service_time] * len(stops), 0.0]
        plans = [self._flight(a, b) for a, b in pairwise(points)]
        ends = np.cumsum([plan.duration + pause for plan, pause in zip(plans, pauses, strict=True)])
        times = np.arange(0.0, ends[-1], STEP)
        starts = np.concatenate([[0.0], ends[:-1]])
        leg = np.searchsorted(ends, times, "right")
        way = [plans[n].sample(t - starts[n]).p for n, t in zip(leg, times, strict=True)]
        seconds = PEAK_SPEED * flight.takeoff_height / flight.landing_speed
        down = np.linspace(self.above_home(), home, round(seconds / STEP) + 1)
        return np.vstack([way, down])

    def _flight(self, a: Vec, b: Vec) -> PointToPoint:
        flight, start = self.member.config.flight, FullState.at(a)
        return PointToPoint(start, b, 0.0, duration_for(start, b, 0.0, flight.speed_limit, flight.acceleration_limit))

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
            "plan_digest": solution.plan_digest,
        }
