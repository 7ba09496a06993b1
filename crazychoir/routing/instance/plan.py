"""A plan: which robot flies where, in which order; and the report of a solver."""

import hashlib
import json
import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from typing import Any, Literal

from crazychoir.routing.instance.vehicle import OBJECTIVE_NAMES

Kind = Literal["pickup", "delivery", "recharge"]
"""Kind of a stop."""
NO_TASK = -1
"""The task of a stop that only recharges."""


@dataclass(frozen=True)
class Stop:
    """One stop of a route. A stop to recharge is at the robot's end point and has task NO_TASK."""

    task: int
    """The task, NO_TASK for a recharge."""
    kind: Kind
    """What the robot does there."""


@dataclass(frozen=True)
class Route:
    """A route of one robot: home, the stops, and home or its end point."""

    robot: int
    """Id of the robot."""
    stops: tuple[Stop, ...]
    """The stops in order."""
    length: float
    """m."""
    finish: float | None = None
    """s: when the robot is done, None if it is not stated."""

    @classmethod
    def from_nodes(
        cls,
        robot: int,
        nodes: Sequence[int],
        tasks: int,
        length: float,
        finish: float | None = None,
    ) -> "Route":
        """Build the route from node numbers.

        robot: id of the robot.
        nodes: j is the pickup of task j, M + j its delivery, and 2M + 1 a recharge.
        tasks: M, the number of tasks.
        length: m.
        finish: s, when the robot is done.
        """
        return cls(
            robot, tuple(_decode_stop(int(v), tasks) for v in nodes), length, finish
        )

    @property
    def tasks(self) -> tuple[int, ...]:
        """The tasks served, increasing."""
        return tuple(
            sorted(stop.task for stop in self.stops if stop.kind == "delivery")
        )

    def to_json(self) -> dict[str, Any]:
        """Return a JSON object: robot, stops [{task, kind}], length, and finish if it is stated."""
        raw = {
            "robot": self.robot,
            "stops": [asdict(stop) for stop in self.stops],
            "length": self.length,
        }
        return raw if self.finish is None else raw | {"finish": self.finish}

    @classmethod
    def from_json(cls, raw: dict[str, Any]) -> "Route":
        """Return the route that `to_json` wrote."""
        stops = tuple(Stop(stop["task"], stop["kind"]) for stop in raw["stops"])
        return cls(raw["robot"], stops, raw["length"], raw.get("finish"))

    @property
    def digest(self) -> str:
        """SHA-256 of the canonical JSON of the route."""
        return hash_json(self.to_json())


@dataclass(frozen=True)
class RoutePlan:
    """The routes of the robots that fly, by robot id; `Instance.plan` fills in the rest."""

    routes: tuple[Route, ...]
    """One route for each robot that flies, sorted by robot id."""
    penalties: float = 0.0
    """Sum of the penalties of the refused tasks."""
    fixed_cost: float = 0.0
    """m: cost of each robot that flies."""
    objective: tuple[str, ...] = (OBJECTIVE_NAMES.total,)
    """Objectives, in order."""

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
        """s: when the last robot is done; nan if a route does not state it."""
        times = [
            math.nan if route.finish is None else route.finish for route in self.routes
        ]
        return math.nan if any(map(math.isnan, times)) else max(times, default=0.0)

    @property
    def values(self) -> tuple[float, ...]:
        """The values of the objectives, in order; the penalties are added to the first."""
        value = {
            OBJECTIVE_NAMES.total: self.total,
            OBJECTIVE_NAMES.makespan: self.makespan,
            OBJECTIVE_NAMES.vehicles: float(len(self.routes)),
        }
        first, *rest = (value[name] for name in self.objective)
        return (first + self.penalties, *rest)

    @property
    def cost(self) -> float:
        """The first objective in m or s, with the penalties; the second if the first is vehicles."""
        return (
            self.values[1]
            if self.objective[0] == OBJECTIVE_NAMES.vehicles
            else self.values[0]
        )

    @property
    def digest(self) -> str:
        """Hash that identifies the plan.

        It is a hash of the hashes of the routes, so it can be computed without the routes themselves.
        """
        return combine_digests({route.robot: route.digest for route in self.routes})

    def to_json(self) -> dict[str, Any]:
        """Return a JSON object: cost, digest, penalties, fixed_cost, objective, routes."""
        return {
            "cost": self.cost,
            "digest": self.digest,
            "penalties": self.penalties,
            "fixed_cost": self.fixed_cost,
            "objective": list(self.objective),
            "routes": [route.to_json() for route in self.routes],
        }

    @classmethod
    def from_json(cls, raw: dict[str, Any]) -> "RoutePlan":
        """Return the plan that `to_json` wrote."""
        routes = tuple(Route.from_json(route) for route in raw["routes"])
        return cls(routes, raw["penalties"], raw["fixed_cost"], tuple(raw["objective"]))


@dataclass(frozen=True)
class Solution:
    """The team's plan as one robot knows it when its method ends."""

    cost: float
    """m: cost of the plan."""
    feasible: bool
    """Whether the plan is feasible."""
    lower_bound: float | None
    """m: no plan costs less. None if unknown; `bound_exact` is False then.

    A plan is proven optimal if its cost equals the bound.
    """
    bound_exact: bool
    """Whether the bound is proven by exact pricing of all routes.

    This does not say that the bound is tight: `resource` and `resource-argmax` prove weaker bounds
    than `columns`.
    """
    method: str
    """Name of the method."""
    disclosed: tuple[str, ...]
    """Data that the robots disclosed to each other."""
    rounds: int
    """Number of communication rounds."""
    plan_digest: str
    """Hash of the plan."""
    routes: tuple[Route, ...]
    """The routes that this robot knows."""
    bytes_by_kind: dict[str, int] = field(default_factory=dict)
    """Bytes of payload that this robot sent, by subject, without headers and retransmissions."""
    bound_relaxation: str | None = None
    """Which further routes a bound that is not exact allows: "ng-route" routes may repeat tasks."""
    vehicles_bound: int | None = None
    """Proven lower bound on the number of vehicles if they are counted first; None if unknown.

    `lower_bound` then holds for plans with that number of vehicles. It is None if this plan has
    more.
    """
    ended_by: str | None = None
    """Why the computation was ended early: "seconds", "work" or "interrupted"; None if it was not."""
    work: int = 0
    """Search steps that the team made one after the other."""
    work_curve: tuple[tuple[int, float], ...] = ()
    """(search steps until then, cost) of each better plan."""

    @property
    def plan(self) -> RoutePlan:
        """The routes as a plan."""
        return RoutePlan(self.routes)

    @property
    def gap(self) -> float | None:
        """The share of the cost that a better plan could save at most; None without a bound."""
        return compute_gap(self.cost, self.lower_bound)

    def to_json(self) -> dict[str, Any]:
        """Return a JSON object with the fields above, and the gap."""
        raw = {k: v for k, v in self.__dict__.items() if k != "routes"}
        return raw | {
            "gap": self.gap,
            "disclosed": list(self.disclosed),
            "work_curve": [list(point) for point in self.work_curve],
            "routes": [route.to_json() for route in self.routes],
        }

    @classmethod
    def from_json(cls, raw: dict[str, Any]) -> "Solution":
        """Return the solution that `to_json` wrote."""
        routes = tuple(Route.from_json(route) for route in raw["routes"])
        curve = tuple((work, cost) for work, cost in raw["work_curve"])
        lists = {"disclosed": tuple(raw["disclosed"]), "work_curve": curve}
        fields = {name: value for name, value in raw.items() if name != "gap"}
        return cls(**(fields | lists | {"routes": routes}))


def compute_gap(cost: float | None, bound: float | None) -> float | None:
    """Return (cost - bound) / cost, from 0 to 1; None if one of them is unknown, and 0 at a cost of 0."""
    if cost is None or bound is None:
        return None
    return min(max((cost - bound) / cost, 0.0), 1.0) if cost else 0.0


def _decode_stop(node: int, tasks: int) -> Stop:
    if node > 2 * tasks:
        return Stop(NO_TASK, "recharge")
    return Stop(node, "pickup") if node < tasks else Stop(node - tasks, "delivery")


def combine_digests(routes: dict[int, str]) -> str:
    """Return the plan's digest from the digests of the routes of the robots that fly."""
    return hash_json([[i, routes[i]] for i in sorted(routes)])


def hash_json(value: Any) -> str:
    """Return the SHA-256, in hex, of the canonical JSON of a value.

    Canonical: sorted keys, no blanks, shortest floats.
    """
    text = json.dumps(value, sort_keys=True, separators=(",", ":"), allow_nan=False)
    return hashlib.sha256(text.encode()).hexdigest()
