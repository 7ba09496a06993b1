"""Recovery from shared columns: all robots learn the promising routes of all, and agree on one proven plan."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import accumulate
from typing import Any

import numpy as np

from crazychoir.errors import SolverError
from crazychoir.optimization.agreement import best_offer, flood
from crazychoir.optimization.program import Exchange
from crazychoir.routing.master import Pool, partition
from crazychoir.routing.member import Member
from crazychoir.routing.plan import sha256
from crazychoir.routing.pricing import Column
from crazychoir.routing.primal_decomposition import PriceRounds
from crazychoir.types import Vec

DISCLOSED: tuple[str, ...] = (
    "task prices",
    "route columns (task sets and lengths)",
    "least reduced costs",
    "plan",
    "route lengths",
)


@dataclass(frozen=True)
class Assignment:
    """Who serves what: tasks of each robot that is known;  lower_bound in m, None if none is exact."""

    routes: dict[int, tuple[int, ...]]
    lower_bound: float | None


@dataclass(frozen=True)
class _Offer:
    """A plan that all have heard of: cost in m, tasks of each robot, what its search proved in m."""

    cost: float
    routes: dict[int, tuple[int, ...]]
    searched: float


class ColumnRecovery:
    """Column generation over floods, then set partitioning with a certificate.

    1. Flood the active columns and mean prices of all robots; pi = the mean over the robots.
    2. Each robot prices exactly at pi; flood least_i = min(0, least reduced cost) and its best columns:

           lower bound = sum_j pi_j + sum_i least_i                (valid for every common pi >= 0)

    3. Each robot solves the relaxed restricted master; flood its duals; pi = their mean; again from 2 until the
       relaxation is within `tolerance` of the bound.
    4. A plan with column c of robot i costs at least lower bound + excess(c), the excess of its reduced cost over
       least_i. Flood all columns of an excess <= gap; each robot solves the set partitioning of those, every task
       exactly once; min-consensus on (cost, robot) picks one plan, sent with its hash. If its cost is within
       gap of the bound, it is optimal; else double the gap and again. A partitioning of more than `small` columns
       is left to the `searchers` lowest ids, because it costs seconds and one answer is enough.

    Every decision that ends a loop is taken from flooded values, with sums that every machine rounds alike, so all
    robots end in the same round.
    Raises SolverError if there is no plan, or if a plan arrives damaged.
    """

    def __init__(self, member: Member, prices: PriceRounds) -> None:
        self._member, self._prices = member, prices
        self._i, self._diameter = member.place.robot, member.place.diameter
        self._pool = Pool(len(member.local.tasks))
        self._bound, self._best_prices = -np.inf, prices.mean_price
        self._least: dict[int, float] = {}
        self._exact = True
        self._infeasible = False

    def run(self) -> Exchange[Assignment]:
        """Steps 1 to 4."""
        pi = yield from self._start()
        yield from self._generate(pi)
        return (yield from self._integrate())

    def _start(self) -> Exchange[Vec]:
        self._member.report(phase="columns")
        own = _packed([c for _, c in sorted(self._prices.active.items())])
        mine = [own, self._prices.mean_price.tolist(), self._member.table.complete]
        known = yield from flood(self._i, mine, self._diameter)
        for robot, (columns, _, complete) in known.items():
            self._pool.add(robot, _unpacked(columns))
            self._exact = self._exact and complete
        return _mean([mu for _, mu, _ in known.values()])

    def _generate(self, pi: Vec) -> Exchange[None]:
        member = self._member
        for _ in range(member.settings.passes):
            new = yield from self._share(pi, member.settings.batch, below=0.0)
            relaxed = self._pool.relax(member.penalty)
            known = yield from flood(self._i, [relaxed.value, relaxed.prices.tolist()], self._diameter)
            value = min(v for v, _ in known.values())
            if not new or value - self._bound <= member.settings.tolerance * max(1.0, value):
                return
            pi = _mean([prices for _, prices in known.values()])

    def _share(self, pi: Vec, count: int, below: float) -> Exchange[bool]:
        """Price at pi, flood what is not yet in the pool; improve the bound; returns whether anybody had more."""
        table = self._member.table
        columns = [c for c in table.cheapest(pi, count, below) if c.tasks and not self._pool.has(self._i, c)]
        least = min(0.0, table.least(pi))
        known = yield from flood(self._i, [least, _packed(columns)], self._diameter)
        bound = math.fsum([*pi, *(v for v, _ in known.values())])
        if bound > self._bound:
            self._bound, self._best_prices = bound, pi
            self._least = {robot: v for robot, (v, _) in known.items()}
        return sum(self._pool.add(robot, _unpacked(packed)) for robot, (_, packed) in known.items()) > 0

    def _integrate(self) -> Exchange[Assignment]:
        """Step 4: widen the gap until the plan's own gap is inside it."""
        settings = self._member.settings
        self._member.report(phase="plan")
        unit = max(1.0, abs(self._bound))
        gap, proven, exhausted = settings.first_gap * unit, self._bound, False
        best: _Offer | None = None
        for _ in range(settings.passes):
            exhausted = yield from self._widen(gap)
            found = yield from self._agree(gap)
            if found is not None:
                proven = max(proven, min(found.searched, self._bound + gap))
                best = found if best is None or found.cost < best.cost else best
            own_gap = np.inf if best is None else best.cost - self._bound + settings.tolerance * unit
            closed = best is not None and best.cost - proven <= settings.tolerance * unit
            if closed or exhausted or own_gap <= gap:
                break
            gap = min(2.0 * gap, own_gap)
        if best is None:
            why, status = self._failure(exhausted)
            raise SolverError(f"{why} (robot {self._i}: set partitioning of {len(self._pool)} columns)", status)
        return Assignment(best.routes, min(proven, best.cost) if self._exact else None)

    def _failure(self, exhausted: bool) -> tuple[str, str]:
        """Why there is no plan, and the status."""
        if not self._exact:
            why = "no plan found: route tables were cut at most_labels. Narrow capability or route_length_limit"
            return why, "incomplete"
        if exhausted and self._infeasible:
            why = "each can be served alone, but not all together within capability, capacity and route_length_limit"
            return f"infeasible: no plan serves every task; {why}", "infeasible"
        return "no plan found within the passes and nodes", "incomplete"

    def _widen(self, gap: float) -> Exchange[bool]:
        """Flood all columns within the gap, a part at a time; returns whether no robot has any beyond."""
        pi, table, settings = self._best_prices, self._member.table, self._member.settings
        most = max(1, min(settings.most_shared, settings.most_relayed // self._member.place.robots))
        near = table.cheapest(pi, len(table), below=table.least(pi) + gap)
        fresh = [c for c in near if c.tasks and not self._pool.has(self._i, c)]
        while True:
            own = [_packed(fresh[:most]), len(fresh) <= most, len(near) == len(table)]
            known = yield from flood(self._i, own, self._diameter)
            for robot, (packed, _, _) in known.items():
                self._pool.add(robot, _unpacked(packed))
            if all(last for _, last, _ in known.values()):
                return all(exhausted for _, _, exhausted in known.values())
            fresh = fresh[most:]

    def _agree(self, gap: float) -> Exchange["_Offer | None"]:
        """The best plan that a robot finds among the columns within the gap."""
        best = yield from best_offer(self._search(gap), self._diameter)
        if best is None:
            return None
        cost, robot, routes, searched, digest = best
        if sha256(routes) != digest:
            raise SolverError(f"robot {self._i}: the plan of robot {robot}", "damaged: its hash differs")
        self._member.report(cost=float(cost))
        return _Offer(float(cost), {int(i): tuple(int(j) for j in tasks) for i, tasks in routes}, float(searched))

    def _search(self, gap: float) -> list[Any] | None:
        """Own offer: cost, robot, routes, searched bound, hash. A large search is left to a few robots."""
        settings = self._member.settings
        useful = [(i, c) for i, c in self._pool.items() if self._excess(i, c) <= gap]
        if len(useful) > settings.small and self._i >= settings.searchers:
            return None
        found = partition(useful, len(self._member.local.tasks), self._i, settings.nodes)
        self._infeasible = found.bound == np.inf
        if found.cost == np.inf:
            return None
        routes = [[robot, list(tasks)] for robot, tasks in sorted(found.routes.items())]
        return [found.cost, self._i, routes, found.bound, sha256(routes)]

    def _excess(self, robot: int, column: Column) -> float:
        """What a plan with this column costs above the bound, at least: its reduced cost beyond the robot's least."""
        return math.fsum([column.length, -self._least[robot], *(-self._best_prices[j] for j in column.tasks)])


def _packed(columns: Sequence[Column]) -> list[Any]:
    """Lengths (K,), numbers of tasks (K,), and all tasks in a row: arrays cross the codec in no time."""
    tasks = [j for column in columns for j in column.tasks]
    sizes = [len(column.tasks) for column in columns]
    return [np.array([c.length for c in columns], dtype=float), np.array(sizes, np.int16), np.array(tasks, np.int16)]


def _unpacked(packed: Sequence[Any]) -> list[Column]:
    lengths, sizes, tasks = (part.tolist() for part in packed)
    ends = list(accumulate(sizes))
    return [Column(length, tuple(tasks[end - n : end])) for length, n, end in zip(lengths, sizes, ends, strict=True)]


def _mean(rows: list[list[float]]) -> Vec:
    return np.asarray(np.mean(np.array(rows), axis=0))
