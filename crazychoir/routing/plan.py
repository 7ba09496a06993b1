"""A plan: who flies where, in which order; and what a solver reports of it."""

import hashlib
import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any, Literal

Kind = Literal["pickup", "delivery"]


@dataclass(frozen=True)
class Stop:
    """One stop of a route."""

    task: int
    kind: Kind


@dataclass(frozen=True)
class Route:
    """A closed tour of one robot: home, the stops, home; length in m."""

    robot: int
    stops: tuple[Stop, ...]
    length: float

    @classmethod
    def from_nodes(cls, robot: int, nodes: Sequence[int], tasks: int, length: float) -> "Route":
        """From nodes j (pickup of task j) and M + j (its delivery), M = tasks."""
        stops = tuple(Stop(v, "pickup") if v < tasks else Stop(v - tasks, "delivery") for v in nodes)
        return cls(robot, stops, length)

    @property
    def tasks(self) -> tuple[int, ...]:
        """The tasks served, increasing."""
        return tuple(sorted(stop.task for stop in self.stops if stop.kind == "pickup"))

    def to_json(self) -> dict[str, Any]:
        """A JSON object: robot, stops [{task, kind}], length."""
        return {"robot": self.robot, "stops": [asdict(stop) for stop in self.stops], "length": self.length}

    @classmethod
    def from_json(cls, raw: dict[str, Any]) -> "Route":
        """What `to_json` wrote."""
        return cls(raw["robot"], tuple(Stop(s["task"], s["kind"]) for s in raw["stops"]), raw["length"])

    @property
    def digest(self) -> str:
        """SHA-256 of the canonical JSON of the route."""
        return sha256(self.to_json())


@dataclass(frozen=True)
class Plan:
    """The routes of the robots that fly, by robot id."""

    routes: tuple[Route, ...]

    def __post_init__(self) -> None:
        object.__setattr__(self, "routes", tuple(sorted((r for r in self.routes if r.stops), key=lambda r: r.robot)))

    @property
    def cost(self) -> float:
        """Sum of the route lengths in m, added by robot id."""
        return sum((route.length for route in self.routes), 0.0)

    @property
    def digest(self) -> str:
        """What identifies the plan: a hash of the hashes of its routes, so that it needs no route to be known."""
        return digest_of({route.robot: route.digest for route in self.routes})

    def to_json(self) -> dict[str, Any]:
        """A JSON object: cost, digest, routes."""
        return {"cost": self.cost, "digest": self.digest, "routes": [route.to_json() for route in self.routes]}

    @classmethod
    def from_json(cls, raw: dict[str, Any]) -> "Plan":
        """From the routes of what `to_json` wrote."""
        return cls(tuple(Route.from_json(route) for route in raw["routes"]))


@dataclass(frozen=True)
class Solution:
    """What one robot knows of the team's plan when its method ends.

    cost: m;  lower_bound: m, no plan at all costs less (None: unknown, bound_exact is False then);  bound_exact: it is
    proven, by exact pricing of all routes, which does not say that it is tight: a plan is proven optimal where its cost
    is the bound, and `resource` and `resource-argmax` prove weaker ones than `resource-columns`;  disclosed: what the
    robots told each other;  rounds: of communication;  routes: those that this robot knows.
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

    @property
    def plan(self) -> Plan:
        """The routes as a plan."""
        return Plan(self.routes)

    def to_json(self) -> dict[str, Any]:
        """A JSON object with the fields above."""
        raw = {k: v for k, v in self.__dict__.items() if k != "routes"}
        return raw | {"disclosed": list(self.disclosed), "routes": [route.to_json() for route in self.routes]}

    @classmethod
    def from_json(cls, raw: dict[str, Any]) -> "Solution":
        """What `to_json` wrote."""
        routes = tuple(Route.from_json(route) for route in raw["routes"])
        return cls(**(raw | {"disclosed": tuple(raw["disclosed"]), "routes": routes}))


def digest_of(routes: dict[int, str]) -> str:
    """The plan's digest from the digests of the routes of the robots that fly."""
    return sha256([[i, routes[i]] for i in sorted(routes)])


def sha256(value: Any) -> str:
    """SHA-256, in hex, of the canonical JSON of a value: sorted keys, no blanks, shortest floats."""
    text = json.dumps(value, sort_keys=True, separators=(",", ":"), allow_nan=False)
    return hashlib.sha256(text.encode()).hexdigest()
