"""A pickup-and-delivery instance, and the part of it that one robot sees."""

import math
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from crazychoir.errors import InstanceError
from crazychoir.routing.instance_file import Fields, read
from crazychoir.types import Mat, Vec

SLACK = 1e-9
"""Loads and lengths may exceed their limits by this much: rounding of a sum, not a licence."""


@dataclass(frozen=True, eq=False)
class Tasks:
    """The public list of goods: pickup and delivery (M, 2) or (M, 3) m, load (M,)."""

    pickup: Mat
    delivery: Mat
    load: Vec

    def __len__(self) -> int:
        return len(self.load)


@dataclass(frozen=True, eq=False)
class LocalProblem:
    """What robot `robot` of `robots` knows: its own home, capacity, limit and capability, and the public goods.

    home: (2,) or (3,) m;  capacity: units of load;  limit: m, inf if none;  capable: (M,) bool.
    """

    robot: int
    robots: int
    home: Vec
    capacity: float
    limit: float
    capable: npt.NDArray[np.bool_]
    tasks: Tasks

    @cached_property
    def distance(self) -> Mat:
        """(2M + 1, 2M + 1) m, Euclidean; rows: pickups 0..M-1, deliveries M..2M-1, home 2M."""
        points = np.vstack([self.tasks.pickup, self.tasks.delivery, self.home])
        return np.asarray(np.sqrt(((points[:, None] - points[None, :]) ** 2).sum(axis=2)))

    @cached_property
    def servable(self) -> npt.NDArray[np.int64]:
        """Indices, increasing, of the tasks that this robot can do on a tour of their own."""
        alone = self.alone(np.arange(len(self.tasks)))
        fits = self.capable & (self.tasks.load <= self.capacity + SLACK) & (alone <= self.limit + SLACK)
        return np.flatnonzero(fits)

    def alone(self, j: Any) -> Any:
        """m, of the tour for task j alone; for indices (K,) it is (K,)."""
        m, d = len(self.tasks), self.distance
        return d[2 * m, j] + d[j, m + j] + d[m + j, 2 * m]


@dataclass(frozen=True, eq=False)
class Instance:
    """N robots, M goods; robot i flies a closed tour from home_i and back, or stays.

        min  sum_i length_i   s.t.  every good picked up and then delivered by one robot i,
             load on board <= capacity_i,  length_i <= route_length_limit,  capability_ij

    home: (N, d) m, capacity: (N,), capability: (N, M) bool, d = 2 or 3.
    """

    home: Mat
    capacity: Vec
    capability: npt.NDArray[np.bool_]
    tasks: Tasks
    route_length_limit: float = math.inf
    name: str = "instance"

    @classmethod
    def load(cls, path: str | Path) -> "Instance":
        """Read a JSON file; raise InstanceError naming file, key and index of what is wrong."""
        return cls.parse(read(path), str(path))

    @classmethod
    def parse(cls, raw: dict[str, Any], where: str = "instance") -> "Instance":
        """From the JSON object `raw`; `where` is what errors call it."""
        fields = Fields(raw, where)
        tasks = Tasks(fields.points("pickup"), fields.points("delivery"), fields.amounts("load"))
        instance = cls(
            home=fields.points("home"),
            capacity=fields.amounts("capacity"),
            capability=fields.mask("capability"),
            tasks=tasks,
            route_length_limit=fields.limit("route_length_limit"),
            name=where,
        )
        instance._require_servable()
        return instance

    @property
    def robots(self) -> int:
        """N."""
        return len(self.home)

    def local(self, i: int) -> LocalProblem:
        """What robot i knows."""
        return LocalProblem(
            robot=i,
            robots=self.robots,
            home=self.home[i],
            capacity=float(self.capacity[i]),
            limit=self.route_length_limit,
            capable=self.capability[i],
            tasks=self.tasks,
        )

    def to_json(self) -> dict[str, Any]:
        """The JSON object that `parse` reads back."""
        limit = None if math.isinf(self.route_length_limit) else self.route_length_limit
        return {
            "home": self.home.tolist(),
            "pickup": self.tasks.pickup.tolist(),
            "delivery": self.tasks.delivery.tolist(),
            "load": self.tasks.load.tolist(),
            "capacity": self.capacity.tolist(),
            "route_length_limit": limit,
            "capability": self.capability.tolist(),
        }

    def _require_servable(self) -> None:
        """Raise InstanceError for a good that no robot can bring home alone."""
        served = np.zeros(len(self.tasks), dtype=bool)
        for i in range(self.robots):
            served[self.local(i).servable] = True
        for j in np.flatnonzero(~served):
            found, allowed, do = self._why_unservable(int(j))
            raise InstanceError(f"{self.name}: task {j}", found, allowed, do)

    def _why_unservable(self, j: int) -> tuple[str, str, str]:
        """The limit that keeps the last robot from task j alone: what was found, what is allowed, what to do."""
        capable = [i for i in range(self.robots) if self.capability[i, j]]
        if not capable:
            return "no robot that is capable of it", "at least one", f"Look at column {j} of capability."
        load = float(self.tasks.load[j])
        carriers = [i for i in capable if load <= self.capacity[i] + SLACK]
        if not carriers:
            most = f"{max(self.capacity[i] for i in capable):g}, the largest capacity of the robots capable of it"
            return f"load {load:g}", f"at most {most}", f"Look at load[{j}], capacity, and column {j} of capability."
        shortest, robot = min((self.local(i).alone(j), i) for i in carriers)
        found = f"a tour of {shortest:.6g} m for it alone, by robot {robot}, the shortest of those that can carry it"
        allowed = f"at most {self.route_length_limit:g} m, the route_length_limit"
        return found, allowed, f"Look at route_length_limit, home, pickup[{j}] and delivery[{j}]."
