"""OR-tools' routing library: transit matrices and guided local search from two first plans.

The better result counts.
"""

import importlib
import time
from dataclasses import dataclass
from typing import Any

import numpy as np

from crazychoir.bench.peers.routing import BestPlan, Problem, Routes, answer


@dataclass(frozen=True, slots=True)
class OrtoolsSettings:
    """Settings of the search with OR-tools."""

    length_scale: float = 10_000.0
    """Units of its whole numbers, 1/m."""
    wall_clock_factor: float = 3.0
    """Limit on the wall clock, as a multiple of the CPU time that it gets."""
    first_strategies: tuple[str, ...] = (
        "PARALLEL_CHEAPEST_INSERTION",
        "LOCAL_CHEAPEST_INSERTION",
    )
    """Strategies for the first plan."""


ORTOOLS_SETTINGS = OrtoolsSettings()


def solve(spec: dict[str, Any], problem: Problem, best: BestPlan) -> str:
    """Search for `seconds` of CPU from each first plan, in one thread; return the costs as text."""
    found = [
        f"{first.lower()}: {_cost(search(problem, first, spec['seconds'], best))}"
        for first in ORTOOLS_SETTINGS.first_strategies
    ]
    return "; ".join(found)


def search(problem: Problem, first: str, seconds: float, best: BestPlan) -> float:
    """Run one search; return the cost of its best plan in m, inf if it has none."""
    c = importlib.import_module("ortools.constraint_solver.pywrapcp")
    enums = importlib.import_module("ortools.constraint_solver.routing_enums_pb2")
    n = problem.robots
    manager = c.RoutingIndexManager(
        len(problem.distance), n, list(range(n)), list(range(n))
    )
    model = c.RoutingModel(manager)
    _add_rules(model, manager, problem)
    parameters = c.DefaultRoutingSearchParameters()
    parameters.first_solution_strategy = getattr(enums.FirstSolutionStrategy, first)
    parameters.local_search_metaheuristic = (
        enums.LocalSearchMetaheuristic.GUIDED_LOCAL_SEARCH
    )
    parameters.time_limit.FromMilliseconds(
        round(1000 * ORTOOLS_SETTINGS.wall_clock_factor * seconds)
    )

    def seen() -> None:
        best.curve.append(
            [best.elapsed(), model.CostVar().Max() / ORTOOLS_SETTINGS.length_scale]
        )

    ends = time.process_time() + seconds
    model.AddAtSolutionCallback(seen)
    model.AddSearchMonitor(
        model.solver().CustomLimit(lambda: time.process_time() > ends)
    )
    solution = model.SolveWithParameters(parameters)
    if solution is None:
        return float(np.inf)
    routes = _routes(model, manager, solution, n)
    best.offer(routes)
    return problem.cost(routes)


def _add_rules(model: Any, manager: Any, problem: Problem) -> None:
    n = problem.robots
    m = problem.tasks
    transit = model.RegisterTransitMatrix(
        problem.whole(ORTOOLS_SETTINGS.length_scale).tolist()
    )
    model.SetArcCostEvaluatorOfAllVehicles(transit)
    model.AddDimension(
        transit, 0, problem.longest(ORTOOLS_SETTINGS.length_scale), True, "length"
    )
    load = [0] * n + problem.load.tolist() + (-problem.load).tolist()
    carried = model.RegisterUnaryTransitVector(load)
    model.AddDimensionWithVehicleCapacity(
        carried, 0, problem.capacity.tolist(), True, "load"
    )
    length = model.GetDimensionOrDie("length")
    solver = model.solver()
    for j in range(m):
        pickup = manager.NodeToIndex(n + j)
        delivery = manager.NodeToIndex(n + m + j)
        model.AddPickupAndDelivery(pickup, delivery)
        solver.Add(model.VehicleVar(pickup) == model.VehicleVar(delivery))
        solver.Add(length.CumulVar(pickup) <= length.CumulVar(delivery))
        able = np.flatnonzero(problem.capability[:, j]).tolist()
        if len(able) < n:
            for stop in (pickup, delivery):
                model.VehicleVar(stop).SetValues([-1, *able])


def _routes(model: Any, manager: Any, solution: Any, robots: int) -> Routes:
    routes: Routes = {}
    for i in range(robots):
        at = solution.Value(model.NextVar(model.Start(i)))
        routes[i] = []
        while not model.IsEnd(at):
            routes[i].append(manager.IndexToNode(at) - robots)
            at = solution.Value(model.NextVar(at))
    return routes


def _cost(cost: float) -> str:
    return f"{cost:.3f} m" if np.isfinite(cost) else "no plan"


if __name__ == "__main__":
    answer(solve)
