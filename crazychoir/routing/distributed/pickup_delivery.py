"""Pickup and delivery solved by the robots themselves: one robot's part, as rounds."""

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from crazychoir.bus.codec import encode
from crazychoir.errors import ConfigError, SolverError
from crazychoir.optimization.rounds.agreement import flood
from crazychoir.optimization.rounds.program import Exchange, Program
from crazychoir.routing.distributed import distributed_columns, insertion_bids
from crazychoir.routing.distributed.column_recovery import DISCLOSED, ColumnRecovery
from crazychoir.routing.distributed.distributed_columns import DistributedColumns
from crazychoir.routing.distributed.member import Member, Place, Progress, Settings
from crazychoir.routing.distributed.primal_decomposition import PriceRounds
from crazychoir.routing.distributed.proof import Assignment
from crazychoir.routing.distributed.resource_recovery import ResourceRecovery
from crazychoir.routing.instance.instance import LocalProblem
from crazychoir.routing.instance.plan import Route, Solution, digest_of
from crazychoir.routing.instance.vehicle import MAKESPAN
from crazychoir.routing.pricing.route_table import shortest_route

CONFIRMED = ("route lengths or times", "task sets and hashes of routes")
"""What the confirmation of a plan tells of each robot, whatever the method."""
BY_PRICES = ("resource-columns", "resource", "resource-argmax")
"""Methods that add up what tasks cost at prices: where that is no cost of a plan, they cannot."""
BY_CLAIMS = ("resource", "resource-argmax")
"""Methods whose robots claim every task: they cannot refuse one."""
METHODS = ("columns", *BY_PRICES, *insertion_bids.METHODS)
ROUNDING = 2.0
"""Tolerances by which a bound may be above the cost: the search of a proof goes one beyond the plan."""


class PickupDelivery(Program[Solution]):
    """Robot i of a team that shares out pickup-and-delivery tasks: a Round.

        prices (column generation, or primal decomposition)  ->  an integer plan  ->  confirmation of its hash

    columns: distributed column generation and clusters, see distributed_columns.py; the best plans.
    resource-columns: price rounds, then the robots also share route columns; the plan is proven optimal where the
    tables are complete.
    resource, resource-argmax: only prices and claims travel; quick, not optimal.
    cbba, auction: bids of cheapest insertions, see insertion_bids.py; baselines, without a bound.
    diameter: of the connected, undirected graph;  degree_of: degree of each neighbour.
    All robots are done in the same round, with the same plan digest, cost and bound.
    Raises ConfigError for an unknown method, for one of BY_PRICES where prices say nothing, and for one of BY_CLAIMS
    where tasks may be refused; SolverError if the team cannot agree on a plan.
    """

    heavy = True
    """`step` computes for milliseconds to seconds: runtimes run it in a thread."""

    def __init__(
        self,
        local: LocalProblem,
        neighbors: list[int],
        n: int,
        diameter: int,
        degree_of: dict[int, int],
        method: str = METHODS[0],
        settings: Settings | None = None,
    ) -> None:
        if method not in METHODS:
            raise ConfigError(
                "method", method, ", ".join(METHODS), "Choose one of them."
            )
        if method in BY_PRICES:
            _require_prices(local, method)
        if method in BY_CLAIMS:
            _require_service(local, method)
        place = Place(
            local.robot, n, tuple(sorted(neighbors)), diameter, dict(degree_of)
        )
        self._member = Member(local, place, settings or Settings())
        self._method = method
        self.history: list[tuple[int, float | None, float | None]] = []
        """(round, value of the relaxation, cost of the best plan), m, None while unknown, whenever they changed."""
        super().__init__()

    @property
    def solution(self) -> Solution:
        """What this robot knows of the plan; only when `done`."""
        if not self.done:
            raise SolverError(
                f"robot {self._member.place.robot}: {self._method}",
                f"not done in round {self.k}",
            )
        return self.result

    @property
    def progress(self) -> Progress:
        """Phase, round, cost so far, unserved demand."""
        return self._member.progress

    def step(self, heard: Mapping[int, Any]) -> None:
        """Take the neighbours' messages of this round."""
        member = self._member
        member.report(round=self.k + 1)
        size = len(encode(self.message())) * len(member.place.neighbors)
        member.bytes_by_kind[member.kind] = (
            member.bytes_by_kind.get(member.kind, 0) + size
        )
        super().step(heard)
        now = member.progress
        if not self.history or (now.relaxed, now.cost) != self.history[-1][1:]:
            self.history.append((now.round, now.relaxed, now.cost))

    def run(self) -> Exchange[Solution]:
        """Prices, recovery, confirmation."""
        yield from self._hello()
        if self._method == "columns":
            assignment = yield from DistributedColumns(self._member).run()
            return (yield from self._confirm(assignment, distributed_columns.DISCLOSED))
        if self._method in insertion_bids.METHODS:
            assignment = yield from insertion_bids.insertion_plan(
                self._member, self._method
            )
            return (yield from self._confirm(assignment, insertion_bids.DISCLOSED))
        self._member.kind = "prices"
        prices = PriceRounds(self._member)
        yield from prices.run()
        if self._method == "resource-columns":
            self._member.kind = "columns"
            assignment = yield from ColumnRecovery(self._member, prices).run()
            disclosed = DISCLOSED
        else:
            self._member.kind = "claims"
            recovery = ResourceRecovery(
                self._member, prices, by_share=self._method == "resource-argmax"
            )
            assignment = yield from recovery.run()
            disclosed = recovery.disclosed
        return (yield from self._confirm(assignment, disclosed))

    def _hello(self) -> Exchange[None]:
        """One light round: the same tasks, method and constants everywhere, or an error."""
        mine = self._member.fingerprint(self._method)
        heard = yield mine
        different = [j for j, theirs in heard.items() if theirs != mine]
        if different:
            raise ConfigError(
                f"robot {self._member.place.robot}: neighbour(s) {', '.join(map(str, different))}",
                "another task list, method, number of robots, diameter or settings",
                "the same at all robots",
                "Start all agents with the same instance file and options.",
            )

    def _confirm(
        self, assignment: Assignment, disclosed: tuple[str, ...]
    ) -> Exchange[Solution]:
        """Flood lengths and hashes of the routes, then the plan's hash; all must be equal."""
        member = self._member
        place = self._member.place
        member.report(phase="confirm", violation=0.0)
        member.kind = "plans"
        nodes, length = self._own_route(assignment)
        vehicle = member.local.vehicle
        objective = member.local.objective
        finish = vehicle.finish(nodes) if MAKESPAN in objective else None
        route = Route.from_nodes(
            place.robot, nodes, len(member.local.tasks), length, finish
        )
        fixed = 0.0 if member.vehicle_weight else vehicle.fixed
        amount = (
            finish if objective[0] == MAKESPAN else length + fixed if nodes else 0.0
        )
        known = yield from flood(
            place.robot,
            [amount, route.digest if nodes else "", route.tasks],
            place.diameter,
        )
        amounts = [float(value) for value, _, _ in known.values()]
        served = [j for _, _, tasks in known.values() for j in tasks]
        refused = np.setdiff1d(
            np.arange(len(member.local.tasks)), np.array(served, dtype=np.int64)
        )
        penalties = math.fsum(member.local.tasks.penalty[refused])
        twice = sorted({j for j in served if served.count(j) > 1})
        if twice or penalties == math.inf:
            what = (
                f"task(s) {twice} are served twice"
                if twice
                else "a task that must be served is left out"
            )
            raise SolverError(
                f"robot {place.robot}: confirmation",
                f"different plans at the robots: {what}",
            )
        cost = (
            max(amounts) if objective[0] == MAKESPAN else sum(amounts, 0.0)
        ) + penalties
        vehicles = sum(1 for _, text, _ in known.values() if text)
        digest = digest_of({i: text for i, (_, text, _) in known.items() if text})
        heard = yield from flood(place.robot, digest, place.diameter)
        if any(other != digest for other in heard.values()):
            raise SolverError(
                f"robot {place.robot}: confirmation",
                f"different plans at the robots: {heard}",
            )
        member.report(phase="done", cost=cost)
        bound, vehicles_bound = self._bound(assignment, cost, vehicles)
        return Solution(
            bytes_by_kind=dict(member.bytes_by_kind),
            cost=cost,
            feasible=True,
            lower_bound=bound,
            bound_exact=bound is not None and assignment.relaxation is None,
            bound_relaxation=None if bound is None else assignment.relaxation,
            method=self._method,
            disclosed=(*disclosed, *CONFIRMED),
            rounds=self.k,
            plan_digest=digest,
            routes=(route,) if nodes else (),
            vehicles_bound=vehicles_bound,
        )

    def _bound(
        self, assignment: Assignment, cost: float, vehicles: int
    ) -> tuple[float | None, int | None]:
        """What is proven of the cost: nothing where prices add up what counts otherwise; and of the number of vehicles,
        where they are counted first. The bound of the cost is then that of plans with so few vehicles, and there is
        none for a plan that may have more.

        A sum of finishing times is no makespan, and refusals weighed by priority are no cost. Only rounding is clipped:
        a bound above the cost of a plan is none, and neither is any other of its kind; all robots see it alike.
        """
        local = self._member.local
        tolerance = ROUNDING * self._member.settings.tolerance
        if (
            assignment.lower_bound is None
            or local.objective[0] == MAKESPAN
            or (local.tasks.priority > 0).any()
        ):
            return None, None
        weight = self._member.vehicle_weight
        bound = assignment.lower_bound - weight * vehicles
        if bound > cost + tolerance * max(1.0, abs(cost)):
            found = f"bound {bound:.9g} above the cost {cost:.9g} of the plan: a pricing was not exact"
            raise SolverError(f"robot {local.robot}: {self._method}", found)
        if not weight:
            return min(bound, cost), None
        least = min(vehicles, self._member.least_vehicles(assignment.lower_bound))
        return (min(max(bound, 0.0), cost) if least == vehicles else None), least

    def _own_route(self, assignment: Assignment) -> tuple[list[int], float]:
        """Stops and length in m of this robot's route."""
        local = self._member.local
        if assignment.stops is None:
            return shortest_route(
                local.vehicle, assignment.routes.get(local.robot, ()), local.objective
            )
        stops = list(assignment.stops.get(local.robot, ()))
        return stops, local.vehicle.length(stops) if stops else 0.0


def _require_prices(local: LocalProblem, method: str) -> None:
    """ConfigError where prices add up what counts otherwise: a sum of finishing times is no makespan, and refusals
    weighed by priority leave no room for what routes cost.
    """
    found = (
        "makespan first" if local.objective[0] == MAKESPAN else "tasks with priorities"
    )
    if local.objective[0] == MAKESPAN or (local.tasks.priority > 0).any():
        able = [name for name in METHODS if name not in BY_PRICES]
        allowed = f"the total first and no priorities, as prices of tasks add up; or the methods {', '.join(able)}"
        raise ConfigError(
            f"method {method}", found, allowed, "Take columns, or change the instance."
        )


def _require_service(local: LocalProblem, method: str) -> None:
    """ConfigError where tasks may be refused: claims go on until every task has a robot."""
    refusable = np.flatnonzero(np.isfinite(local.tasks.penalty)).tolist()
    if refusable:
        able = [name for name in METHODS if name not in BY_CLAIMS]
        found = f"a finite penalty of task(s) {', '.join(map(str, refusable))}, which may be refused"
        allowed = f"tasks that must all be served; or the methods {', '.join(able)}"
        raise ConfigError(
            f"method {method}",
            found,
            allowed,
            "Take columns, or leave the penalties out.",
        )
