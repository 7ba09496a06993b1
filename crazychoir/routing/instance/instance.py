"""A pickup-and-delivery instance, and the part of it that one robot sees."""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from pathlib import Path
from typing import Any
from weakref import WeakValueDictionary

import numpy as np
import numpy.typing as npt

from crazychoir.errors import ConfigError, InstanceError
from crazychoir.routing.instance.fields import InstanceFields, read_instance_file
from crazychoir.routing.instance.legs import (
    Legs,
    measure_distances,
    measure_durations,
)
from crazychoir.routing.instance.plan import Route, RoutePlan
from crazychoir.routing.instance.servable import require_servable_tasks
from crazychoir.routing.instance.vehicle import OBJECTIVE_NAMES, Vehicle
from crazychoir.types import Ints, Mat, Vec

MOST_WEIGHT = 1e6
"""Largest allowed weight of a refused task, in multiples of a plan's cost.

Above it, the tolerances of a solver are as large as a route.
"""
PUBLIC_FIELDS = ("robot", "robots", "tasks", "objective")
"""Fields of a LocalProblem that are the same for all robots, or that name the robot."""
COMMON_OBJECTIVES = (
    (OBJECTIVE_NAMES.total,),
    (OBJECTIVE_NAMES.makespan,),
    (OBJECTIVE_NAMES.total, OBJECTIVE_NAMES.makespan),
    (OBJECTIVE_NAMES.makespan, OBJECTIVE_NAMES.total),
)
"""The objectives that every team may minimise."""
VEHICLES_FIRST = (OBJECTIVE_NAMES.vehicles, OBJECTIVE_NAMES.total)
"""An objective for teams in which all robots have the same fixed cost and serve every task."""


@dataclass(frozen=True, eq=False)
class Tasks:
    """The public list of tasks; M tasks, each with a pickup and a delivery.

    What is computed from the tasks is computed once for all robots of a process, and is read-only.
    """

    pickup: Mat
    """(M, 2) or (M, 3) m: where each task is picked up."""
    delivery: Mat
    """(M, 2) or (M, 3) m: where each task is delivered."""
    load: Vec
    """(M,) units of load."""
    service: Vec = field(default_factory=lambda: np.empty(0))
    """(2M,) s: service times at the pickups, then at the deliveries."""
    earliest: Vec = field(default_factory=lambda: np.empty(0))
    """(2M,) s: earliest begin of each service. For a pickup it is not before the release."""
    latest: Vec = field(default_factory=lambda: np.empty(0))
    """(2M,) s: latest begin of each service."""
    penalty: Vec = field(default_factory=lambda: np.empty(0))
    """(M,): cost of refusing the task, inf if the task must be served."""
    priority: npt.NDArray[np.int64] = field(
        default_factory=lambda: np.empty(0, np.int64)
    )
    """(M,) whole numbers: tasks of a higher priority are refused later."""
    span: float = 0.0
    """Upper bound on the cost of any plan without refusals, known to all robots.

    It is used if tasks have priorities.
    """

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
        """(M,): weight of refusing each task when plans are compared; inf if it must be served.

            priority 0:  penalty_j
            priority p:  penalty_j + W_p
            W_p = span + sum of all penalties + sum_{j of priority 1..p-1} W_(p_j)

        Plans are therefore compared first by the number of refused tasks of the highest priority,
        then of the next priority, ..., then of priority 1. Then the objective with the penalties
        decides.
        """
        cost = self.penalty.astype(float)
        refusable = np.isfinite(self.penalty)
        weight = self.span + float(self.penalty[refusable].sum())
        for p in np.unique(self.priority[(self.priority > 0) & refusable]):
            same = (self.priority == p) & refusable
            cost[same] += weight
            weight *= 1 + int(same.sum())
        return _freeze(cost)

    def to_json(self) -> dict[str, Any]:
        """Return a JSON object of all fields, on which all robots must agree."""
        return {f.name: _convert_to_json(getattr(self, f.name)) for f in fields(self)}

    def only(self, chosen: Ints) -> "Tasks":
        """Return the tasks `chosen` alone, (K,) in any order."""
        stops = np.concatenate([chosen, len(self) + chosen])
        return Tasks(
            pickup=self.pickup[chosen],
            delivery=self.delivery[chosen],
            load=self.load[chosen],
            service=self.service[stops],
            earliest=self.earliest[stops],
            latest=self.latest[stops],
            penalty=self.penalty[chosen],
            priority=self.priority[chosen],
            span=self.span,
        )

    @cached_property
    def stops(self) -> Mat:
        """(2M, d) m: the pickups, then the deliveries."""
        return _freeze(np.vstack([self.pickup, self.delivery]))

    @cached_property
    def between(self) -> Mat:
        """(2M, 2M) m: Euclidean distances between stops."""
        return _freeze(measure_distances(self.stops, self.stops))

    def durations(self, speed: float) -> Mat:
        """Return `measure_durations` between stops, (2M, 2M) s, by the Euclidean distances.

        All robots with this speed, m/s, get the same array while one of them holds it.
        """
        known = self._durations.get(speed)
        if known is None:
            known = _freeze(self.service[:, None] + self.between / speed)
            self._durations[speed] = known
        return known

    @cached_property
    def _durations(self) -> WeakValueDictionary[float, Mat]:
        return WeakValueDictionary()

    def __getstate__(self) -> dict[str, Any]:
        """Return the fields alone: another process measures the distances itself."""
        return {f.name: getattr(self, f.name) for f in fields(self)}


@dataclass(frozen=True, eq=False)
class LocalProblem:
    """The problem as robot `robot` knows it: its own limits and the public tasks.

    A task that is aboard another robot is not in `capable`.
    """

    robot: int
    """Id of this robot."""
    robots: int
    """N, the number of robots."""
    home: Vec
    """(2,) or (3,) m: where the robot starts."""
    capacity: float
    """Units of load."""
    limit: float
    """m: limit on the length of each trip, inf if there is none."""
    capable: npt.NDArray[np.bool_]
    """(M,): tasks that this robot may serve; False for a task that is aboard another robot."""
    tasks: Tasks
    """The public list of tasks."""
    end: Vec | None = None
    """(d,) m: where the robot ends, home if None."""
    open_tour: bool = False
    """Whether the robot ends at its last stop instead of flying to its end point."""
    distance: Mat | None = None
    """(2M + 1, 2M + 1) m: distances between the pickups, deliveries and home; Euclidean if None."""
    speed: float = 1.0
    """m/s."""
    window: tuple[float, float] = (0.0, math.inf)
    """s: when the robot may leave home, and when it must be back."""
    initial_load: float = 0.0
    """Units of load: the part of the capacity that is in use all the time."""
    fixed: float = 0.0
    """m: cost of leaving home. If vehicles are counted first it is `Instance.vehicle_weight`."""
    trips: int = 1
    """Largest number of trips."""
    objective: tuple[str, ...] = (OBJECTIVE_NAMES.total,)
    """Objectives of the team, in order."""
    start: Vec | None = None
    """(d,) m, in flight: where the robot is, or will be at `start_time`."""
    start_time: float = 0.0
    """s, in flight: when the robot is at `start`."""
    aboard: npt.NDArray[np.bool_] | None = None
    """(M,), in flight: tasks with goods on board of the robot."""
    left: float | None = None
    """m, in flight: what remains of the limit of the present trip."""

    @cached_property
    def vehicle(self) -> Vehicle:
        """The robot in the form that the kernels use.

        Raises ConfigError if `distance` is a matrix and `start` or `end` is given: the matrix has no
        distances to them.
        """
        m = len(self.tasks)
        ways = self._measure_ways()
        aboard = np.zeros(m, dtype=bool) if self.aboard is None else self.aboard
        way_home = float(ways.ends[0, 1])
        return Vehicle(
            ways=ways,
            times=self._measure_times(ways),
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
    def vehicle_weight(self) -> float:
        """m: cost of a vehicle beside its route if vehicles are counted first; otherwise 0.

        Lengths of columns and bounds include it; see Instance.vehicle_weight.
        """
        return self.fixed if OBJECTIVE_NAMES.vehicles in self.objective else 0.0

    @property
    def servable(self) -> npt.NDArray[np.int64]:
        """Indices, increasing, of the tasks that at least one route of this robot could hold."""
        return self.vehicle.servable

    def _measure_ways(self) -> Legs:
        """Return the distances in m of all legs; those to the end are 0 in an open tour."""
        if self.distance is None:
            start = self.home if self.start is None else self.start
            end = self.home if self.end is None else self.end
            points = np.vstack([start, end])
            stops = self.tasks.stops
            ways = Legs(
                self.tasks.between,
                measure_distances(points, stops),
                measure_distances(stops, points),
                measure_distances(points, points),
            )
        else:
            if self.start is not None or self.end is not None:
                found = "a start or an end beside a matrix of distances"
                do = "Give points and no matrix, or none."
                raise ConfigError(
                    f"robot {self.robot}: start, end",
                    found,
                    "none: the matrix has no row for it",
                    do,
                )
            home = 2 * len(self.tasks)
            nodes = [*range(home + 1), home]
            ways = Legs.of(self.distance[np.ix_(nodes, nodes)])
        if self.open_tour:
            ways.from_stops[:, 1] = 0.0
            ways.ends[:, 1] = 0.0
        return ways

    def _measure_times(self, ways: Legs) -> Legs:
        """Return the durations in s of all legs, from their distances in m."""
        service = self.tasks.service
        between = (
            self.tasks.durations(self.speed)
            if self.distance is None
            else service[:, None] + ways.between / self.speed
        )
        return measure_durations(ways, between, service, self.speed)


def group_equal_robots(robots: Mapping[int, LocalProblem]) -> list[tuple[int, ...]]:
    """Return groups of robots that differ only by their ids, in the order of the lowest ids."""
    groups: dict[tuple[bytes | None, ...], list[int]] = {}
    for i in sorted(robots):
        own = [
            getattr(robots[i], f.name)
            for f in fields(LocalProblem)
            if f.name not in PUBLIC_FIELDS
        ]
        told = tuple(
            None if value is None else np.asarray(value, float).tobytes()
            for value in own
        )
        groups.setdefault(told, []).append(i)
    return [tuple(group) for group in groups.values()]


@dataclass(frozen=True, eq=False)
class Instance:
    """N robots and M tasks.

    Robot i either stays at home, or flies from home_i and back. Its route may also end at end_i,
    or at its last stop if tours are open.

        min  sum_i length_i + sum_{j refused} penalty_j
        s.t. every task not refused is picked up and then delivered by one robot i,
             load on board + initial_load_i <= capacity_i,
             each trip <= route_length_limit,  capability_ij,
             each service in its window, after the service and the flight before it
    """

    home: Mat
    """(N, d) m, d = 2 or 3: where each robot starts."""
    capacity: Vec
    """(N,) units of load."""
    capability: npt.NDArray[np.bool_]
    """(N, M): whether robot i may serve task j."""
    tasks: Tasks
    """The public list of tasks."""
    route_length_limit: float = math.inf
    """m: limit on the length of each trip."""
    name: str = "instance"
    """Name of the instance in error messages."""
    end: Mat | None = None
    """(N, d) m: where each robot ends, home if None."""
    open_tours: bool = False
    """Whether robots end at their last stop."""
    distance: npt.NDArray[np.float64] | None = None
    """(N + 2M, N + 2M) m: rows homes, pickups, deliveries.

    (N, N + 2M, N + 2M) gives one matrix a robot; None means Euclidean distances.
    """
    speed: Vec = field(default_factory=lambda: np.empty(0))
    """(N,) m/s."""
    window: Mat = field(default_factory=lambda: np.empty((0, 2)))
    """(N, 2) s: when robot i may leave home, and when it must be back."""
    initial_load: Vec = field(default_factory=lambda: np.empty(0))
    """(N,) units of load: the part of the capacity that is in use all the time."""
    fixed_cost: float = 0.0
    """m: cost of each robot that leaves home."""
    recharge: int = 1
    """Largest number of trips of a robot, each with the whole route_length_limit."""
    objective: tuple[str, ...] = (OBJECTIVE_NAMES.total,)
    """Objectives to minimise, in order.

    "total": the sum above.
    "makespan": the time in s when the last robot is done, in place of the sum of lengths.
    "vehicles": the number of robots that leave home; it comes before the total.
    """

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
        """Read a JSON file or a file of Li and Lim.

        Raises InstanceError with file, key and index if something is wrong.
        """
        raw, names = read_instance_file(path)
        return cls.parse(raw, str(path), names)

    @classmethod
    def parse(
        cls, raw: dict[str, Any], where: str = "instance", names: Sequence[str] = ()
    ) -> "Instance":
        """Build the instance from a JSON object.

        raw: the JSON object.
        where: what error messages call it.
        names: what error messages call its tasks.
        Raises InstanceError if a field is wrong, or if a task that must be served cannot be.
        """
        fields = InstanceFields(raw, where)
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
            objective=fields.objective(
                "objective", (*COMMON_OBJECTIVES, VEHICLES_FIRST)
            ),
        )
        instance = replace(
            instance, tasks=replace(instance.tasks, span=instance._span())
        )
        instance._require_few_priorities()
        instance._require_countable()
        vehicles = [instance.local(same[0]).vehicle for same in instance.kinds()]
        require_servable_tasks(vehicles, instance.tasks.penalty, where, names)
        return instance

    @property
    def robots(self) -> int:
        """N, the number of robots."""
        return len(self.home)

    def local(self, i: int) -> LocalProblem:
        """Return the problem as robot i knows it."""
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
            if OBJECTIVE_NAMES.vehicles in self.objective
            else self.fixed_cost,
            trips=self.recharge,
            objective=self.objective,
        )

    @cached_property
    def vehicle_weight(self) -> float:
        """m: cost of a vehicle in the linear programs if vehicles are counted first.

            W >= 2 T,    T = 3M times the longest way
            T_a <= T  for the total T_a of every plan a
            n_a < n_b           =>  W n_a + T_a < W n_b + T_b
            W n_a + T_a >= V    =>  n_a >= V / W - 1/2

        A plan has 2M stops and at most M trips, because each trip serves a task. It therefore has
        at most 3M legs. W is a power of two, which keeps rounding errors small. Plans themselves
        are not compared by W: they are compared by their vehicles and then by their totals.
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

    def plan(self, routes: Iterable[Route]) -> RoutePlan:
        """Return the plan of these routes, with the penalties of the tasks that they leave out."""
        flown = tuple(routes)
        refused = np.ones(len(self.tasks), dtype=bool)
        refused[
            [j for route in flown for j in route.tasks if 0 <= j < len(refused)]
        ] = False
        return RoutePlan(
            flown,
            math.fsum(self.tasks.penalty[refused]),
            self.fixed_cost,
            self.objective,
        )

    def kinds(self) -> list[tuple[int, ...]]:
        """Return groups of identical robots, in the order of the lowest ids."""
        return group_equal_robots({i: self.local(i) for i in range(self.robots)})

    def to_json(self) -> dict[str, Any]:
        """Return the JSON object that `parse` reads back."""
        tasks = self.tasks
        raw: dict[str, Any] = {
            "home": self.home.tolist(),
            "pickup": tasks.pickup.tolist(),
            "delivery": tasks.delivery.tolist(),
            "load": tasks.load.tolist(),
            "capacity": self.capacity.tolist(),
            "route_length_limit": _convert_to_json(self.route_length_limit),
            "capability": self.capability.tolist(),
        }
        raw |= {"end": self.end.tolist()} if self.end is not None else {}
        raw |= {"distance": self.distance.tolist()} if self.distance is not None else {}
        return raw | {
            "open_tours": self.open_tours,
            "speed": self.speed.tolist(),
            "service_time": _split_stops(tasks.service.tolist()),
            "time_windows": _split_stops(
                _convert_to_json(np.column_stack([tasks.earliest, tasks.latest]))
            )
            | {"home": _convert_to_json(self.window)},
            "initial_load": self.initial_load.tolist(),
            "penalty": _convert_to_json(tasks.penalty),
            "priority": tasks.priority.tolist(),
            "fixed_cost": self.fixed_cost,
            "recharge": self.recharge,
            "objective": list(self.objective),
        }

    def _distance_of(self, i: int) -> Mat | None:
        """Return the (2M + 1, 2M + 1) distances in m: pickups, deliveries, home of robot i."""
        if self.distance is None:
            return None
        nodes = [*range(self.robots, self.distance.shape[-1]), i]
        own = self.distance[i] if self.distance.ndim == 3 else self.distance
        return np.asarray(own[np.ix_(nodes, nodes)])

    def _span(self) -> float:
        """Return an upper bound on the cost of a plan without refusals.

        The bound is the largest possible number of legs times the longest leg, with fixed costs.
        """
        legs = 3 * len(self.tasks) + 2 * self.robots
        vehicles = [self.local(same[0]).vehicle for same in self.kinds()]
        if self.objective[0] != OBJECTIVE_NAMES.makespan:
            return (
                legs * max(v.ways.most() for v in vehicles)
                + self.robots * self.fixed_cost
            )
        return legs * max(v.times.most() + float(v.earliest.max()) for v in vehicles)

    def _require_countable(self) -> None:
        """Check the fields that contradict the objective if vehicles are counted first.

        Raises InstanceError if a task may be refused or if there is a fixed cost.
        """
        if OBJECTIVE_NAMES.vehicles not in self.objective:
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


def _freeze(values: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """Return the same array, read-only."""
    values.setflags(write=False)
    return values


def _convert_to_json(value: Any) -> Any:
    """Return the value as JSON needs it: lists, and null for infinity."""
    if isinstance(value, np.ndarray | list):
        return [
            _convert_to_json(part)
            for part in (value.tolist() if isinstance(value, np.ndarray) else value)
        ]
    return None if value == math.inf else value


def _split_stops(values: list[Any]) -> dict[str, list[Any]]:
    """Split a list over stops into its pickups and its deliveries."""
    m = len(values) // 2
    return {"pickup": values[:m], "delivery": values[m:]}
