"""One robot as a member of its team: its place in the graph, its own problem, and how far it is."""

import math
from dataclasses import asdict, dataclass, field, replace
from functools import cached_property

import numpy as np

from crazychoir.routing.instance.instance import LocalProblem
from crazychoir.routing.instance.plan import sha256
from crazychoir.routing.instance.vehicle import VEHICLES
from crazychoir.routing.pricing.route_table import MOST_LABELS, RouteTable
from crazychoir.types import Vec


@dataclass(frozen=True)
class Settings:
    """Constants that all robots share.

    Price rounds: price_rounds: at most;  still: change of y that ends them;  step, exponent: of the step size;
    attempts: at claiming tasks.
    Column generation: penalty: of unserved demand, in longest ways of a robot;  tolerance: relative, of bounds;
    gossip_rounds: at most;  passes: at most;  batch: columns that a robot offers a pass;  most_labels: of a robot's
    route table;  most_listed: tasks of a robot whose routes are listed for it, in the method columns.
    Search: starters: robots that look for a first plan, by first_steps of search each;  cluster: robots and tasks of
    one, at most;  leaders: of each;  steps: of search that a leader does, over all passes;  cluster_rounds: of
    communication for clusters, from which follows the number of passes, least_passes to most_passes;  still_passes:
    without any better route end them.
    Proof: prove: whatever it costs;  most_proven: columns that are searched if not;  first_gap: relative;
    most_shared: columns of one robot in one message;  most_relayed: of all robots together, which must fit into a
    payload;  small: columns of a search that every robot does, a larger one is done by `searchers`;  nodes: of branch
    and bound, proof_nodes if `prove`.
    """

    price_rounds: int = 60
    still: float = 0.01
    step: float = 0.3
    exponent: float = 0.6
    attempts: int = 20
    penalty: float = 3.0
    tolerance: float = 1e-6
    gossip_rounds: int = 200
    passes: int = 30
    batch: int = 20
    most_labels: int = MOST_LABELS
    most_listed: int = 60
    starters: int = 16
    first_steps: int = 1_000
    cluster: tuple[int, int] = (25, 60)
    leaders: int = 3
    steps: int = 220_000
    cluster_rounds: int = 120
    least_passes: int = 8
    most_passes: int = 40
    still_passes: int = 8
    prove: bool = False
    most_proven: int = 20_000
    first_gap: float = 0.01
    most_shared: int = 500
    most_relayed: int = 10_000
    small: int = 100
    searchers: int = 2
    nodes: int = 20_000
    proof_nodes: int = 1_000_000


@dataclass(frozen=True)
class Place:
    """Where a robot is in the connected graph.

    robots: N;  diameter: of the graph;  degree_of: degree of each neighbour.
    """

    robot: int
    robots: int
    neighbors: tuple[int, ...]
    diameter: int
    degree_of: dict[int, int]

    def weight(self, j: int) -> float:
        """Metropolis weight of the edge to neighbour j: 1 / (1 + max(d_i, d_j))."""
        return 1.0 / (1 + max(len(self.neighbors), self.degree_of[j]))


@dataclass(frozen=True)
class Progress:
    """For display: the phase, the round, the largest unserved demand; in m, as far as known, the cost of the best plan
    and the value of the relaxation over the routes that this robot has heard of.
    """

    phase: str = "start"
    round: int = 0
    cost: float | None = None
    relaxed: float | None = None
    violation: float = 0.0


@dataclass
class Member:
    """What the phases of a method share at one robot."""

    local: LocalProblem
    place: Place
    settings: Settings
    progress: Progress = field(default_factory=Progress)
    kind: str = "start"
    """Of the messages of the present rounds."""
    bytes_by_kind: dict[str, int] = field(default_factory=dict)
    fixed: float = 0.0
    """m, the highest fixed cost of a robot, as far as the robots have told it."""
    reach: float = 0.0
    """m, at least any way of a robot between two places, as far as the robots have told it."""
    alike: dict[int, tuple[int, ...]] = field(default_factory=dict)
    """Robots that are the same in all, by the lowest id, as far as they have told it: it speaks for the others."""

    def __post_init__(self) -> None:
        self.alike = self.alike or {i: (i,) for i in range(self.place.robots)}
        self.reach = self.reach or reach(self.local)

    @property
    def vehicle_weight(self) -> float:
        """m, what a vehicle costs beside its route, where vehicles are counted first; 0 elsewhere.

        It is in the lengths of columns and in bounds; see Instance.vehicle_weight.
        """
        return self.local.fixed if VEHICLES in self.local.objective else 0.0

    def tolerance(self, value: float) -> float:
        """m, below which values of the relaxations differ by rounding: relative, of the lengths in the value alone."""
        lengths = (
            math.remainder(value, self.vehicle_weight) if self.vehicle_weight else value
        )
        return self.settings.tolerance * max(1.0, abs(lengths))

    def least_vehicles(self, bound: float) -> int:
        """How many vehicles leave in every plan, by a bound of it, where vehicles are counted first.

        W n + T >= bound,   T <= W / 2    =>    n >= bound / W - 1/2
        """
        return (
            max(0, math.ceil(bound / self.vehicle_weight - 0.5))
            if bound > -math.inf
            else 0
        )

    @property
    def speaks(self) -> bool:
        """Whether this robot prices routes: the first of those that are the same."""
        return self.place.robot in self.alike

    @cached_property
    def table(self) -> RouteTable:
        """All routes of this robot; made at the first use."""
        vehicle = self.local.vehicle
        most = self.settings.most_labels
        if not (vehicle.timed or np.isfinite(vehicle.farthest)):
            most //= 3  # without limits each task trebles their number: more labels are wasted
        return RouteTable(vehicle, most, self.local.objective)

    @cached_property
    def penalty(self) -> Vec:
        """(M,) m: what leaving a task unserved costs in the relaxations, the same at all robots after introductions.

            penalty_j = fixed + settings.penalty * reach,    so that no robot needs more for it alone if that is 3

        A task at a still higher price stays unserved in the relaxations: the bound is weaker then, never wrong. Plans
        are not compared by it.
        """
        return np.full(
            len(self.local.tasks), self.fixed + self.settings.penalty * self.reach
        )

    @cached_property
    def unserved(self) -> Vec:
        """(M,) m: what a task left out costs in the relaxations: its refusal if it may be refused, else the penalty."""
        refusal = self.local.tasks.refusal
        return np.asarray(np.where(np.isfinite(refusal), refusal, self.penalty))

    @cached_property
    def scale(self) -> float:
        """m: makes step sizes dimensionless, from what every robot knows: there and back for the mean task.

        Where goods hardly move it is a part of the diagonal of where they are; 1 m if all are in one place.
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
        """Hash of all that the team must have in common."""
        local = self.local
        place = self.place
        common = [local.tasks.to_json(), local.objective]
        return sha256(
            [common, method, asdict(self.settings), place.robots, place.diameter]
        )

    def report(self, **news: object) -> None:
        """Replace fields of `progress`."""
        self.progress = replace(self.progress, **news)  # type: ignore[arg-type]


def reach(local: LocalProblem) -> float:
    """m, at least any way of the robot between two places: the diagonal of all, or the longest of its matrix."""
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
