"""A plan: who flies where, in which order; and what a solver reports of it."""

import hashlib
import json
import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from typing import Any, Literal

from crazychoir.routing.instance.vehicle import MAKESPAN, TOTAL, VEHICLES

Kind = Literal["pickup", "delivery", "recharge"]
NOTHING = -1
"""The task of a stop to recharge."""


@dataclass(frozen=True)
class Stop:
    """One stop of a route; a stop to recharge, where the robot ends, is of the task NOTHING."""

    task: int
    kind: Kind


@dataclass(frozen=True)
class Route:
    """A route of one robot: home, the stops, home, or where it ends; length in m.

    finish: s, when it is done; None if it is not stated.
    """

    robot: int
    stops: tuple[Stop, ...]
    length: float
    finish: float | None = None

    @classmethod
    def from_nodes(
        cls,
        robot: int,
        nodes: Sequence[int],
        tasks: int,
        length: float,
        finish: float | None = None,
    ) -> "Route":
        """From nodes j (pickup of task j), M + j (its delivery) and 2M + 1 (a recharge), M = tasks."""
        return cls(robot, tuple(_stop(int(v), tasks) for v in nodes), length, finish)

    @property
    def tasks(self) -> tuple[int, ...]:
        """The tasks served, increasing."""
        return tuple(
            sorted(stop.task for stop in self.stops if stop.kind == "delivery")
        )

    def to_json(self) -> dict[str, Any]:
        """A JSON object: robot, stops [{task, kind}], length, and finish if it is stated."""
        raw = {
            "robot": self.robot,
            "stops": [asdict(stop) for stop in self.stops],
            "length": self.length,
        }
        return raw if self.finish is None else raw | {"finish": self.finish}

    @classmethod
    def from_json(cls, raw: dict[str, Any]) -> "Route":
        """What `to_json` wrote."""
        stops = tuple(Stop(stop["task"], stop["kind"]) for stop in raw["stops"])
        return cls(raw["robot"], stops, raw["length"], raw.get("finish"))

    @property
    def digest(self) -> str:
        """SHA-256 of the canonical JSON of the route."""
        return sha256(self.to_json())


@dataclass(frozen=True)
class Plan:
    """The routes of the robots that fly, by robot id; `Instance.plan` fills in the rest.

    penalties: sum of those of the tasks that are refused;  fixed_cost: m, of each robot that flies;
    objective: what is minimised, in order.
    """

    routes: tuple[Route, ...]
    penalties: float = 0.0
    fixed_cost: float = 0.0
    objective: tuple[str, ...] = (TOTAL,)

    def __post_init__(self) -> None:
        object.__setattr__(
            self,
            "routes",
            tuple(sorted((r for r in self.routes if r.stops), key=lambda r: r.robot)),
        )

    @property
    def total(self) -> float:
        """Sum of the route lengths in m, added by robot id, and of the fixed costs."""
        return sum(
            (route.length for route in self.routes), 0.0
        ) + self.fixed_cost * len(self.routes)

    @property
    def makespan(self) -> float:
        """s, when the last robot is done; nan if a route does not state it."""
        times = [
            math.nan if route.finish is None else route.finish for route in self.routes
        ]
        return math.nan if any(map(math.isnan, times)) else max(times, default=0.0)

    @property
    def values(self) -> tuple[float, ...]:
        """What is minimised, in order: the objectives, the penalties added to the first."""
        value = {
            TOTAL: self.total,
            MAKESPAN: self.makespan,
            VEHICLES: float(len(self.routes)),
        }
        first, *rest = (value[name] for name in self.objective)
        return (first + self.penalties, *rest)

    @property
    def cost(self) -> float:
        """The first objective that is in m or s, with the penalties: where vehicles come first, the total."""
        return self.values[1] if self.objective[0] == VEHICLES else self.values[0]

    @property
    def digest(self) -> str:
        """What identifies the plan: a hash of the hashes of its routes, so that it needs no route to be known."""
        return digest_of({route.robot: route.digest for route in self.routes})

    def to_json(self) -> dict[str, Any]:
        """A JSON object: cost, digest, penalties, fixed_cost, objective, routes."""
        return {
            "cost": self.cost,
            "digest": self.digest,
            "penalties": self.penalties,
            "fixed_cost": self.fixed_cost,
            "objective": list(self.objective),
            "routes": [route.to_json() for route in self.routes],
        }

    @classmethod
    def from_json(cls, raw: dict[str, Any]) -> "Plan":
        """What `to_json` wrote."""
        routes = tuple(Route.from_json(route) for route in raw["routes"])
        return cls(routes, raw["penalties"], raw["fixed_cost"], tuple(raw["objective"]))


@dataclass(frozen=True)
class Solution:
    """What one robot knows of the team's plan when its method ends.

    cost: m;  lower_bound: m, no plan at all costs less (None: unknown, bound_exact is False then);  bound_exact: it is
    proven, by exact pricing of all routes, which does not say that it is tight: a plan is proven optimal where its cost
    is the bound, and `resource` and `resource-argmax` prove weaker ones than `columns`;  bound_relaxation: what
    routes a bound that is not exact allows beside those that there are: "ng-route", whose tasks may come again;
    disclosed: what the robots told each other;  rounds: of communication;  routes: those that this robot knows;
    bytes_by_kind: payloads that it sent, by what they were about, without headers and without what was sent again;
    vehicles_bound: where vehicles are counted first, no plan needs fewer (None: unknown). `lower_bound` then holds for
    the plans with that number of vehicles, and is None if this plan has more.
    """

    cost: float
    feasible: bool
    lower_bound: float | None
    bound_exact: bool
    method: str
    disclosed: tuple[str, ...]
    rounds: int
    plan_digest: str
    routes: tuple[Route, ...]
    bytes_by_kind: dict[str, int] = field(default_factory=dict)
    bound_relaxation: str | None = None
    vehicles_bound: int | None = None

    @property
    def plan(self) -> Plan:
        """The routes as a plan."""
        return Plan(self.routes)

    def to_json(self) -> dict[str, Any]:
        """A JSON object with the fields above."""
        raw = {k: v for k, v in self.__dict__.items() if k != "routes"}
        return raw | {
            "disclosed": list(self.disclosed),
            "routes": [route.to_json() for route in self.routes],
        }

    @classmethod
    def from_json(cls, raw: dict[str, Any]) -> "Solution":
        """What `to_json` wrote."""
        routes = tuple(Route.from_json(route) for route in raw["routes"])
        return cls(**(raw | {"disclosed": tuple(raw["disclosed"]), "routes": routes}))


def _stop(node: int, tasks: int) -> Stop:
    if node > 2 * tasks:
        return Stop(NOTHING, "recharge")
    return Stop(node, "pickup") if node < tasks else Stop(node - tasks, "delivery")


def digest_of(routes: dict[int, str]) -> str:
    """The plan's digest from the digests of the routes of the robots that fly."""
    return sha256([[i, routes[i]] for i in sorted(routes)])


def sha256(value: Any) -> str:
    """SHA-256, in hex, of the canonical JSON of a value: sorted keys, no blanks, shortest floats."""
    text = json.dumps(value, sort_keys=True, separators=(",", ":"), allow_nan=False)
    return hashlib.sha256(text.encode()).hexdigest()
