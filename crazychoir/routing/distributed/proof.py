"""Set partitioning with a proof: the team agrees on one plan and on a lower bound."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from crazychoir.errors import SolverError
from crazychoir.optimization.rounds.agreement import find_best_offer, flood_values
from crazychoir.optimization.rounds.program import Exchange
from crazychoir.routing.distributed.bound import Bound, find_fitting_gap
from crazychoir.routing.distributed.master import (
    ColumnPool,
    PartitionProblem,
    PartitionResult,
    Routes,
    find_fewest_columns,
    find_partition,
)
from crazychoir.routing.distributed.member import RoutingMember
from crazychoir.routing.instance.plan import hash_json
from crazychoir.routing.pricing.bidirectional_pricing import HalfRoutes
from crazychoir.routing.pricing.packing import pack_columns, unpack_columns
from crazychoir.routing.pricing.route_table import RouteColumn, RouteTable

HOPELESS_GAP_SHARE = 0.5
"""Share of a plan's own gap; plans in a gap below it are searched for the sake of the bound alone."""


@dataclass(frozen=True)
class TaskPartition:
    """The tasks of each robot, as far as this robot knows them."""

    routes: Routes
    """Tasks of each known robot."""
    lower_bound: float | None
    """m: no plan costs less; None if no bound is exact."""
    stops: Mapping[int, Sequence[int]] | None = None
    """Nodes of each robot's route. If unknown, the route is the shortest one for its tasks."""
    relaxation: str | None = None
    """Relaxation of the routes by which the bound was priced, None if they were priced exactly."""


@dataclass(frozen=True)
class PlanOffer:
    """A plan that all robots know."""

    cost: float
    """m: cost of the plan."""
    routes: Routes
    """Tasks of each robot."""
    searched: float = -np.inf
    """m: lower bound that the search proved."""


class PlanProof:
    """Search for a better plan among the few columns that such a plan can contain.

    A plan with column c of robot i costs at least bound + excess(c).

    1. Flood all columns with an excess <= gap.
    2. Each robot solves the set partitioning of these columns, with every task exactly once.
    3. Min-consensus on (cost, robot) picks one plan, which is sent with its hash.
    4. If its cost is within the gap of the bound, it is optimal; else double the gap and repeat.

    Only the `searchers` robots with the lowest ids solve a partitioning of more than `small`
    columns, because it takes seconds and one answer is enough. Every decision that ends a loop is
    taken from flooded values, so that all robots end in the same round. This includes the
    finding that there is no plan: a searcher sends it in place of a plan.

    pool: the columns that all robots know.
    bound: the bound and its prices.
    best: the best plan that all robots know, None if there is none.
    halves: the routes of this robot; None if its table lists them.
    `proven`, in m: no plan costs less.
    Raises SolverError if there is no plan, or if a plan arrives damaged.
    """

    def __init__(
        self,
        member: RoutingMember,
        pool: ColumnPool,
        bound: Bound,
        best: PlanOffer | None = None,
        halves: HalfRoutes | None = None,
    ) -> None:
        self._member = member
        self._pool = pool
        self._bound = bound
        self.best = best
        self._halves = halves
        self._searchers = member.settings.proof.searchers
        self._nodes = (
            member.settings.proof.proof_nodes
            if member.settings.proof.prove
            else member.settings.proof.nodes
        )
        self._i = member.place.robot
        self._diameter = member.place.diameter
        self._tolerance = member.tolerance(bound.value)
        self._none = False
        self._exhausted = False
        self._below = np.inf
        self.proven = bound.value

    def run(self) -> Exchange[TaskPartition]:
        """Return the optimal plan, or the best known one if passes and nodes do not suffice."""
        yield from self.search()
        if self.best is None:
            why, status = self._failure()
            raise SolverError(
                f"{why} (robot {self._i}: set partitioning of {len(self._pool)} columns)",
                status,
            )
        return TaskPartition(
            self.best.routes, self.proven if self._bound.exact else None
        )

    @property
    def closed(self) -> bool:
        """Whether the best plan is proven optimal among all columns."""
        return self.best is not None and self.best.cost - self.proven <= self._tolerance

    @property
    def infeasible(self) -> bool:
        """Whether there is no plan."""
        return self._bound.exact and self._exhausted and self._none

    def search(self, most: float = np.inf) -> Exchange[None]:
        """Widen the gap until it contains the plan's own gap.

        most: stop earlier if more than this number of columns would be searched.
        """
        settings = self._member.settings
        self._member.report(phase="plan")
        self._member.kind = "columns"
        gap = min(
            settings.proof.first_gap * max(1.0, abs(self._bound.value)), self._own_gap()
        )
        for _ in range(settings.columns.passes):
            if self.best is not None and self._member.budget.is_over:
                return
            near = self._near(gap, most)
            if (yield from self._is_more(near, most)):
                return
            yield from self._search_columns(near or [], gap)
            if self.closed or self._exhausted or self._own_gap() <= gap:
                return
            gap = min(2.0 * gap, self._own_gap())

    def search_few(self, nodes: int) -> Exchange[None]:
        """Search in the widest gap that has at most `most_proven` columns.

        The search is repeated only if its plan makes the plan's own gap that narrow.
        One robot searches, because a search may take minutes. If this gap is far below the plan's
        own, only plans within it are searched: there will hardly be any, which is soon proven.

        nodes: branch-and-bound nodes of a search, at most.
        """
        settings = self._member.settings
        self._member.report(phase="partition")
        self._member.kind = "columns"
        self._nodes = nodes
        self._searchers = 1
        first = settings.proof.first_gap * max(1.0, abs(self._bound.value))
        searched = 0.0
        while not (self.closed or self._member.budget.is_over):
            widest = self._own_gap()
            gap = yield from find_fitting_gap(
                self._bound,
                self._member,
                self._near,
                (min(first, widest), widest),
                settings.proof.most_proven,
            )
            if gap <= searched or (searched and gap < widest):
                return
            near = self._near(gap, settings.proof.most_proven)
            self._below = self._bound.value + gap
            if gap >= HOPELESS_GAP_SHARE * widest or self._member.vehicle_weight:
                self._below = np.inf
            yield from self._search_columns(near or [], gap)
            searched = gap

    def _search_columns(self, near: list[RouteColumn], gap: float) -> Exchange[None]:
        """Flood the own columns `near`, and search for a plan of all columns within the gap."""
        self._exhausted = yield from self._widen(near)
        found = yield from self._agree(gap)
        if found is None:
            return
        self.proven = max(self.proven, min(found.searched, self._bound.value + gap))
        if self._bound.exact:
            self._member.report_bound(self.proven)
        if self.best is None or found.cost < self.best.cost:
            self.best = found

    def _own_gap(self) -> float:
        """Return the gap in m that suffices: columns beyond it cannot improve the best plan."""
        return (
            np.inf
            if self.best is None
            else self.best.cost - self._bound.value + self._tolerance
        )

    def _failure(self) -> tuple[str, str]:
        """Return why there is no plan, and the status."""
        if not self._bound.exact:
            why = "no plan found: route tables were cut at most_labels. Narrow capability or route_length_limit"
            return why, "incomplete"
        if self.infeasible:
            why = "each can be served alone, but not all together within capability, capacity and route_length_limit"
            return f"infeasible: no plan serves every task; {why}", "infeasible"
        return "no plan found within the passes and nodes", "incomplete"

    @property
    def _routes(self) -> RouteTable | HalfRoutes:
        """The routes of this robot; a table is computed at its first use."""
        return self._member.table if self._halves is None else self._halves

    def _near(self, gap: float, most: float) -> list[RouteColumn] | None:
        """Return the own columns within the gap, None if there are more than `most`."""
        if not self._member.speaks:
            return []
        below = self._bound.least[self._i] + gap
        bound = self._bound
        if self._halves is None:
            return self._member.table.within(bound.prices, below, most, bound.reward)
        return self._halves.within(bound.prices, below, most, bound.reward, bound.rows)

    def _is_more(self, near: list[RouteColumn] | None, most: float) -> Exchange[bool]:
        """Return whether all robots together have more than `most` columns within the gap."""
        if most == np.inf:
            return False
        own = None if near is None else len(near)
        counts = yield from flood_values(self._i, own, self._diameter)
        return any(count is None for count in counts.values()) or bool(
            sum(counts.values()) > most
        )

    def _widen(self, near: list[RouteColumn]) -> Exchange[bool]:
        """Flood the columns `near`, a part at a time.

        Returns whether no robot has any column beyond them.
        """
        member = self._member
        settings = self._member.settings
        most = max(
            1,
            min(
                settings.columns.most_shared,
                settings.columns.most_relayed // member.place.robots,
            ),
        )
        exhausted = not member.speaks or len(near) == self._routes.size
        fresh = [c for c in near if not self._pool.has(self._i, c)]
        while True:
            own = [pack_columns(fresh[:most]), len(fresh) <= most, exhausted]
            known = yield from flood_values(self._i, own, self._diameter)
            for robot, (news, _, _) in known.items():
                self._pool.add(robot, unpack_columns(news))
            if all(last for _, last, _ in known.values()):
                return all(everything for _, _, everything in known.values())
            fresh = fresh[most:]

    def _agree(self, gap: float) -> Exchange[PlanOffer | None]:
        """Return the best plan that any robot finds within the gap, None if there is none."""
        best = yield from find_best_offer(self._search(gap), self._diameter)
        self._none = best is not None and best[0] == np.inf
        if best is None or self._none:
            return None
        cost, robot, routes, searched, digest = best
        if hash_json(routes) != digest:
            raise SolverError(
                f"robot {self._i}: the plan of robot {robot}",
                "damaged: its hash differs",
            )
        self._member.report(
            cost=float(cost) - self._member.vehicle_weight * len(routes)
        )
        return PlanOffer(
            float(cost),
            {int(i): tuple(int(j) for j in tasks) for i, tasks in routes},
            float(searched),
        )

    def _search(self, gap: float) -> list[Any] | None:
        """Return the own offer: cost, robot, routes, searched bound, hash.

        A cost of inf says that there is no plan. A large search is left to a few robots, and the
        others offer None. A searcher that hits a limit without finding a plan offers None too.
        """
        settings = self._member.settings
        planned = set() if self.best is None else set(self.best.routes.values())
        useful = [
            (i, c)
            for i, c in self._pool.items()
            if self._bound.excess(i, c) <= gap or c.tasks in planned
        ]
        if len(useful) > settings.proof.small and self._i >= self._searchers:
            return None
        if self.best is not None and self._member.budget.is_spent:
            return None
        refusals = self._refusals()
        useful += refusals
        known = (
            None
            if self.best is None or self._below < np.inf
            else _with_refusals(self.best.routes, refusals)
        )
        weight = self._member.vehicle_weight
        problem = PartitionProblem(
            useful,
            len(self._member.local.tasks),
            self._member.alike,
            self._bound.rows.rows,
        )
        if weight:
            least = self._member.least_vehicles(self._bound.value)
            found = find_fewest_columns(
                problem, self._i, self._nodes, weight, least, known
            )
        else:
            found = find_partition(
                problem, self._i, self._nodes, known, below=self._below
            )
        best = self.best
        if self._below < np.inf and best is not None and found.cost >= best.cost:
            bound = min(found.bound, self._below)
            found = PartitionResult(best.cost, best.routes, bound)
        if found.cost == np.inf and found.bound < np.inf:
            return None
        robots = self._member.place.robots
        routes = [
            [robot, list(tasks)]
            for robot, tasks in sorted(found.routes.items())
            if robot < robots
        ]
        return [found.cost, self._i, routes, found.bound, hash_json(routes)]

    def _refusals(self) -> list[tuple[int, RouteColumn]]:
        """Return the tasks j that may be refused, each as a column of a virtual robot N + j."""
        refusal = self._member.local.tasks.refusal
        n = self._member.place.robots
        return [
            (n + int(j), RouteColumn(float(refusal[j]), (int(j),)))
            for j in np.flatnonzero(np.isfinite(refusal))
        ]


def _with_refusals(routes: Routes, refusals: list[tuple[int, RouteColumn]]) -> Routes:
    """Return the routes with the columns that refuse the tasks left."""
    served = {j for tasks in routes.values() for j in tasks}
    return routes | {
        robot: column.tasks
        for robot, column in refusals
        if column.tasks[0] not in served
    }
