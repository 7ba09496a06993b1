"""What the solvers of `bench routing` share: the instance as they take it, and their answer.

A solver gets one JSON argument (instance: a file, and what it needs) and answers with one JSON line. It imports nothing
else of crazychoir: OR-tools and HiGHS cannot share a process.
"""

import json
import os
import sys
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

Ints = npt.NDArray[np.int64]
Routes = dict[int, list[int]]
"""Of each robot its stops: j is the pickup of task j, M + j its delivery."""


@dataclass(frozen=True)
class Problem:
    """distance: (N + 2M, N + 2M) m, rows: homes, pickups, deliveries;  load: (M,), capacity: (N,);  limit: m."""

    distance: npt.NDArray[np.float64]
    load: Ints
    capacity: Ints
    capability: npt.NDArray[np.bool_]
    limit: float

    @classmethod
    def load_from(cls, path: str) -> "Problem":
        """From an instance file; loads and capacities must be whole numbers there, as these solvers have them."""
        raw = json.loads(Path(path).read_text(encoding="utf-8"))
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
        """N."""
        return len(self.capacity)

    @property
    def tasks(self) -> int:
        """M."""
        return len(self.load)

    def whole(self, scale: float) -> Ints:
        """The distances in 1 / scale m, rounded up: a route that keeps the limit in them keeps it."""
        return np.ceil(self.distance * scale - 1e-9).astype(np.int64)

    def longest(self, scale: float) -> int:
        """The limit in 1 / scale m, rounded down; without one, more than any route is long."""
        limit = min(self.limit, 2.0 * float(self.distance.max()) * (self.tasks + 1))
        return int(np.floor(limit * scale + 1e-9))

    def cost(self, routes: Routes) -> float:
        """m, of closed tours."""
        return sum(self._length(i, stops) for i, stops in routes.items() if stops)

    def _length(self, i: int, stops: list[int]) -> float:
        tour = [i, *(self.robots + v for v in stops), i]
        return float(self.distance[tour[:-1], tour[1:]].sum())

    def serves_all(self, routes: Routes) -> bool:
        """Whether every task is in some route."""
        return sum(map(len, routes.values())) == 2 * self.tasks


class Best:
    """The best plan so far, and when each better one came: curve, [[s, m], ...]."""

    def __init__(self, problem: Problem) -> None:
        self.problem = problem
        self.routes: Routes | None = None
        self.cost = np.inf
        self.curve: list[list[float]] = []
        self._began = time.perf_counter()

    def elapsed(self) -> float:
        """s since the start."""
        return time.perf_counter() - self._began

    def offer(self, routes: Routes) -> None:
        """Keep it if it serves all tasks and costs less."""
        cost = self.problem.cost(routes)
        if self.problem.serves_all(routes) and cost < self.cost:
            self.routes = routes
            self.cost = cost
            self.curve.append([self.elapsed(), cost])


def end_with_parent() -> None:
    """From here on the end of standard input is ours."""
    threading.Thread(
        target=lambda: os._exit(len(sys.stdin.read())), daemon=True
    ).start()


def answer(solve: Callable[[dict[str, Any], Problem, Best], str]) -> None:
    """Solve the instance of the argument; `solve` returns what there is to remark."""
    end_with_parent()
    spec = json.loads(sys.argv[1])
    problem = Problem.load_from(spec["instance"])
    cpu = time.process_time()
    best = Best(problem)
    note = solve(spec, problem, best)
    routes = [{"robot": i, "nodes": stops} for i, stops in (best.routes or {}).items()]
    found = {
        "routes": routes if best.routes is not None else None,
        "wall_s": best.elapsed(),
        "curve": best.curve,
    }
    sys.stdout.write(
        json.dumps(found | {"cpu_s": time.process_time() - cpu, "note": note}) + "\n"
    )


def _whole(values: list[float], what: str) -> Ints:
    whole = np.array(values).round().astype(np.int64)
    if not np.array_equal(whole, values):
        raise SystemExit(f"{what}: this solver takes whole numbers only")
    return whole
