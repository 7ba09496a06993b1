"""The method `columns`: distributed column generation, then improvement of the plan by clusters."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import islice
from typing import Any

import numpy as np

from crazychoir.errors import SolverError
from crazychoir.optimization.rounds.agreement import (
    find_best_offer,
    flood_offers,
    flood_values,
)
from crazychoir.optimization.rounds.program import Exchange
from crazychoir.routing.distributed.cluster_problem import (
    bound_saving,
    rename_nodes,
    reoptimize_cluster,
    restrict_problem,
)
from crazychoir.routing.distributed.clusters import (
    Cluster,
    SearchPass,
    list_anytime_passes,
    list_served_tasks,
    list_usual_passes,
)
from crazychoir.routing.distributed.diving import dive_for_plan
from crazychoir.routing.distributed.gossip import Gossip
from crazychoir.routing.distributed.infeasibility import explain_missing_tasks
from crazychoir.routing.distributed.large_bound import LargeBound
from crazychoir.routing.distributed.master import Routes
from crazychoir.routing.distributed.member import RoutingMember
from crazychoir.routing.distributed.plan_measure import is_better
from crazychoir.routing.distributed.proof import PlanOffer, PlanProof, TaskPartition
from crazychoir.routing.distributed.robot_profile import (
    SENT_FIELD_NAMES,
    introduce_robots,
)
from crazychoir.routing.instance.instance import LocalProblem
from crazychoir.routing.instance.vehicle import OBJECTIVE_NAMES
from crazychoir.routing.pricing.route_table import RouteColumn, find_shortest_route
from crazychoir.types import Vec

DISTRIBUTED_COLUMNS_DISCLOSURES: tuple[str, ...] = (
    *(f"own {name}" for name in SENT_FIELD_NAMES),
    "how many tasks it can serve, and whether its routes could be listed",
    "route columns (task sets and lengths)",
    "task prices",
    "least reduced costs",
    "plans (stops of all robots)",
)
"""Data that the robots disclose to each other."""


class DistributedColumns:
    """Plan with all robots, without a central planner.

    1. The robots exchange descriptions of themselves (robot_profile.py).
    2. Some robots search for a plan from nothing. The team agrees on the best one, the first plan.
       If a budget is given, a few passes improve it.
    3. If every robot can list its routes, gossip.py solves the relaxation and proves a bound.
    4. proof.py searches for a better plan if few enough columns remain, or always if `prove`.
    5. Unless the plan is proven optimal, passes follow. In each pass all robots draw the same
       disjoint clusters. The leaders of each cluster solve its joint problem again. The best result
       is flooded, and all robots adopt it. Clusters are disjoint, so the results of any number of
       clusters fit together without locks. The plan in force is feasible after each pass.
       Passes go on while a given budget lasts; see clusters.py.
    6. If step 3 was not possible and `prove` is set, large_bound.py computes a bound. If its pricing
       is exact, diving.py looks for better plans, and proof.py searches the columns near the bound.

    If the budget is over, the robots skip what is left, and keep the plan in force.

    `routes`: nodes of each robot's stops in the plan in force.
    """

    def __init__(self, member: RoutingMember) -> None:
        self._member = member
        self._budget = member.budget
        self._i = member.place.robot
        self._m = len(member.local.tasks)
        self._robots: Mapping[int, LocalProblem] = {}
        self.routes: dict[int, list[int]] = {}

    def run(self) -> Exchange[TaskPartition]:
        """Run steps 1 to 6."""
        known = yield from introduce_robots(self._member)
        self._robots = known.robots
        self._order = known.order
        self._measure = known.measure
        self._near = known.near
        self._left_out = _price_left_out(self._member, known.robots)
        yield from self._begin()
        if self._budget.is_given:
            yield from self._improve(-np.inf, self._draw_passes(early=True))
        gossip = yield from self._relax()
        if gossip is None:
            yield from self._improve(-np.inf, self._draw_passes())
            return (yield from self._bounded())
        proof = PlanProof(self._member, gossip.pool, gossip.bound, self._offer())
        settings = self._member.settings
        yield from proof.search(
            np.inf if settings.proof.prove else settings.proof.most_proven
        )
        self._take_over(proof)
        if not proof.closed:
            yield from self._improve(proof.proven, self._draw_passes())
        return self._assignment(proof.proven)

    def _bounded(self) -> Exchange[TaskPartition]:
        """Return the plan in force, with a bound if one is asked for and possible.

        A bound needs `prove`, lengths as the objective, and no priorities.
        """
        member = self._member
        if (
            self._budget.is_over
            or not member.settings.proof.prove
            or OBJECTIVE_NAMES.makespan in member.local.objective
            or (member.local.tasks.priority > 0).any()
        ):
            return self._assignment(None)
        large = LargeBound(member, self.columns())
        offer = self._offer()
        yield from large.run()
        if large.value is None or large.relaxation is not None or offer is None:
            return self._assignment(large.value, large.relaxation)
        known = large.pool, large.halves, large.bound.value
        yield from dive_for_plan(self, member, self._near, *known)
        offer = self._offer()
        proof = PlanProof(member, large.pool, large.bound, offer, large.halves)
        yield from proof.search_few(member.settings.proof.large_nodes)
        self._take_over(proof)
        return self._assignment(proof.proven)

    @property
    def cost(self) -> float:
        """Cost of the plan in force, m; see PlanMeasure.compute_weighed_cost."""
        return self._measure.compute_weighed_cost(self.routes)

    def columns(self) -> list[tuple[int, RouteColumn]]:
        """Return the routes of the plan in force as (robot, column)."""
        measure = self._measure.measure_flight
        weight = self._member.vehicle_weight
        return [
            (i, RouteColumn(weight + measure(i, tuple(self.routes[i]))[0], tasks))
            for i, tasks in self._sets().items()
        ]

    def adopt(self, sets: Routes, anew: bool = False) -> bool:
        """Adopt a plan that serves these sets of tasks if it is better than the plan in force.

        anew: whether the routes of robots that keep their tasks are optimised again.
        """
        old = {} if anew else self._sets()
        changed = {
            i: problem
            for i, problem in self._robots.items()
            if anew or sets.get(i, ()) != old.get(i, ())
        }
        objective = self._member.local.objective
        new = self.routes | _find_shortest_plan(changed, sets, objective)
        worth = self._measure.compute_worth(new)
        if not is_better(worth, self._measure.compute_worth(self.routes)):
            return False
        self.routes = new
        self._report_cost()
        return True

    def _relax(self) -> Exchange[Gossip | None]:
        """Generate columns if lengths are minimised and every robot can list its routes.

        Returns None otherwise.
        """
        member = self._member
        if OBJECTIVE_NAMES.makespan in member.local.objective or self._budget.is_over:
            return None
        servable = yield from flood_values(
            self._i, len(member.local.servable), self._member.place.diameter
        )
        if max(servable.values()) > member.settings.columns.most_listed:
            return None
        complete = yield from flood_values(
            self._i,
            not member.speaks
            or (
                not (member.is_table_hopeless or self._budget.is_spent)
                and member.table.complete
            ),
            self._member.place.diameter,
        )
        if not all(complete.values()):
            vars(member).pop(
                "table", None
            )  # incomplete tables are large and prove no bound
            return None
        gossip = Gossip(self._member)
        yield from gossip.run()
        return gossip

    def _begin(self) -> Exchange[None]:
        """Adopt the best of the plans that the robots find from nothing."""
        self._member.report(phase="start")
        self._member.kind = "plans"
        settings = self._member.settings
        mine = None
        rank = self._order.robot_rank[self._i]
        starters = settings.search.starters
        if self._budget.is_given:
            starters = settings.anytime.starters
        self._budget.charge(settings.search.first_steps)
        if rank == 0 or (rank < starters and not self._budget.is_spent):
            all_robots = Cluster(self._order.robots, self._order.tasks, (self._i,))
            routes = reoptimize_cluster(
                self._robots,
                {},
                all_robots,
                self._left_out,
                settings.search.first_steps,
                rank,
            )
            mine = [
                self._measure.compute_worth(routes),
                rank,
                _flatten_routes({i: stops for i, stops in routes.items() if stops}),
            ]
        best = yield from find_best_offer(mine, self._member.place.diameter)
        if best is None:
            raise SolverError(f"robot {self._i}: first plan", "no robot offered one")
        self.routes = {i: [] for i in self._robots} | _unflatten_routes(best[2])
        self._report_cost()

    def _draw_passes(self, early: bool = False) -> Iterator[SearchPass]:
        """Return the passes, or with `early` those before the relaxation of the problem."""
        settings = self._member.settings
        if not self._budget.is_given:
            return list_usual_passes(
                settings.search, len(self._robots), self._m, self._member.place.diameter
            )
        first = settings.anytime.first_passes
        return islice(
            list_anytime_passes(settings.anytime),
            0 if early else first,
            first if early else None,
        )

    def _improve(self, bound: float, passes: Iterable[SearchPass]) -> Exchange[None]:
        """Run passes of clusters.

        They end when the cost meets the bound, after `still_passes` passes without a gain unless a
        budget is given, or when the budget is spent.
        """
        settings = self._member.settings
        self._member.report(phase="clusters")
        self._member.kind = "plans"
        still = 0
        for one in passes:
            missing = self._measure.compute_worth(self.routes)[0]
            cost = self._measure.compute_weighed_cost(self.routes)
            met = not missing and cost - bound <= self._member.tolerance(cost)
            idle = still == settings.search.still_passes and not self._budget.is_given
            if met or idle or not self._budget.allows(one.steps):
                return
            clusters = self._near.draw(
                self.routes, one.cluster, one.leaders, [one.number]
            )
            offers = yield from flood_offers(
                self._i, self._lead(clusters, one), self._member.place.diameter
            )
            better = _choose_best_offers(clusters, offers, self._order.robot_rank)
            self.routes.update(better)
            still = 0 if better else still + 1
            self._report_cost()

    def _report_cost(self) -> None:
        """Report the cost of the plan in force, and whether it serves all tasks."""
        complete = not self._measure.list_missing_tasks(self.routes)
        self._member.report_plan(
            self._measure.compute_shown_cost(self.routes), complete
        )

    def _lead(self, clusters: Sequence[Cluster], one: SearchPass) -> list[Any] | None:
        """Solve the cluster that this robot leads; return worth and routes if better.

        Returns None if the robot leads no cluster, found nothing better, or has no time left.
        """
        own = next((c for c in clusters if self._i in c.leaders), None)
        if own is None or not own.tasks or self._budget.is_spent:
            return None
        rank = self._order.robot_rank[self._i]
        new = reoptimize_cluster(
            self._robots,
            self.routes,
            own,
            self._left_out,
            one.steps,
            one.number * self._member.place.robots + rank,
            one.options,
        )
        old = {i: self.routes.get(i, []) for i in own.robots}
        worth = self._measure.compute_worth(new, own.tasks)
        if not is_better(worth, self._measure.compute_worth(old, own.tasks)):
            return None
        return [
            worth,
            _flatten_routes({i: stops for i, stops in new.items() if stops != old[i]}),
        ]

    def _offer(self) -> PlanOffer | None:
        """Return the plan in force as an offer, None if a task that must be served is missing."""
        if self._measure.list_missing_tasks(self.routes):
            return None
        cost = self._measure.compute_weighed_cost(self.routes)
        return PlanOffer(cost, self._sets())

    def _take_over(self, proof: PlanProof) -> None:
        """Adopt the routes of the proof's plan if it is better than the plan in force.

        Raises SolverError if the proof says that there is no plan.
        """
        if proof.infeasible:
            why = "each can be served alone, but not all together (proven)"
            raise SolverError(
                f"infeasible: no plan serves every task; {why}; {self._obstacle()} (robot {self._i})",
                "infeasible",
            )
        if proof.best is not None:
            self.adopt(proof.best.routes, anew=True)

    def _assignment(
        self, bound: float | None, relaxation: str | None = None
    ) -> TaskPartition:
        left = self._measure.list_missing_tasks(self.routes)
        if left:
            tasks = ", ".join(map(str, left))
            why = f"infeasible, not proven: no plan found that serves task(s) {tasks}; {self._obstacle()}"
            raise SolverError(f"robot {self._i}: clusters", why)
        return TaskPartition(self._sets(), bound, self.routes, relaxation)

    def _obstacle(self) -> str:
        return explain_missing_tasks(
            self._robots,
            self._order,
            self._left_out,
            self._member.settings.search.first_steps,
        )

    def _sets(self) -> dict[int, tuple[int, ...]]:
        sets = {
            i: tuple(list_served_tasks(stops, self._m))
            for i, stops in self.routes.items()
        }
        return {i: tasks for i, tasks in sorted(sets.items()) if tasks}


def _price_left_out(member: RoutingMember, robots: Mapping[int, LocalProblem]) -> Vec:
    """Return (M,): cost of a task that the search leaves out.

    It is the refusal, or for a task that must be served more than any plan could save.
    """
    refusal = member.local.tasks.refusal
    saving = bound_saving(robots, member.reach)
    return np.where(np.isfinite(refusal), refusal, saving)


def _choose_best_offers(
    clusters: Sequence[Cluster], offers: Mapping[int, Any], rank: Mapping[int, int]
) -> dict[int, list[int]]:
    """Return the routes of the best offer of each cluster, without the clusters that have none."""
    better: dict[int, list[int]] = {}
    for cluster in clusters:
        made = [
            (list(offers[i][0]), rank[i], i) for i in cluster.leaders if i in offers
        ]
        if made:
            better |= _unflatten_routes(offers[min(made)[2]][1])
    return better


def _find_shortest_plan(
    robots: Mapping[int, LocalProblem], sets: Routes, objective: tuple[str, ...]
) -> dict[int, list[int]]:
    """Return the best route of each robot that serves exactly its set of tasks."""
    return {
        i: _find_shortest_stops(problem, sets.get(i, ()), objective)
        for i, problem in robots.items()
    }


def _find_shortest_stops(
    problem: LocalProblem, tasks: tuple[int, ...], objective: tuple[str, ...]
) -> list[int]:
    """Return the stops of the robot's best route that serves exactly these tasks."""
    chosen = np.array(tasks, dtype=np.int64)
    vehicle = restrict_problem(problem, chosen).vehicle
    stops, _ = find_shortest_route(vehicle, range(len(tasks)), objective)
    return rename_nodes(stops, chosen, len(problem.tasks))


def _flatten_routes(routes: Mapping[int, Sequence[int]]) -> list[Any]:
    """Return robots, numbers of stops, and all stops in one array."""
    ids = sorted(routes)
    stops = [s for i in ids for s in routes[i]]
    sizes = [len(routes[i]) for i in ids]
    return [
        np.array(ids, np.int32),
        np.array(sizes, np.int32),
        np.array(stops, np.int32),
    ]


def _unflatten_routes(parts: Sequence[Any]) -> dict[int, list[int]]:
    ids, sizes, stops = (part.tolist() for part in parts)
    ends = np.cumsum(sizes).tolist()
    return {i: stops[end - n : end] for i, n, end in zip(ids, sizes, ends, strict=True)}
