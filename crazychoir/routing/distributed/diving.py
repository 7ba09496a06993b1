"""Diving: round the linear relaxation to a plan, one route after the other."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from crazychoir.optimization.rounds.agreement import find_best_offer, flood_values
from crazychoir.optimization.rounds.program import Exchange
from crazychoir.routing.distributed.clusters import Neighbors
from crazychoir.routing.distributed.master import (
    ColumnPool,
    Master,
    PartitionProblem,
    Relaxation,
    Routes,
    find_partition,
)
from crazychoir.routing.distributed.member import RoutingMember
from crazychoir.routing.pricing.bidirectional_pricing import HalfRoutes
from crazychoir.routing.pricing.packing import pack_columns, unpack_columns
from crazychoir.routing.pricing.route_table import RouteColumn
from crazychoir.types import Vec

FORBIDDEN_PRICE = -1e6
"""m: price of a task that another route serves already."""


@dataclass(frozen=True, slots=True)
class DivePasses:
    """How long a dive prices before it fixes a route."""

    passes: int = 3
    """Passes of pricing before each fixed route, at most."""
    certain: float = 0.99
    """Columns with at least this part are fixed together."""
    batch: int = 20
    """Columns that a robot offers in a pass."""
    tried: int = 8
    """Columns that are tried, if none is certain; the best one is fixed."""
    nodes: int = 50
    """Branch-and-bound nodes of a search over the known columns, at most."""


DIVE_PASSES = DivePasses()


class PlanInForce(Protocol):
    """The plan that the team has agreed on."""

    @property
    def routes(self) -> Mapping[int, list[int]]:
        """Nodes of each robot's stops."""
        ...

    @property
    def cost(self) -> float:
        """Cost in m."""
        ...

    def columns(self) -> list[tuple[int, RouteColumn]]:
        """Return its routes as (robot, column)."""
        ...

    def adopt(self, sets: Routes) -> bool:
        """Take the plan with these tasks of each robot if it is better; return whether it is."""
        ...


def dive_for_plan(
    plan: PlanInForce,
    member: RoutingMember,
    near: Neighbors,
    pool: ColumnPool,
    halves: HalfRoutes | None,
    bound: float,
) -> Exchange[None]:
    """Round the relaxation to a plan, then that of one part of the plan after the other.

    Each plan is adopted if it is better than the plan in force. The dives end after `still_dives`
    parts without a gain, or when the plan meets the bound.

    plan: the plan in force.
    member: this robot.
    near: divides the plan into parts.
    pool: the columns that all robots know, extended in place.
    halves: the routes of this robot, None if it does not price.
    bound: m, no plan costs less.
    """
    settings = member.settings.proof
    if not settings.dives:
        return
    member.report(phase="dive")
    member.kind = "columns"
    if plan.cost - bound > member.tolerance(plan.cost):
        plan.adopt((yield from Dive(member, pool, halves, [], plan.cost).run()))
    still = 0
    for number in range(settings.dives):
        most = (member.place.robots, settings.dive_tasks)
        for part in near.draw(plan.routes, most, 1, [number]):
            cost = plan.cost
            met = cost - bound <= member.tolerance(cost)
            if met or still == settings.still_dives or member.budget.is_over:
                return
            if 2 * len(part.tasks) < settings.dive_tasks:
                continue
            fixed = [
                column for column in plan.columns() if column[0] not in part.robots
            ]
            dive = Dive(member, pool, halves, fixed, cost)
            still = 0 if plan.adopt((yield from dive.run())) else still + 1


class Dive:
    """Build a plan from the relaxation: fix a route, then price new routes for the tasks left.

    1. Two robots solve the relaxation of the known columns over the tasks and robots left.
    2. Each robot left floods columns of negative reduced cost that serve only tasks left.
    3. After some passes, or without new columns, a column with a large part is fixed.

    It ends when no part is left. A task that no column serves then stays out of the plan.
    4. If some routes were fixed from the beginning, one robot looks for the best plan of all known
       columns that can be part of a better plan with these routes.

    member: this robot.
    pool: the columns that all robots know, extended in place.
    halves: the routes of this robot, None if it does not price.
    fixed: routes that are fixed from the beginning, as (robot, column).
    below: m, cost of the known plan.
    Source: the diving heuristics of Sadykov, Vanderbeck, Pessoa, Tahiri & Uchoa 2019, INFORMS
    Journal on Computing 31(2).
    """

    def __init__(
        self,
        member: RoutingMember,
        pool: ColumnPool,
        halves: HalfRoutes | None,
        fixed: list[tuple[int, RouteColumn]],
        below: float = np.inf,
    ) -> None:
        self._member = member
        self._i = member.place.robot
        self._pool = pool
        self._halves = halves
        speaker = {i: same[0] for same in member.alike.values() for i in same}
        self._fixed = [(speaker[i], column) for i, column in fixed]
        self._taken: set[int] = set()
        self._left = {i: len(same) for i, same in member.alike.items()}
        self._take(self._fixed)
        self._given = list(self._fixed)
        self._below = below
        self._first: Relaxation | None = None
        self._first_sigma: dict[int, float] = {}

    def run(self) -> Exchange[dict[int, tuple[int, ...]]]:
        """Return the tasks of each robot that flies; none if the plan is not better than the known one."""
        while not self._member.budget.is_over:
            chosen = yield from self._choose()
            if not chosen:
                break
            self._fixed += chosen
            self._take(chosen)
        if self._given and not self._member.budget.is_over:
            yield from self._recombine()
        if math.fsum(column.length for _, column in self._fixed) >= self._below:
            return {}
        free = {i: iter(same) for i, same in self._member.alike.items()}
        return {next(free[i]): column.tasks for i, column in self._fixed}

    def _recombine(self) -> Exchange[None]:
        """Take the best plan of the known columns if it is better than the known plan."""
        own: list[Any] | None = None
        if self._i == 0:
            below = self._below
            if len(self._taken) == len(self._member.unserved):
                dived = math.fsum(column.length for _, column in self._fixed)
                below = min(below, dived)
            own = self._search(below - self._member.tolerance(below))
        told = yield from find_best_offer(own, self._member.place.diameter)
        if told is not None:
            robots, columns = told[2:4]
            self._fixed = list(
                zip(map(int, robots), unpack_columns(columns), strict=True)
            )

    def _search(self, below: float) -> list[Any] | None:
        """Return cost, robot, and the columns of a plan that costs less than `below`."""
        first = self._first
        if first is None or np.isfinite(self._member.local.tasks.refusal).any():
            return None
        fixed = math.fsum(column.length for _, column in self._given)
        gap = below - fixed - first.value
        taken = {j for _, column in self._given for j in column.tasks}
        left = {i: len(same) for i, same in self._member.alike.items()}
        for i, _ in self._given:
            left[i] -= 1
        useful = [
            (i, column)
            for i, column in self._pool.items()
            if left[i]
            and taken.isdisjoint(column.tasks)
            and column.length
            - math.fsum(first.prices[list(column.tasks)])
            - self._first_sigma.get(i, 0.0)
            <= gap
        ]
        columns = self._given + useful
        problem = PartitionProblem(
            columns, len(self._member.unserved), self._member.alike
        )
        found = find_partition(problem, 0, DIVE_PASSES.nodes, below=below)
        if found.cost >= below:
            return None
        speaker = {i: same[0] for same in self._member.alike.values() for i in same}
        length = {(i, column.tasks): column.length for i, column in columns}
        routes = [(speaker[i], tasks) for i, tasks in found.routes.items()]
        return [
            found.cost,
            self._i,
            [i for i, _ in routes],
            pack_columns([RouteColumn(length[i, tasks], tasks) for i, tasks in routes]),
        ]

    def _take(self, chosen: list[tuple[int, RouteColumn]]) -> None:
        """Take the tasks and robots of these routes out of the problem that is left."""
        tasks = {j for _, column in chosen for j in column.tasks}
        self._taken |= tasks
        for i, _ in chosen:
            self._left[i] -= 1
        if self._halves is not None and tasks:
            gone = not self._left.get(self._i, 0)
            self._halves = None if gone else self._halves.without(tasks)

    def _choose(self) -> Exchange[list[tuple[int, RouteColumn]]]:
        """Return the columns to fix next, none if nothing is left."""
        master = self._build_master() if self._searches else None
        for _ in range(DIVE_PASSES.passes):
            told = yield from find_best_offer(
                self._offer(master), self._member.place.diameter
            )
            if told is None:
                return []
            known = yield from flood_values(
                self._i, self._priced(told), self._member.place.diameter
            )
            new = 0
            for i, columns in known.items():
                if columns is not None:
                    unpacked = unpack_columns(columns)
                    new += self._pool.add(i, unpacked)
                    if master is not None:
                        master.add(i, unpacked)
            if not new:
                break
        picked = yield from find_best_offer(
            self._pick(master), self._member.place.diameter
        )
        if picked is None:
            return []
        robots, columns = picked[2:4]
        return list(zip(map(int, robots), unpack_columns(columns), strict=True))

    @property
    def _searches(self) -> bool:
        return self._i < self._member.settings.proof.searchers

    def _build_master(self) -> Master:
        """Return the relaxation of what is left."""
        penalty = np.array(self._member.unserved)
        penalty[list(self._taken)] = 0.0
        master = Master(penalty, 0.0, self._left)
        for i, column in self._pool.items():
            if self._left[i] and self._taken.isdisjoint(column.tasks):
                master.add(i, [column])
        return master

    def _offer(self, master: Master | None) -> list[Any] | None:
        """Return value, robot, prices, and the price of each robot."""
        if master is None:
            return None
        relaxed = master.relax()
        sigma = [[i, master.sigma(i)] for i in self._left]
        return [relaxed.value, self._i, relaxed.prices, sigma]

    def _pick(self, master: Master | None) -> list[Any] | None:
        """Return value, robot, and the columns to fix next, as robots and columns.

        Columns that are certain are fixed together. Otherwise it is the column that raises the
        relaxation of the known columns least, among the columns with the largest parts.
        """
        if master is None:
            return None
        relaxed = master.relax()
        if self._fixed == self._given:
            self._first = relaxed
            self._first_sigma = {i: master.sigma(i) for i in self._left}
        parts = sorted(
            master.parts, key=lambda part: (-round(part[0], 6), part[1], part[2])
        )
        chosen: list[tuple[int, RouteColumn]] = []
        left = dict(self._left)
        taken: set[int] = set()
        for part, i, column in parts:
            if part < DIVE_PASSES.certain:
                break
            if left[i] and taken.isdisjoint(column.tasks):
                chosen.append((i, column))
                taken.update(column.tasks)
                left[i] -= 1
        if not chosen and parts:
            tried = [
                (round(master.try_column(i, column), 6), k)
                for k, (_, i, column) in enumerate(parts[: DIVE_PASSES.tried])
            ]
            _, i, column = parts[min(tried)[1]]
            chosen = [(i, column)]
        return [
            relaxed.value,
            self._i,
            [i for i, _ in chosen],
            pack_columns([column for _, column in chosen]),
        ]

    def _priced(self, told: list[Any]) -> list[Any] | None:
        """Return columns of this robot that lower the value, None if it has no routes."""
        if self._halves is None:
            return None
        prices: Vec = np.array(told[2])
        prices[list(self._taken)] = FORBIDDEN_PRICE
        sigma: Mapping[int, float] = {int(i): float(s) for i, s in told[3]}
        below = sigma[self._i] - self._member.tolerance(float(told[0]))
        return pack_columns(self._halves.cheapest(prices, DIVE_PASSES.batch, below))
