"""The bound that common prices prove, and what a column costs above it."""

import math
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from crazychoir.optimization.rounds.agreement import flood
from crazychoir.optimization.rounds.program import Exchange
from crazychoir.routing.distributed.master import Pool
from crazychoir.routing.distributed.member import Member
from crazychoir.routing.distributed.packing import packed, unpacked
from crazychoir.routing.pricing.route_table import Column
from crazychoir.types import Vec

ROUNDING = 1e-6
"""Of a number of robots: as much above a whole number is that number."""


@dataclass
class Bound:
    """What is proven of every plan, by prices pi that all robots have in common.

        cost of a plan >= value = n mu + sum_j pi_j + sum_i K_i least_i,
        least_i = min(0, min over the columns c of i of  length_c - mu - sum_{j in c} pi_j)

    which holds for every pi >= 0 and mu >= 0, because every task is served at least once, and at least n robots leave.
    i: the robots that speak for the K_i that are the same.
    value: m;  prices: pi, (M,) m;  reward: mu, m;  robots: n, see `least_robots`;  least: m, of each robot, the idle
    column included;  exact: all tables were complete.
    """

    value: float = -np.inf
    prices: Vec = field(default_factory=lambda: np.zeros(0))
    reward: float = 0.0
    robots: int = 0
    least: dict[int, float] = field(default_factory=dict)
    exact: bool = True

    def excess(self, robot: int, column: Column) -> float:
        """What a plan with this column costs above the bound, at least: its reduced cost beyond the robot's least."""
        own = [column.length, -self.reward] if column.tasks else [column.length]
        return math.fsum(
            [*own, -self.least[robot], *(-self.prices[j] for j in column.tasks)]
        )


def least_robots(bound: Bound, member: Member) -> Exchange[int]:
    """A number of robots that leave in every plan.

        value <= cost of a plan <= (robots that leave) longest + sum of the penalties of tasks that may be refused
        =>  robots that leave >= n = ceil((value - penalties) / longest)

    longest: m, the highest length of a column, the fixed cost in it, of all robots, whose tables are complete. Where
    the fixed cost is much more than any route, n is the number of robots in the relaxation, rounded up.
    """
    own = float(member.table.length.max()) if member.speaks else 0.0
    told = yield from flood(member.place.robot, own, member.place.diameter)
    refusal = member.local.tasks.refusal
    must = bound.value - math.fsum(refusal[np.isfinite(refusal)])
    longest = max(told.values())
    return (
        max(0, math.ceil(must / longest - ROUNDING))
        if longest > 0.0 and bound.exact
        else 0
    )


def improve(
    bound: Bound, member: Member, pool: Pool, pi: Vec, batch: int, mu: float = 0.0
) -> Exchange[bool]:
    """Price at pi and mu, flood what is not yet in the pool; keep the better bound; returns whether anybody had more.

    The sum is rounded once (fsum over values that all have heard), so that all robots find the same bound.
    """
    known = yield from flood(
        member.place.robot, _priced(member, pool, pi, batch, mu), member.place.diameter
    )
    told = {i: known[i] for i in member.alike}
    saved = [len(member.alike[i]) * least for i, (least, _, _) in told.items()]
    value = math.fsum([bound.robots * mu, *pi, *saved])
    bound.exact = all(complete for _, complete, _ in told.values())
    if value > bound.value:
        bound.value = value
        bound.prices = pi
        bound.reward = mu
        bound.least = {i: least for i, (least, _, _) in told.items()}
    return sum(pool.add(i, unpacked(news)) for i, (_, _, news) in told.items()) > 0


def _priced(
    member: Member, pool: Pool, pi: Vec, batch: int, mu: float
) -> list[Any] | None:
    """least_i, whether the table is complete, and columns of i; None of a robot that another one speaks for."""
    if not member.speaks:
        return None
    robot = member.place.robot
    table = member.table
    columns = [
        c
        for c in table.cheapest(pi, batch, 0.0, mu)
        if c.tasks and not pool.has(robot, c)
    ]
    return [table.least(pi, mu), table.complete, packed(columns)]
