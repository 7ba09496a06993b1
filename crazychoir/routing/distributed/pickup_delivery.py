"""Pickup and delivery solved by the robots themselves: the rounds of one robot."""

import math
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from crazychoir.bus.codec import encode
from crazychoir.errors import ConfigError, SolverError
from crazychoir.optimization.rounds.agreement import flood_values
from crazychoir.optimization.rounds.budget import BudgetSettings
from crazychoir.optimization.rounds.program import Exchange, Program
from crazychoir.routing.distributed import distributed_columns, insertion_bids
from crazychoir.routing.distributed.column_recovery import (
    COLUMN_RECOVERY_DISCLOSURES,
    ColumnRecovery,
)
from crazychoir.routing.distributed.distributed_columns import DistributedColumns
from crazychoir.routing.distributed.member import (
    GraphPosition,
    MethodProgress,
    ProofSettings,
    RoutingMember,
    RoutingSettings,
)
from crazychoir.routing.distributed.primal_decomposition import PriceRounds
from crazychoir.routing.distributed.proof import TaskPartition
from crazychoir.routing.distributed.resource_recovery import ResourceRecovery
from crazychoir.routing.instance.instance import LocalProblem
from crazychoir.routing.instance.plan import Route, Solution, combine_digests
from crazychoir.routing.instance.vehicle import OBJECTIVE_NAMES
from crazychoir.routing.pricing.route_table import find_shortest_route

CONFIRMATION_DISCLOSURES = ("route lengths or times", "task sets and hashes of routes")
"""Data that each robot discloses when a plan is confirmed, in every method."""
PRICE_METHODS = ("resource-columns", "resource", "resource-argmax")
"""Methods that add up task prices: they need an objective that is such a sum."""
CLAIM_METHODS = ("resource", "resource-argmax")
"""Methods in which robots claim every task: they cannot refuse a task."""
ANYTIME_METHOD = "columns"
"""The method that searches for better plans while a budget lasts."""
PLANNING_METHODS = (ANYTIME_METHOD, *PRICE_METHODS, *insertion_bids.BIDDING_METHODS)
"""Names of all methods; the first is the default."""
PLAN_OF_NOTHING = TaskPartition({}, 0.0, {})
"""The only plan, and therefore an optimal one, if there are no tasks."""
PROOF_TOLERANCE_FACTOR = 2.0
"""The bound may exceed the cost by this number of tolerances.

The search of a proof goes one tolerance beyond the plan.
"""


class PickupDelivery(Program[Solution]):
    """One robot of a team that solves a pickup-and-delivery problem in rounds.

        prices (column generation, or primal decomposition)
        -> an integer plan -> confirmation of its hash

    Methods:
    columns: distributed column generation and clusters, see distributed_columns.py; the best plans.
    resource-columns: price rounds, then the robots also share route columns. The plan is proven
        optimal if the tables are complete.
    resource, resource-argmax: robots send only prices and claims; fast, not optimal.
    cbba, auction: bids of cheapest insertions, see insertion_bids.py; baselines without a bound.

    local: the problem of this robot.
    neighbors: ids of its neighbours.
    n: number of robots.
    diameter: of the connected, undirected graph, hops.
    degree_of: degree of each neighbour.
    method: one of PLANNING_METHODS.
    settings: constants that all robots share.
    All robots finish in the same round, with the same plan digest, cost and bound.
    Raises ConfigError for an unknown method, for a method of PRICE_METHODS if prices do not add up to
    the objective or routes are too many to list, and for a method of CLAIM_METHODS if tasks may be
    refused. Raises SolverError if the team cannot agree on a plan.
    """

    heavy = True
    """Whether `step` computes for milliseconds to seconds: runtimes then run it in a thread."""

    def __init__(
        self,
        local: LocalProblem,
        neighbors: list[int],
        n: int,
        diameter: int,
        degree_of: dict[int, int],
        method: str = PLANNING_METHODS[0],
        settings: RoutingSettings | None = None,
    ) -> None:
        if method not in PLANNING_METHODS:
            raise ConfigError(
                "method", method, ", ".join(PLANNING_METHODS), "Choose one of them."
            )
        if method in PRICE_METHODS:
            _require_prices(local, method)
        if method in CLAIM_METHODS:
            _require_service(local, method)
        place = GraphPosition(
            local.robot, n, tuple(sorted(neighbors)), diameter, dict(degree_of)
        )
        self._member = RoutingMember(local, place, settings or RoutingSettings())
        if method in PRICE_METHODS:
            _require_table(self._member, method)
        self._method = method
        self.history: list[tuple[int, float | None, float | None]] = []
        """(round, value of the relaxation, cost of the best plan) after each change.

        Values in m, None while unknown.
        """
        super().__init__()
        self._end_word = self._member.budget.word()

    def start_clock(self, now: Callable[[], float]) -> None:
        """Let the seconds of the budget begin; now: returns the time in s."""
        self._member.budget.start_clock(now)

    def interrupt(self) -> None:
        """Let the team end with its best plan, as soon as all robots know it."""
        self._member.budget.interrupt()

    @property
    def solution(self) -> Solution:
        """The plan as this robot knows it.

        Raises SolverError unless `done`.
        """
        if not self.done:
            raise SolverError(
                f"robot {self._member.place.robot}: {self._method}",
                f"not done in round {self.k}",
            )
        return self.result

    @property
    def work_curve(self) -> list[tuple[int, float]]:
        """(search steps, cost in m or s) of each better plan until now."""
        return self._member.curve

    @property
    def progress(self) -> MethodProgress:
        """Phase, round, cost so far, unserved demand."""
        return self._member.progress

    def message(self) -> Any:
        """Return the message of this round, with the end of the computation if one is known."""
        return [self._end_word, super().message()]

    def step(self, heard: Mapping[int, Any]) -> None:
        """Process the neighbours' messages of this round."""
        member = self._member
        member.report(round=self.k + 1)
        size = len(encode(self.message())) * len(member.place.neighbors)
        member.bytes_by_kind[member.kind] = (
            member.bytes_by_kind.get(member.kind, 0) + size
        )
        member.budget.begin_round(self.k + 1, (word for word, _ in heard.values()))
        super().step({j: message for j, (_, message) in heard.items()})
        self._end_word = member.budget.word()
        now = member.progress
        if not self.history or (now.relaxed, now.cost) != self.history[-1][1:]:
            self.history.append((now.round, now.relaxed, now.cost))

    def run(self) -> Exchange[Solution]:
        """Compute prices and a plan, and confirm the plan."""
        yield from self._hello()
        if not len(self._member.local.tasks):
            return (yield from self._confirm(PLAN_OF_NOTHING, ()))
        if self._method == ANYTIME_METHOD:
            assignment = yield from DistributedColumns(self._member).run()
            return (
                yield from self._confirm(
                    assignment, distributed_columns.DISTRIBUTED_COLUMNS_DISCLOSURES
                )
            )
        if self._method in insertion_bids.BIDDING_METHODS:
            assignment = yield from insertion_bids.plan_by_insertion(
                self._member, self._method
            )
            return (
                yield from self._confirm(
                    assignment, insertion_bids.INSERTION_BIDS_DISCLOSURES
                )
            )
        self._member.kind = "prices"
        prices = PriceRounds(self._member)
        yield from prices.run()
        if self._method == "resource-columns":
            self._member.kind = "columns"
            assignment = yield from ColumnRecovery(self._member, prices).run()
            disclosed = COLUMN_RECOVERY_DISCLOSURES
        else:
            self._member.kind = "claims"
            recovery = ResourceRecovery(
                self._member, prices, by_share=self._method == "resource-argmax"
            )
            assignment = yield from recovery.run()
            disclosed = recovery.disclosed
        return (yield from self._confirm(assignment, disclosed))

    def _hello(self) -> Exchange[None]:
        """Check in one small round that all robots have the same tasks, method and constants.

        Raises ConfigError if a neighbour differs.
        """
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
        self, assignment: TaskPartition, disclosed: tuple[str, ...]
    ) -> Exchange[Solution]:
        """Flood lengths and hashes of the routes, then the plan's hash, and build the solution.

        Raises SolverError if the robots have different plans.
        """
        member = self._member
        place = self._member.place
        ended_by = member.budget.end_reason
        member.report(phase="confirm", violation=0.0)
        member.kind = "plans"
        nodes, length = self._own_route(assignment)
        vehicle = member.local.vehicle
        objective = member.local.objective
        finish = (
            vehicle.finish(nodes) if OBJECTIVE_NAMES.makespan in objective else None
        )
        route = Route.from_nodes(
            place.robot, nodes, len(member.local.tasks), length, finish
        )
        fixed = 0.0 if member.vehicle_weight else vehicle.fixed
        if objective[0] == OBJECTIVE_NAMES.makespan:
            amount = finish
        else:
            amount = length + fixed if nodes else 0.0
        known = yield from flood_values(
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
            max(amounts)
            if objective[0] == OBJECTIVE_NAMES.makespan
            else sum(amounts, 0.0)
        ) + penalties
        vehicles = sum(1 for _, text, _ in known.values() if text)
        digest = combine_digests({i: text for i, (_, text, _) in known.items() if text})
        heard = yield from flood_values(place.robot, digest, place.diameter)
        if any(other != digest for other in heard.values()):
            raise SolverError(
                f"robot {place.robot}: confirmation",
                f"different plans at the robots: {heard}",
            )
        member.report(phase="done")
        member.report_plan(cost)
        bound, vehicles_bound = self._bound(assignment, cost, vehicles)
        return Solution(
            bytes_by_kind=dict(member.bytes_by_kind),
            cost=cost,
            feasible=True,
            lower_bound=bound,
            bound_exact=bound is not None and assignment.relaxation is None,
            bound_relaxation=None if bound is None else assignment.relaxation,
            method=self._method,
            disclosed=(*disclosed, *CONFIRMATION_DISCLOSURES),
            rounds=self.k,
            plan_digest=digest,
            routes=(route,) if nodes else (),
            vehicles_bound=vehicles_bound,
            ended_by=None if ended_by is None else ended_by.value,
            work=member.budget.work,
            work_curve=tuple(member.curve),
        )

    def _bound(
        self, assignment: TaskPartition, cost: float, vehicles: int
    ) -> tuple[float | None, int | None]:
        """Return the proven bounds on the cost in m and on the number of vehicles, None if unknown.

        There is no bound if the objective is not a sum of lengths: a sum of finish times is not the
        makespan, and refusals weighed by priority are not a cost. The bound on vehicles exists
        only if vehicles are counted first. The bound on the cost then holds for plans with that
        number of vehicles, and is None if the plan may have more.

        Only a bound that exceeds the cost by rounding is reduced to the cost. Raises SolverError
        if it exceeds the cost by more, because it is then wrong; this happens at all robots
        alike.
        """
        local = self._member.local
        tolerance = PROOF_TOLERANCE_FACTOR * self._member.settings.columns.tolerance
        if (
            assignment.lower_bound is None
            or local.objective[0] == OBJECTIVE_NAMES.makespan
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

    def _own_route(self, assignment: TaskPartition) -> tuple[list[int], float]:
        """Return the stops and the length in m of this robot's route."""
        local = self._member.local
        if assignment.stops is None:
            return find_shortest_route(
                local.vehicle, assignment.routes.get(local.robot, ()), local.objective
            )
        stops = list(assignment.stops.get(local.robot, ()))
        return stops, local.vehicle.length(stops) if stops else 0.0


def choose_routing_settings(
    method: str, budget: BudgetSettings, prove: bool = False
) -> RoutingSettings:
    """Return the settings of a method.

    budget: what the team may spend.
    prove: whether to prove the plan optimal, whatever it costs.
    Raises ConfigError for a budget if the method does not search until it is spent.
    """
    if budget.is_given and method != ANYTIME_METHOD:
        given = "seconds" if budget.seconds is not None else "work"
        raise ConfigError(
            given,
            f"a budget for the method {method}",
            f"none, or the method {ANYTIME_METHOD}: the others end by themselves",
        )
    return RoutingSettings(proof=ProofSettings(prove=prove), budget=budget)


def _require_prices(local: LocalProblem, method: str) -> None:
    """Raise ConfigError if the objective is not a sum over tasks, which prices need.

    A sum of finish times is not the makespan. Refusals weighed by priority are so large that route
    costs do not matter beside them.
    """
    found = (
        "makespan first"
        if local.objective[0] == OBJECTIVE_NAMES.makespan
        else "tasks with priorities"
    )
    if (
        local.objective[0] == OBJECTIVE_NAMES.makespan
        or (local.tasks.priority > 0).any()
    ):
        able = [name for name in PLANNING_METHODS if name not in PRICE_METHODS]
        allowed = f"the total first and no priorities, as prices of tasks add up; or the methods {', '.join(able)}"
        raise ConfigError(
            f"method {method}", found, allowed, "Take columns, or change the instance."
        )


def _require_table(member: RoutingMember, method: str) -> None:
    """Raise ConfigError if it is known that the routes of this robot are too many to list."""
    if member.is_table_hopeless:
        local = member.local
        able = [name for name in PLANNING_METHODS if name not in PRICE_METHODS]
        raise ConfigError(
            f"method {method}: tasks that robot {local.robot} can serve",
            f"{len(local.servable)}, with no limit on its route: too many routes to list them",
            f"fewer tasks, or routes with a limit; or the methods {', '.join(able)}",
            "Take columns, or give route_length_limit.",
        )


def _require_service(local: LocalProblem, method: str) -> None:
    """Raise ConfigError if tasks may be refused: robots claim until every task has a robot."""
    refusable = np.flatnonzero(np.isfinite(local.tasks.penalty)).tolist()
    if refusable:
        able = [name for name in PLANNING_METHODS if name not in CLAIM_METHODS]
        found = f"a finite penalty of task(s) {', '.join(map(str, refusable))}, which may be refused"
        allowed = f"tasks that must all be served; or the methods {', '.join(able)}"
        raise ConfigError(
            f"method {method}",
            found,
            allowed,
            "Take columns, or leave the penalties out.",
        )
