"""One robot as a member of its team: its place in the graph, its problem, and its progress."""

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from functools import cached_property

import numpy as np

from crazychoir.optimization.rounds.budget import NO_BUDGET, Budget, BudgetSettings
from crazychoir.routing.instance.instance import LocalProblem
from crazychoir.routing.instance.plan import hash_json
from crazychoir.routing.instance.vehicle import OBJECTIVE_NAMES
from crazychoir.routing.pricing.route_table import (
    MOST_TABLE_LABELS,
    RouteTable,
    exceeds_label_limit,
)
from crazychoir.types import Vec

EQUAL_COST_TOLERANCE = 1e-9
"""m or s: costs of plans that differ by at most this count as equal."""


@dataclass(frozen=True)
class PriceSettings:
    """How the robots trade tasks by prices."""

    rounds: int = 60
    """Price rounds, at most."""
    still: float = 0.01
    """The price rounds end if no share y changes by more than this."""
    step: float = 0.3
    """Factor of the step size of the price rounds."""
    exponent: float = 0.6
    """Exponent of the decay of the step size."""
    attempts: int = 20
    """Attempts at claiming tasks."""


@dataclass(frozen=True)
class ColumnSettings:
    """How the robots price and exchange columns."""

    penalty: float = 3.0
    """Penalty of unserved demand, in longest ways of a robot."""
    tolerance: float = 1e-6
    """Relative tolerance of bounds."""
    gossip_rounds: int = 200
    """Rounds of gossip, at most."""
    passes: int = 30
    """Passes of pricing or of the proof, at most."""
    batch: int = 20
    """Columns that a robot offers in a pass."""
    most_labels: int = MOST_TABLE_LABELS
    """Largest number of labels of a robot's route table."""
    most_listed: int = 60
    """The method `columns` lists the routes of a robot with at most this many tasks."""
    most_shared: int = 500
    """Largest number of columns of one robot in one message."""
    most_relayed: int = 10_000
    """Largest number of columns of all robots together; they must fit into a payload."""


@dataclass(frozen=True)
class SearchSettings:
    """How the robots search for plans."""

    starters: int = 16
    """Number of robots that look for a first plan."""
    first_steps: int = 1_000
    """Search steps of each starter."""
    cluster: tuple[int, int] = (25, 60)
    """Largest number of robots and of tasks in a cluster; the two longest routes fit in any case."""
    leaders: int = 3
    """Leaders of each cluster."""
    steps: int = 220_000
    """Search steps of a leader, over all passes."""
    cluster_rounds: int = 120
    """Communication rounds for clusters.

    The number of passes follows from it, between `least_passes` and `most_passes`.
    """
    least_passes: int = 8
    """Least number of passes of clusters."""
    most_passes: int = 40
    """Largest number of passes of clusters."""
    still_passes: int = 8
    """The passes end after this many passes without a better route."""
    small_team: int = 6
    """A team of at most this many robots is one cluster, also with more tasks than fit in one."""
    long_passes: tuple[tuple[float, float], ...] = (
        (0.5, 0.5),
        (0.25, 0.15),
        (0.25, 0.15),
    )
    """The passes of a small team with more tasks than fit in a cluster.

    For each pass: its share of `steps`, and its first temperature as SearchOptions.first_temperature.
    The routes are long, so that the first search has to cool slowly. The others keep most of the plan.
    """

    def count_passes(self, robots: int, tasks: int, diameter: int) -> int:
        """Return the number of passes of clusters, which share the search steps.

        A team that fits into a cluster has few passes, so that each search is long: it has nothing
        to combine with other clusters.
        """
        fitting = self.cluster_rounds // max(1, diameter)
        if robots <= self.cluster[0] and tasks <= self.cluster[1]:
            fitting = self.least_passes
        return max(self.least_passes, min(self.most_passes, fitting))


@dataclass(frozen=True)
class AnytimeSettings:
    """How the robots search while a budget of seconds or of search steps lasts."""

    starters: int = 1
    """Number of robots that look for a first plan."""
    first_passes: int = 10
    """Short passes, before the relaxation of the problem and its proof."""
    first_steps: int = 20_000
    """Search steps of a leader in a short pass: few, for an early plan, and often a better one."""
    first_temperature: float = 0.2
    """First temperature of a short pass, as SearchOptions.first_temperature."""
    steps: int = 120_000
    """Search steps of a leader in each further pass.

    One long pass finds better plans than several short ones with as many steps, because it cools
    more slowly. But the search ends between passes only.
    """
    temperature: float = 0.15
    """First temperature of a further pass: low, to keep most of the plan."""
    cluster: tuple[int, int] = (100, 200)
    """Largest number of robots and of tasks in a cluster; a smaller team is one cluster."""
    leaders: int = 1
    """Leaders of each cluster."""


@dataclass(frozen=True)
class ProofSettings:
    """How the robots prove a plan optimal."""

    prove: bool = False
    """Whether to prove the plan optimal regardless of the computing time."""
    most_proven: int = 20_000
    """Largest number of columns that the proof searches if not `prove`."""
    first_gap: float = 0.01
    """Relative gap of the first search of the proof."""
    small: int = 100
    """Every robot searches up to this many columns; the `searchers` search larger sets."""
    searchers: int = 2
    """Number of robots that search a large set of columns."""
    nodes: int = 20_000
    """Branch-and-bound nodes, at most."""
    proof_nodes: int = 1_000_000
    """Branch-and-bound nodes if `prove`, at most."""
    large_nodes: int = 300
    """Branch-and-bound nodes if the robots list halves of routes, at most."""
    dives: int = 12
    """Divisions of the plan into parts that dives plan again, at most; 0 for no dives. See diving.py.
    """
    dive_tasks: int = 50
    """Largest number of tasks in such a part."""
    still_dives: int = 10
    """Parts without a better plan after which the dives end."""


@dataclass(frozen=True)
class RoutingSettings:
    """Constants that all robots share."""

    prices: PriceSettings = PriceSettings()
    """How the robots trade tasks by prices."""
    columns: ColumnSettings = ColumnSettings()
    """How the robots price and exchange columns."""
    search: SearchSettings = SearchSettings()
    """How the robots search for plans."""
    proof: ProofSettings = ProofSettings()
    """How the robots prove a plan optimal."""
    anytime: AnytimeSettings = AnytimeSettings()
    """How the robots search while a budget lasts."""
    budget: BudgetSettings = NO_BUDGET
    """What the robots may spend."""


@dataclass(frozen=True)
class GraphPosition:
    """The place of a robot in the connected graph."""

    robot: int
    """Id of this robot."""
    robots: int
    """N, the number of robots."""
    neighbors: tuple[int, ...]
    """Ids of the neighbours."""
    diameter: int
    """Diameter of the graph, hops."""
    degree_of: dict[int, int]
    """Degree of each neighbour."""

    def weight(self, j: int) -> float:
        """Return the Metropolis weight of the edge to neighbour j: 1 / (1 + max(d_i, d_j))."""
        return 1.0 / (1 + max(len(self.neighbors), self.degree_of[j]))


@dataclass(frozen=True)
class MethodProgress:
    """Progress of the method at one robot, for display."""

    phase: str = "start"
    """Name of the present phase."""
    round: int = 0
    """Number of the present round."""
    cost: float | None = None
    """m: cost of the best plan, None if unknown."""
    bound: float | None = None
    """m: no plan costs less; None if unknown."""
    relaxed: float | None = None
    """m: value of the relaxation over the routes that this robot knows, None if unknown."""
    violation: float = 0.0
    """The largest unserved demand."""


@dataclass
class RoutingMember:
    """The data that the phases of a method share at one robot."""

    local: LocalProblem
    """The problem of this robot."""
    place: GraphPosition
    """Its place in the graph."""
    settings: RoutingSettings
    """Constants that all robots share."""
    progress: MethodProgress = field(default_factory=MethodProgress)
    """Its progress, for display."""
    kind: str = "start"
    """Subject of the messages of the present rounds."""
    bytes_by_kind: dict[str, int] = field(default_factory=dict)
    """Bytes of payload sent, by kind of message."""
    curve: list[tuple[int, float]] = field(default_factory=list)
    """(search steps, cost in m or s) of each plan that serves all tasks."""
    fixed: float = 0.0
    """m: the highest fixed cost of a robot; 0 before the robots have introduced themselves."""
    reach: float = 0.0
    """m: upper bound on the distance between two places.

    Before the robots have introduced themselves it covers only this robot.
    """
    alike: Mapping[int, tuple[int, ...]] = field(default_factory=dict)
    """Groups of identical robots, by the lowest id; that robot prices routes for the group.

    Before the robots have introduced themselves each robot is a group of its own.
    """

    def __post_init__(self) -> None:
        self.alike = self.alike or {i: (i,) for i in range(self.place.robots)}
        self.reach = self.reach or bound_reach(self.local)
        self.budget = Budget(self.settings.budget, self.place.diameter)

    @property
    def vehicle_weight(self) -> float:
        """m: LocalProblem.vehicle_weight."""
        return self.local.vehicle_weight

    def tolerance(self, value: float) -> float:
        """Return the difference in m below which two values of the relaxations count as equal.

        It is relative to the lengths in the value, without the weights of vehicles.
        """
        lengths = (
            math.remainder(value, self.vehicle_weight) if self.vehicle_weight else value
        )
        return self.settings.columns.tolerance * max(1.0, abs(lengths))

    def least_vehicles(self, bound: float) -> int:
        """Return a lower bound on the number of vehicles n, from a lower bound on the cost.

        It applies if vehicles are counted first.

            W n + T >= bound,   T <= W / 2    =>    n >= bound / W - 1/2
        """
        return (
            max(0, math.ceil(bound / self.vehicle_weight - 0.5))
            if bound > -math.inf
            else 0
        )

    @property
    def speaks(self) -> bool:
        """Whether this robot prices routes for its group: it has the lowest id in it."""
        return self.place.robot in self.alike

    @cached_property
    def table(self) -> RouteTable:
        """All routes of this robot, computed at the first use."""
        return RouteTable(self.local.vehicle, self._most_labels, self.local.objective)

    @property
    def is_table_hopeless(self) -> bool:
        """Whether it is known without computing it that the table would be incomplete."""
        return exceeds_label_limit(self.local.vehicle, self._most_labels)

    @property
    def _most_labels(self) -> int:
        vehicle = self.local.vehicle
        most = self.settings.columns.most_labels
        if not (vehicle.timed or np.isfinite(vehicle.farthest)):
            most //= 3  # without limits each task trebles the labels: more are useless
        return most

    @cached_property
    def penalty(self) -> Vec:
        """(M,) m: cost of an unserved task in the relaxations.

            penalty_j = fixed + settings.columns.penalty * reach

        It is the same at all robots after they have introduced themselves. If
        settings.columns.penalty is 3, no robot needs more to serve the task alone. A task with a
        still higher price stays unserved in the relaxations: the bound is then weaker, but not
        wrong. Plans are not compared by this penalty.
        """
        return np.full(
            len(self.local.tasks),
            self.fixed + self.settings.columns.penalty * self.reach,
        )

    @cached_property
    def unserved(self) -> Vec:
        """(M,) m: cost of leaving a task out in the relaxations.

        It is the refusal if the task may be refused, otherwise the penalty.
        """
        refusal = self.local.tasks.refusal
        return np.asarray(np.where(np.isfinite(refusal), refusal, self.penalty))

    @cached_property
    def scale(self) -> float:
        """m: length that makes step sizes dimensionless, from data that every robot knows.

        It is twice the mean distance from pickup to delivery, but at least a quarter of the
        diagonal of all pickups and deliveries; 1 m if all of them are in one place.
        """
        tasks = self.local.tasks
        moved = 2.0 * float(
            np.linalg.norm(tasks.pickup - tasks.delivery, axis=1).mean()
        )
        spread = float(
            np.linalg.norm(np.ptp(np.vstack([tasks.pickup, tasks.delivery]), axis=0))
        )
        return max(moved, spread / 4.0) or 1.0

    def fingerprint(self, method: str) -> str:
        """Return the hash of all data on which the team must agree."""
        local = self.local
        place = self.place
        common = [local.tasks.to_json(), local.objective]
        return hash_json(
            [common, method, asdict(self.settings), place.robots, place.diameter]
        )

    def report_plan(self, cost: float, complete: bool = True) -> None:
        """Report the cost of the plan in force in m, and keep it if it has changed.

        complete: whether the plan serves all tasks that must be served.
        """
        self.report(cost=cost)
        if not complete:
            return
        if not self.curve or abs(self.curve[-1][1] - cost) > EQUAL_COST_TOLERANCE:
            self.curve.append((self.budget.work, cost))

    def report_bound(self, value: float) -> None:
        """Report a proven bound on the value of the relaxation in m, where it is one on the cost too.

        It is not if vehicles are counted first, refusals are weighed by priority, or the objective
        is the makespan.
        """
        local = self.local
        is_other = local.objective[0] == OBJECTIVE_NAMES.makespan
        if not (self.vehicle_weight or is_other or (local.tasks.priority > 0).any()):
            self.report(bound=value)

    def report(self, **news: object) -> None:
        """Replace fields of `progress`."""
        self.progress = replace(self.progress, **news)  # type: ignore[arg-type]


def bound_reach(local: LocalProblem) -> float:
    """Return an upper bound in m on the distance of the robot between two places.

    It is the diagonal of all places, or the largest distance in its matrix if that is larger.
    """
    own = [point for point in (local.home, local.start, local.end) if point is not None]
    diagonal = float(
        np.linalg.norm(
            np.ptp(np.vstack([local.tasks.pickup, local.tasks.delivery, *own]), axis=0)
        )
    )
    return (
        diagonal
        if local.distance is None
        else max(diagonal, float(local.distance.max()))
    )
