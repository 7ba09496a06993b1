"""The bound that common prices prove, and what a column costs above it."""

import math
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from crazychoir.optimization.agreement import flood
from crazychoir.optimization.program import Exchange
from crazychoir.routing.master import Pool
from crazychoir.routing.member import Member
from crazychoir.routing.packing import packed, unpacked
from crazychoir.routing.pricing import Column
from crazychoir.types import Vec


@dataclass
class Bound:
    """What is proven of every plan, by prices pi that all robots have in common.

        cost of a plan >= value = sum_j pi_j + sum_i K_i least_i,    least_i = min over the columns c of i of
                                                                               length_c - sum_{j in c} pi_j

    which holds for every pi >= 0, because every task is served at least once. i: the robots that speak for the K_i that
    are the same.
    value: m;  prices: pi, (M,) m;  least: m, of each robot, the idle column included;  exact: all tables were complete.
    """

    value: float = -np.inf
    prices: Vec = field(default_factory=lambda: np.zeros(0))
    least: dict[int, float] = field(default_factory=dict)
    exact: bool = True

    def excess(self, robot: int, column: Column) -> float:
        """What a plan with this column costs above the bound, at least: its reduced cost beyond the robot's least."""
        return math.fsum([column.length, -self.least[robot], *(-self.prices[j] for j in column.tasks)])


def improve(bound: Bound, member: Member, pool: Pool, pi: Vec, batch: int) -> Exchange[bool]:
    """Price at pi, flood what is not yet in the pool; keep the better bound; returns whether anybody had more.

    The sum is rounded once (fsum over values that all have heard), so that all robots find the same bound.
    """
    known = yield from flood(member.place.robot, _priced(member, pool, pi, batch), member.place.diameter)
    told = {i: known[i] for i in member.alike}
    value = math.fsum([*pi, *(len(member.alike[i]) * least for i, (least, _, _) in told.items())])
    bound.exact = all(complete for _, complete, _ in told.values())
    if value > bound.value:
        bound.value, bound.prices = value, pi
        bound.least = {i: least for i, (least, _, _) in told.items()}
    return sum(pool.add(i, unpacked(news)) for i, (_, _, news) in told.items()) > 0


def _priced(member: Member, pool: Pool, pi: Vec, batch: int) -> list[Any] | None:
    """least_i, whether the table is complete, and columns of i; None of a robot that another one speaks for."""
    if not member.speaks:
        return None
    robot, table = member.place.robot, member.table
    columns = [c for c in table.cheapest(pi, batch, below=0.0) if c.tasks and not pool.has(robot, c)]
    return [table.least(pi), table.complete, packed(columns)]
