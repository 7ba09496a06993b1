"""A pickup-and-delivery instance, and the part of it that one robot sees."""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from crazychoir.errors import ConfigError, InstanceError
from crazychoir.routing.instance.fields import Fields, read
from crazychoir.routing.instance.plan import Plan, Route
from crazychoir.routing.instance.servable import require_servable
from crazychoir.routing.instance.vehicle import MAKESPAN, TOTAL, VEHICLES, Vehicle
from crazychoir.types import Mat, Vec

MOST_WEIGHT = 1e6
"""Of a refusal, in costs of plans: above it a solver's tolerances are as large as a route."""
PUBLIC = ("robot", "robots", "tasks", "objective")
"""Fields of a LocalProblem that all robots have in common, or that names it."""
OBJECTIVES = ((TOTAL,), (MAKESPAN,), (TOTAL, MAKESPAN), (MAKESPAN, TOTAL))
"""What any team may minimise."""
VEHICLES_FIRST = (VEHICLES, TOTAL)
"""What a team of robots may minimise whose fixed costs are alike, and that serves all tasks."""


@dataclass(frozen=True, eq=False)
class Tasks:
    """The public list of goods.

    pickup, delivery: (M, 2) or (M, 3) m;  load: (M,);
    service: (2M,) s, at pickups, then at deliveries;  earliest, latest: (2M,) s, when service may begin, a pickup not
    before its release;  penalty: (M,), what it costs to refuse the task, inf if it must be served;
    priority: (M,) whole numbers: tasks of a higher one are refused later;
    span: more than any plan without refusals costs, known to all; used where there are priorities.
    """

    pickup: Mat
    delivery: Mat
    load: Vec
    service: Vec = field(default_factory=lambda: np.empty(0))
    earliest: Vec = field(default_factory=lambda: np.empty(0))
    latest: Vec = field(default_factory=lambda: np.empty(0))
    penalty: Vec = field(default_factory=lambda: np.empty(0))
    priority: npt.NDArray[np.int64] = field(
        default_factory=lambda: np.empty(0, np.int64)
    )
    span: float = 0.0

    def __post_init__(self) -> None:
        m = len(self.load)
        defaults = {
            "service": (2 * m, 0.0),
            "earliest": (2 * m, 0.0),
            "latest": (2 * m, math.inf),
            "penalty": (m, math.inf),
            "priority": (m, 0),
        }
        for name, (size, value) in defaults.items():
            if len(getattr(self, name)) == 0:
                object.__setattr__(self, name, np.full(size, value))

    def __len__(self) -> int:
        return len(self.load)

    @cached_property
    def refusal(self) -> Vec:
        """(M,), what leaving a task out costs where plans are compared: inf if it must be served.

            priority 0:  penalty_j
            priority p:  penalty_j + W_p,   W_p = span + sum of all penalties + sum_{j of priority 1..p-1} W_(p_j)

        So plans are compared by how many tasks of the highest priority are refused, then of the next, ..., of 1, and
        then by the objective with the penalties.
        """
        cost = self.penalty.astype(float)
        refusable = np.isfinite(self.penalty)
        weight = self.span + float(self.penalty[refusable].sum())
        for p in np.unique(self.priority[(self.priority > 0) & refusable]):
            same = (self.priority == p) & refusable
            cost[same] += weight
            weight *= 1 + int(same.sum())
        return cost

    def to_json(self) -> dict[str, Any]:
        """A JSON object of all fields: what robots must have in common."""
        return {
            name: _plain(value)
            for name, value in vars(self).items()
            if name != "refusal"
        }


@dataclass(frozen=True, eq=False)
class LocalProblem:
    """What robot `robot` of `robots` knows: its own home, capacity, limit and capability, and the public goods.

    home: (2,) or (3,) m;  capacity: units of load;  limit: m of each trip, inf if none;  capable: (M,) bool; where a
    task is aboard another robot it is False;  end: (d,) m, home if None;  open_tour: whether it ends where it likes;
    distance: (2M + 1, 2M + 1) m, own pickups, deliveries, home, Euclidean if None;  speed: m/s;
    window: s, when it may leave home, and must be back;  initial_load: part of the capacity in use all the time;
    fixed: cost of leaving home, the `vehicle_weight` of the instance where vehicles are counted first;
    trips: at most;  objective: what the team minimises, in order.
    In flight:
    start: (d,) m, where it is or will be at start_time;  aboard: (M,) bool, tasks whose goods it carries;
    left: m, what is left of the limit of its present trip.
    """

    robot: int
    robots: int
    home: Vec
    capacity: float
    limit: float
    capable: npt.NDArray[np.bool_]
    tasks: Tasks
    end: Vec | None = None
    open_tour: bool = False
    distance: Mat | None = None
    speed: float = 1.0
    window: tuple[float, float] = (0.0, math.inf)
    initial_load: float = 0.0
    fixed: float = 0.0
    trips: int = 1
    objective: tuple[str, ...] = (TOTAL,)
    start: Vec | None = None
    start_time: float = 0.0
    aboard: npt.NDArray[np.bool_] | None = None
    left: float | None = None

    @cached_property
    def vehicle(self) -> Vehicle:
        """As the kernels see it. Raises ConfigError for a start away from home where distances are a matrix."""
        m = len(self.tasks)
        distance = self._between()
        service = np.concatenate([self.tasks.service, [0.0, 0.0]])
        if self.open_tour:
            distance[:, 2 * m + 1] = 0.0
        aboard = np.zeros(m, dtype=bool) if self.aboard is None else self.aboard
        way_home = float(distance[2 * m, 2 * m + 1])
        return Vehicle(
            distance=distance,
            duration=service[:, None] + distance / self.speed,
            earliest=np.concatenate(
                [self.tasks.earliest, [max(self.start_time, self.window[0]), 0.0]]
            ),
            latest=np.concatenate([self.tasks.latest, [math.inf, self.window[1]]]),
            load=self.tasks.load,
            capacity=self.capacity - self.initial_load,
            limit=self.limit if self.left is None else self.left,
            capable=self.capable,
            aboard=aboard,
            fixed=self.fixed if self.start is None else -way_home,
            trips=self.trips,
            limit_again=self.limit,
            robot=self.robot,
            metric=self.distance is None,
        )

    @property
    def servable(self) -> npt.NDArray[np.int64]:
        """Indices, increasing, of the tasks that one of its routes could hold."""
        return self.vehicle.servable

    def _between(self) -> Mat:
        """(2M + 2, 2M + 2) m: pickups, deliveries, start, end."""
        m = len(self.tasks)
        if self.distance is not None:
            if self.start is not None or self.end is not None:
                found = "a start or an end beside a matrix of distances"
                do = "Give points and no matrix, or none."
                raise ConfigError(
                    f"robot {self.robot}: start, end",
                    found,
                    "none: the matrix has no row for it",
                    do,
                )
            nodes = [*range(2 * m + 1), 2 * m]
            return self.distance[np.ix_(nodes, nodes)]
        start = self.home if self.start is None else self.start
        end = self.home if self.end is None else self.end
        points = np.vstack([self.tasks.pickup, self.tasks.delivery, start, end])
        return np.asarray(
            np.sqrt(((points[:, None] - points[None, :]) ** 2).sum(axis=2))
        )


def kinds(robots: Mapping[int, LocalProblem]) -> list[tuple[int, ...]]:
    """The robots, those together that differ by their ids alone, in the order of their ids."""
    groups: dict[tuple[bytes | None, ...], list[int]] = {}
    for i in sorted(robots):
        own = [
            getattr(robots[i], f.name)
            for f in fields(LocalProblem)
            if f.name not in PUBLIC
        ]
        told = tuple(
            None if value is None else np.asarray(value, float).tobytes()
            for value in own
        )
        groups.setdefault(told, []).append(i)
    return [tuple(group) for group in groups.values()]


@dataclass(frozen=True, eq=False)
class Instance:
    """N robots, M goods; robot i flies a closed tour from home_i and back, or to end_i, or where it likes, or stays.

        min  sum_i length_i + sum_{j refused} penalty_j
        s.t. every good not refused picked up and then delivered by one robot i,
             load on board + initial_load_i <= capacity_i,  each trip <= route_length_limit,  capability_ij,
             service in its window, after the way and the service before it

    home, end: (N, d) m, d = 2 or 3;  capacity, initial_load: (N,);  speed: (N,) m/s;  capability: (N, M) bool;
    distance: (N + 2M, N + 2M) m, rows homes, pickups, deliveries, or (N, N + 2M, N + 2M), one a robot; None: Euclidean;
    window: (N, 2) s, when robot i may leave home, and must be back;  recharge: most trips of a robot, each with the
    whole route_length_limit;  fixed_cost: of each robot that leaves home;  objective: what is minimised, in order:
    "total" as above, or "makespan", the time in s when the last robot is done, instead of the sum of lengths; or
    "vehicles", the number of robots that leave home, before the total.
    """

    home: Mat
    capacity: Vec
    capability: npt.NDArray[np.bool_]
    tasks: Tasks
    route_length_limit: float = math.inf
    name: str = "instance"
    end: Mat | None = None
    open_tours: bool = False
    distance: npt.NDArray[np.float64] | None = None
    speed: Vec = field(default_factory=lambda: np.empty(0))
    window: Mat = field(default_factory=lambda: np.empty((0, 2)))
    initial_load: Vec = field(default_factory=lambda: np.empty(0))
    fixed_cost: float = 0.0
    recharge: int = 1
    objective: tuple[str, ...] = (TOTAL,)

    def __post_init__(self) -> None:
        n = len(self.home)
        defaults = {
            "speed": np.ones(n),
            "window": np.tile([0.0, math.inf], (n, 1)),
            "initial_load": np.zeros(n),
        }
        for name, value in defaults.items():
            if len(getattr(self, name)) == 0:
                object.__setattr__(self, name, value)

    @classmethod
    def load(cls, path: str | Path) -> "Instance":
        """Read a JSON file, or one of Li and Lim; raise InstanceError naming file, key and index of what is wrong."""
        raw, names = read(path)
        return cls.parse(raw, str(path), names)

    @classmethod
    def parse(
        cls, raw: dict[str, Any], where: str = "instance", names: Sequence[str] = ()
    ) -> "Instance":
        """From the JSON object `raw`; `where` is what errors call it, `names` what they call its tasks."""
        fields = Fields(raw, where)
        points = {key: fields.points(key) for key in ("home", "pickup", "delivery")}
        load = fields.amounts("load")
        capacity = fields.amounts("capacity")
        pickup, delivery, home = (
            fields.windows(key) for key in ("pickup", "delivery", "home")
        )
        stops = np.vstack([pickup, delivery])
        stops[: len(pickup), 0] = np.maximum(pickup[:, 0], fields.times("release"))
        instance = cls(
            home=points["home"],
            capacity=capacity,
            capability=fields.mask("capability"),
            tasks=Tasks(
                points["pickup"],
                points["delivery"],
                load,
                fields.service(),
                stops[:, 0].copy(),
                stops[:, 1].copy(),
                fields.penalties("penalty"),
                fields.levels("priority"),
            ),
            route_length_limit=fields.limit("route_length_limit"),
            name=where,
            end=fields.ends("end"),
            open_tours=fields.flag("open_tours"),
            distance=fields.matrices("distance"),
            speed=fields.speeds("speed"),
            window=home,
            initial_load=fields.part_of("initial_load", capacity),
            fixed_cost=fields.cost("fixed_cost"),
            recharge=fields.trips("recharge"),
            objective=fields.objective("objective", (*OBJECTIVES, VEHICLES_FIRST)),
        )
        instance = replace(
            instance, tasks=replace(instance.tasks, span=instance._span())
        )
        instance._require_few_priorities()
        instance._require_countable()
        vehicles = [instance.local(same[0]).vehicle for same in instance.kinds()]
        require_servable(vehicles, instance.tasks.penalty, where, names)
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
            end=None if self.end is None else self.end[i],
            open_tour=self.open_tours,
            distance=self._distance_of(i),
            speed=float(self.speed[i]),
            window=(float(self.window[i, 0]), float(self.window[i, 1])),
            initial_load=float(self.initial_load[i]),
            fixed=self.vehicle_weight
            if VEHICLES in self.objective
            else self.fixed_cost,
            trips=self.recharge,
            objective=self.objective,
        )

    @cached_property
    def vehicle_weight(self) -> float:
        """m, what a vehicle costs in the linear programs, where vehicles are counted first.

            W >= 2 T,    T = 3M times the longest way, so that  T_a <= T  for the total T_a of every plan a
            n_a < n_b  =>  W n_a + T_a < W n_b + T_b,      and  W n_a + T_a >= V  =>  n_a >= V / W - 1/2

        A plan has 2M stops and at most M trips, as each trip serves a task, so it has at most 3M ways. W is a power of
        two: adding it rounds little. Plans are not compared by W, but by their vehicles and then by their totals.
        """
        if self.distance is not None:
            longest = float(self.distance.max())
        else:
            ends = [] if self.end is None else [self.end]
            points = np.vstack(
                [self.home, *ends, self.tasks.pickup, self.tasks.delivery]
            )
            longest = float(np.linalg.norm(np.ptp(points, axis=0)))
        total = 3 * len(self.tasks) * longest
        return 2.0 ** math.ceil(math.log2(2.0 * total)) if total > 0.0 else 1.0

    def plan(self, routes: Iterable[Route]) -> Plan:
        """The plan of these routes, with what they leave undone."""
        flown = tuple(routes)
        refused = np.ones(len(self.tasks), dtype=bool)
        refused[
            [j for route in flown for j in route.tasks if 0 <= j < len(refused)]
        ] = False
        return Plan(
            flown,
            math.fsum(self.tasks.penalty[refused]),
            self.fixed_cost,
            self.objective,
        )

    def kinds(self) -> list[tuple[int, ...]]:
        """The robots, identical ones together, in the order of their ids."""
        return kinds({i: self.local(i) for i in range(self.robots)})

    def to_json(self) -> dict[str, Any]:
        """The JSON object that `parse` reads back."""
        tasks = self.tasks
        raw: dict[str, Any] = {
            "home": self.home.tolist(),
            "pickup": tasks.pickup.tolist(),
            "delivery": tasks.delivery.tolist(),
            "load": tasks.load.tolist(),
            "capacity": self.capacity.tolist(),
            "route_length_limit": _plain(self.route_length_limit),
            "capability": self.capability.tolist(),
        }
        raw |= {"end": self.end.tolist()} if self.end is not None else {}
        raw |= {"distance": self.distance.tolist()} if self.distance is not None else {}
        return raw | {
            "open_tours": self.open_tours,
            "speed": self.speed.tolist(),
            "service_time": _halves(tasks.service.tolist()),
            "time_windows": _halves(
                _plain(np.column_stack([tasks.earliest, tasks.latest]))
            )
            | {"home": _plain(self.window)},
            "initial_load": self.initial_load.tolist(),
            "penalty": _plain(tasks.penalty),
            "priority": tasks.priority.tolist(),
            "fixed_cost": self.fixed_cost,
            "recharge": self.recharge,
            "objective": list(self.objective),
        }

    def _distance_of(self, i: int) -> Mat | None:
        """(2M + 1, 2M + 1) m: pickups, deliveries, home of robot i."""
        if self.distance is None:
            return None
        nodes = [*range(self.robots, self.distance.shape[-1]), i]
        own = self.distance[i] if self.distance.ndim == 3 else self.distance
        return np.asarray(own[np.ix_(nodes, nodes)])

    def _span(self) -> float:
        """More than any plan without refusals costs: so many legs, each as long as the longest."""
        legs = 3 * len(self.tasks) + 2 * self.robots
        vehicles = [self.local(same[0]).vehicle for same in self.kinds()]
        if self.objective[0] != MAKESPAN:
            return (
                legs * max(float(v.distance.max()) for v in vehicles)
                + self.robots * self.fixed_cost
            )
        return legs * max(
            float(v.duration.max()) + float(v.earliest.max()) for v in vehicles
        )

    def _require_countable(self) -> None:
        """InstanceError for what says nothing, or the opposite, where vehicles are counted first."""
        if VEHICLES not in self.objective:
            return
        if np.isfinite(self.tasks.penalty).any():
            found = (
                f"the objective {list(self.objective)} beside tasks that may be refused"
            )
            do = "Without any task there would be no vehicle: delete penalty, or take another objective."
            raise InstanceError(
                f"{self.name}: penalty", found, "null for every task", do
            )
        if self.fixed_cost > 0.0:
            found = f"{self.fixed_cost:g} beside the objective {list(self.objective)}"
            do = "The number of vehicles is minimised before all lengths: delete fixed_cost, or take another objective."
            raise InstanceError(
                f"{self.name}: fixed_cost", found, "0, or no such key", do
            )

    def _require_few_priorities(self) -> None:
        refusal = self.tasks.refusal[np.isfinite(self.tasks.refusal)]
        if len(refusal) and refusal.max() > MOST_WEIGHT * max(1.0, self.tasks.span):
            found = f"{len(np.unique(self.tasks.priority))} levels over {len(refusal)} tasks"
            allowed = f"so few that the weights stay below {MOST_WEIGHT:g} times the cost of a plan"
            raise InstanceError(
                f"{self.name}: priority", found, allowed, "Use fewer levels."
            )


def _plain(value: Any) -> Any:
    """As JSON has it: lists, and null for what is infinite."""
    if isinstance(value, np.ndarray | list):
        return [
            _plain(part)
            for part in (value.tolist() if isinstance(value, np.ndarray) else value)
        ]
    return None if value == math.inf else value


def _halves(values: list[Any]) -> dict[str, list[Any]]:
    """Of stops: pickups, then deliveries."""
    m = len(values) // 2
    return {"pickup": values[:m], "delivery": values[m:]}
