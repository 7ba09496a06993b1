"""Shared code of the solvers of `bench routing`: the instance in their form, and their answer.

A solver gets one JSON argument (instance: a file, and options) and answers with one JSON line.
It imports nothing of crazychoir outside this folder, because OR-tools and HiGHS cannot share a process.
"""

import json
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from crazychoir.bench.peers.peers import end_with_parent, say

Ints = npt.NDArray[np.int64]
Routes = dict[int, list[int]]
"""The stops of each robot: j is the pickup of task j, M + j its delivery."""


@dataclass(frozen=True)
class Problem:
    """An instance of N robots and M tasks."""

    distance: npt.NDArray[np.float64]
    """(N + 2M, N + 2M) m; rows: homes, pickups, deliveries."""
    load: Ints
    """(M,) load of each task."""
    capacity: Ints
    """(N,) capacity of each robot, in the unit of load."""
    capability: npt.NDArray[np.bool_]
    """(N, M): whether the robot can serve the task."""
    limit: float
    """Largest length of a route, m."""

    @classmethod
    def load_from(cls, path: str) -> "Problem":
        """Read an instance file."""
        return cls.parse(json.loads(Path(path).read_text(encoding="utf-8")))

    @classmethod
    def parse(cls, raw: dict[str, Any]) -> "Problem":
        """Return the problem with the fields of an instance file.

        Its loads and capacities must be whole numbers, because these solvers need that.
        """
        points = np.array([*raw["home"], *raw["pickup"], *raw["delivery"]])
        limit = raw.get("route_length_limit")
        return cls(
            distance=np.sqrt(((points[:, None] - points[None, :]) ** 2).sum(axis=2)),
            load=_whole(raw["load"], "load"),
            capacity=_whole(raw["capacity"], "capacity"),
            capability=np.array(raw["capability"], bool),
            limit=np.inf if limit is None else float(limit),
        )

    @property
    def robots(self) -> int:
        """Number N of robots."""
        return len(self.capacity)

    @property
    def tasks(self) -> int:
        """Number M of tasks."""
        return len(self.load)

    def whole(self, scale: float) -> Ints:
        """Return the distances in 1 / scale m, rounded up.

        So a route that keeps the limit in these units keeps the true limit.
        """
        return np.ceil(self.distance * scale - 1e-9).astype(np.int64)

    def longest(self, scale: float) -> int:
        """Return the limit in 1 / scale m, rounded down.

        Without a limit, return more than the length of any route.
        """
        limit = min(self.limit, 2.0 * float(self.distance.max()) * (self.tasks + 1))
        return int(np.floor(limit * scale + 1e-9))

    def cost(self, routes: Routes) -> float:
        """Return the length of closed tours, m."""
        return sum(self._length(i, stops) for i, stops in routes.items() if stops)

    def _length(self, i: int, stops: list[int]) -> float:
        tour = [i, *(self.robots + v for v in stops), i]
        return float(self.distance[tour[:-1], tour[1:]].sum())

    def serves_all(self, routes: Routes) -> bool:
        """Return whether every task is in some route."""
        return sum(map(len, routes.values())) == 2 * self.tasks


class BestPlan:
    """The best plan so far.

    curve: [[s, m], ...]: time and cost of each better plan
    """

    def __init__(self, problem: Problem) -> None:
        self.problem = problem
        self.routes: Routes | None = None
        self.cost = np.inf
        self.curve: list[list[float]] = []
        self._began = time.perf_counter()

    def elapsed(self) -> float:
        """Return the s since the start."""
        return time.perf_counter() - self._began

    def offer(self, routes: Routes) -> None:
        """Keep the plan if it serves all tasks and costs less."""
        cost = self.problem.cost(routes)
        if self.problem.serves_all(routes) and cost < self.cost:
            self.routes = routes
            self.cost = cost
            self.curve.append([self.elapsed(), cost])


def answer(solve: Callable[[dict[str, Any], Problem, BestPlan], str]) -> None:
    """Solve the instance of the argument and print the answer; `solve` returns the note."""
    end_with_parent()
    spec = json.loads(sys.argv[1])
    problem = Problem.load_from(spec["instance"])
    cpu = time.process_time()
    best = BestPlan(problem)
    note = solve(spec, problem, best)
    routes = [{"robot": i, "nodes": stops} for i, stops in (best.routes or {}).items()]
    found = {
        "routes": routes if best.routes is not None else None,
        "wall_s": best.elapsed(),
        "curve": best.curve,
    }
    say(found | {"cpu_s": time.process_time() - cpu, "note": note})


def say_plan(stops: dict[int, list[int]], note: str, began: float, cpu: float) -> None:
    """Print the answer of a program that finds a single plan.

    stops: nodes of the route of each robot; empty for no plan
    note: what the bench shows beside the plan
    began: s of time.perf_counter() when the program began
    cpu: s of time.process_time() when the program began
    """
    routes = [{"robot": i, "nodes": nodes} for i, nodes in stops.items()]
    say(
        {
            "routes": routes or None,
            "curve": [],
            "note": note,
            "wall_s": time.perf_counter() - began,
            "cpu_s": time.process_time() - cpu,
        }
    )


def _whole(values: list[float], what: str) -> Ints:
    whole = np.array(values).round().astype(np.int64)
    if not np.array_equal(whole, values):
        raise SystemExit(f"{what}: this solver takes whole numbers only")
    return whole
