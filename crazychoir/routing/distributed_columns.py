"""The method `columns`: distributed column generation, then clusters of robots that improve one plan side by side."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from crazychoir.errors import SolverError
from crazychoir.optimization.agreement import best_offer, flood
from crazychoir.optimization.program import Exchange
from crazychoir.routing.bound import Bound
from crazychoir.routing.clusters import Cluster, draw_clusters, tasks_of, unserved
from crazychoir.routing.gossip import Gossip
from crazychoir.routing.introduction import introduce
from crazychoir.routing.master import Pool
from crazychoir.routing.member import Member
from crazychoir.routing.neighborhood import reoptimize
from crazychoir.routing.proof import Assignment, Offer, Proof
from crazychoir.routing.search import search
from crazychoir.routing.vehicle import Vehicle
from crazychoir.types import Vec

DISCLOSED: tuple[str, ...] = (
    "homes, capacities, limits and capabilities",
    "route columns (task sets and lengths)",
    "task prices",
    "least reduced costs",
    "plans (stops of all robots)",
    "route lengths",
)
BETTER = 1e-9
"""m: a plan that saves less than this is the same."""


class DistributedColumns:
    """All robots plan, none of them for all.

    1. The robots introduce themselves (introduction.py).
    2. Where the tables of all routes are of a size that can be made, gossip.py solves the relaxation and proves a bound.
    3. Each robot searches for a plan of its own from nothing; the best one, agreed on, is the first that all know.
    4. Passes: all draw the same disjoint clusters; each leader re-solves the joint problem of its cluster; what got
       better is flooded and taken over by all. Clusters are disjoint, so that any number of them fits together: the
       draw is the lock. The plan in force is feasible after each pass.
    5. Where few enough columns remain that a better plan could contain, or always if `prove`: proof.py.

    routes: of the plan in force, the nodes of each robot's stops.
    """

    def __init__(self, member: Member) -> None:
        self._member, self._i, self._diameter = member, member.place.robot, member.place.diameter
        self._m = len(member.local.tasks)
        self._vehicles: dict[int, Vehicle] = {}
        self.routes: dict[int, list[int]] = {}

    def run(self) -> Exchange[Assignment]:
        """Steps 1 to 5."""
        known = yield from introduce(self._member)
        self._vehicles = {i: local.vehicle for i, local in known.items()}
        pool, bound = yield from self._relax()
        yield from self._begin()
        yield from self._improve(bound)
        if (yield from self._is_provable(bound)):
            best = Offer(self._cost(self.routes), self._sets()) if not unserved(self.routes, self._m) else None
            return (yield from Proof(self._member, pool, bound, best).run())
        return self._assignment(bound)

    @property
    def _penalty(self) -> Vec:
        """(M,) m: what the search pays for a task left out, more than any plan could save by it."""
        return 10.0 * self._member.penalty

    def _relax(self) -> Exchange[tuple[Pool, Bound]]:
        """Column generation where every robot can list its routes."""
        if max(len(v.servable) for v in self._vehicles.values()) > self._member.settings.most_listed:
            return Pool(self._m), Bound(exact=False)
        gossip = Gossip(self._member)
        yield from gossip.run()
        return gossip.pool, gossip.bound

    def _begin(self) -> Exchange[None]:
        """The best of the plans that the robots find from nothing."""
        self._member.report(phase="start")
        self._member.kind = "plans"
        settings, robots = self._member.settings, sorted(self._vehicles)
        mine = None
        if self._i < settings.starters:
            empty: list[list[int]] = [[] for _ in robots]
            fleet = [self._vehicles[i] for i in robots]
            found = search(fleet, empty, self._penalty, settings.first_steps, self._i)
            mine = [found.total, self._i, _flat(dict(zip(robots, found.routes, strict=True)))]
        best = yield from best_offer(mine, self._diameter)
        if best is None:
            raise SolverError(f"robot {self._i}: first plan", "nobody offered one")
        self.routes = _unflat(best[2])
        self._member.report(cost=self._cost(self.routes))

    def _improve(self, bound: Bound) -> Exchange[None]:
        """Passes of clusters, until the bound is met, or nothing got better for `still_passes`."""
        settings = self._member.settings
        self._member.report(phase="clusters")
        passes = max(settings.least_passes, min(settings.most_passes, settings.cluster_rounds // max(1, self._diameter)))
        still = 0
        for k in range(passes):
            cost = self._cost(self.routes)
            if still == settings.still_passes or cost - bound.value <= settings.tolerance * max(1.0, cost):
                return
            clusters = draw_clusters(self._vehicles, self.routes, (settings.cluster_robots, settings.cluster_tasks), [k])
            mine = self._lead(clusters, settings.steps // passes, k)
            self._member.kind = "plans"
            known = yield from flood(self._i, mine, self._diameter)
            for news in known.values():
                if news is not None:
                    self.routes.update(_unflat(news))
            self._member.report(cost=self._cost(self.routes))
            still = 0 if any(news is not None for news in known.values()) else still + 1

    def _lead(self, clusters: Sequence[Cluster], steps: int, k: int) -> list[Any] | None:
        """What got better in the cluster that this robot leads, if it leads one."""
        own = next((c for c in clusters if c.leader == self._i), None)
        if own is None or not own.tasks:
            return None
        seed = k * self._member.place.robots + self._i
        new, _ = reoptimize(self._vehicles, self.routes, own, self._penalty, steps, seed)
        old = {i: self.routes.get(i, []) for i in own.robots}
        better = self._cost(new, own.tasks) < self._cost(old, own.tasks) - BETTER
        return _flat({i: stops for i, stops in new.items() if stops != old[i]}) if better else None

    def _is_provable(self, bound: Bound) -> Exchange[bool]:
        """Whether the columns that a better plan could contain are few, or whatever they are to be searched."""
        if not bound.least:
            return False
        if unserved(self.routes, self._m):
            return True
        self._member.kind = "columns"
        table, settings = self._member.table, self._member.settings
        gap = self._cost(self.routes) - bound.value
        count = int(np.count_nonzero(table.reduced_costs(bound.prices) <= table.least(bound.prices) + gap))
        known = yield from flood(self._i, count, self._diameter)
        return settings.prove or sum(known.values()) <= settings.most_proven

    def _assignment(self, bound: Bound) -> Assignment:
        left = unserved(self.routes, self._m)
        if left:
            why = f"incomplete: no plan found that serves task(s) {', '.join(map(str, left))}"
            raise SolverError(f"robot {self._i}: clusters", why)
        return Assignment(self._sets(), bound.value if bound.exact else None, self.routes)

    def _sets(self) -> dict[int, tuple[int, ...]]:
        sets = {i: tuple(tasks_of(stops, self._m)) for i, stops in self.routes.items()}
        return {i: tasks for i, tasks in sorted(sets.items()) if tasks}

    def _cost(self, routes: Mapping[int, Sequence[int]], tasks: Sequence[int] | None = None) -> float:
        """m: distances, fixed costs, and the penalty of what is left out of `tasks`, all if None."""
        left = [j for j in unserved(routes, self._m) if tasks is None or j in tasks]
        flown = [self._vehicles[i].length(stops) + self._vehicles[i].fixed for i, stops in sorted(routes.items()) if stops]
        return sum(flown, 0.0) + float(self._penalty[left].sum())


def _flat(routes: Mapping[int, Sequence[int]]) -> list[Any]:
    """Robots, numbers of stops, and all stops in a row."""
    ids = sorted(routes)
    stops = [s for i in ids for s in routes[i]]
    sizes = [len(routes[i]) for i in ids]
    return [np.array(ids, np.int32), np.array(sizes, np.int32), np.array(stops, np.int32)]


def _unflat(parts: Sequence[Any]) -> dict[int, list[int]]:
    ids, sizes, stops = (part.tolist() for part in parts)
    ends = np.cumsum(sizes).tolist()
    return {i: stops[end - n : end] for i, n, end in zip(ids, sizes, ends, strict=True)}
