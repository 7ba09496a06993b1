"""The lower bound that common prices prove, and how much a column costs above it."""

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from crazychoir.optimization.rounds.agreement import flood_values
from crazychoir.optimization.rounds.program import Exchange
from crazychoir.routing.distributed.master import ColumnPool
from crazychoir.routing.distributed.member import RoutingMember
from crazychoir.routing.pricing.packing import pack_columns, unpack_columns
from crazychoir.routing.pricing.route_table import RouteColumn
from crazychoir.routing.pricing.subset_rows import NO_ROWS, PricedRows
from crazychoir.types import Vec

ROBOT_COUNT_ROUNDING = 1e-6
"""A number of robots that exceeds a whole number by at most this counts as that number."""
GAP_LEVELS = 16
"""Number of gaps that are counted at once."""


@dataclass
class Bound:
    """The lower bound on every plan that prices pi prove; pi is the same at all robots.

        cost of a plan >= value = n mu + sum_j pi_j + sum_i K_i least_i,
        least_i = min(0, min over the columns c of i of  length_c - mu - sum_{j in c} pi_j)

    This holds for every pi >= 0 and mu >= 0, because every task is served at least once, and at
    least n robots leave home. Subset rows add their charges to the lengths, and their value to the
    bound: it then holds for plans that serve each task at most once. The sum runs over one robot i
    of each group of K_i identical robots.
    """

    value: float = -np.inf
    """m: the bound."""
    prices: Vec = field(default_factory=lambda: np.zeros(0))
    """pi, (M,) m."""
    reward: float = 0.0
    """mu, m."""
    robots: int = 0
    """n, see `count_needed_robots`."""
    least: dict[int, float] = field(default_factory=dict)
    """m: least_i of each robot, the idle column included."""
    exact: bool = True
    """Whether all route tables were complete."""
    rows: PricedRows = NO_ROWS
    """The subset rows."""

    def excess(self, robot: int, column: RouteColumn) -> float:
        """Return a lower bound in m on how far a plan with this column costs above the bound.

        It is the column's reduced cost minus the robot's least reduced cost.
        """
        own = [column.length, -self.reward] if column.tasks else [column.length]
        return math.fsum(
            [
                *own,
                -self.least[robot],
                *(-self.prices[j] for j in column.tasks),
                self.rows.charge(robot, column.tasks),
            ]
        )


def count_needed_robots(bound: Bound, member: RoutingMember) -> Exchange[int]:
    """Return a number n of robots that leave home in every plan.

        value <= cost of a plan <= (robots that leave) longest + penalties
        =>  robots that leave >= n = ceil((value - penalties) / longest)

    penalties: sum over the tasks that may be refused.
    longest: m, the largest length of a column of any robot, with the fixed cost. The tables must be
    complete, otherwise n = 0. If the fixed cost is much larger than any route, n is the number of
    robots in the relaxation, rounded up.
    """
    own = float(member.table.length.max()) if member.speaks else 0.0
    told = yield from flood_values(member.place.robot, own, member.place.diameter)
    refusal = member.local.tasks.refusal
    must = bound.value - math.fsum(refusal[np.isfinite(refusal)])
    longest = max(told.values())
    return (
        max(0, math.ceil(must / longest - ROBOT_COUNT_ROUNDING))
        if longest > 0.0 and bound.exact
        else 0
    )


def find_fitting_gap(
    bound: Bound,
    member: RoutingMember,
    near: Callable[[float, float], list[RouteColumn] | None],
    gaps: tuple[float, float],
    most: int,
) -> Exchange[float]:
    """Return the widest gap within which all robots together have at most `most` columns.

    near: the columns of this robot within a gap in m; None if there are more than a number.
    gaps: m, the first gap to try, and the widest useful gap.
    Gaps are tried in steps of a factor of 2, then in GAP_LEVELS equal parts of the last one. If a
    robot alone has more columns within a gap, the interval below that gap is halved until it is
    shorter than such a part.
    Returns m; 0 if no gap fits.
    """
    gap, widest = gaps
    fitting = 0.0
    crowded = np.inf
    while gap > member.tolerance(bound.value):
        levels = gap * np.arange(1, GAP_LEVELS + 1) / GAP_LEVELS
        own = near(gap, most)
        counts = None
        if own is not None:
            excess = np.sort([bound.excess(member.place.robot, c) for c in own])
            counts = np.searchsorted(excess, levels, side="right")
        told = yield from flood_values(
            member.place.robot, counts, member.place.diameter
        )
        if any(known is None for known in told.values()):
            crowded = gap
        else:
            fits = np.sum(list(told.values()), axis=0) <= most
            if not fits.all():
                return max(fitting, float(levels[fits].max(initial=0.0)))
            if gap >= widest:
                return widest
            fitting = gap
        if crowded == np.inf:
            gap = min(2.0 * gap, widest)
            continue
        if crowded - fitting <= crowded / GAP_LEVELS:
            return fitting
        gap = (fitting + crowded) / 2.0
    return fitting


def improve_bound(
    bound: Bound,
    member: RoutingMember,
    pool: ColumnPool,
    pi: Vec,
    batch: int,
    mu: float = 0.0,
) -> Exchange[bool]:
    """Price at pi and mu, flood the columns that are new, and keep the better bound.

    bound: the best bound so far, changed in place.
    member: this robot.
    pool: the known columns, extended in place.
    pi: (M,) m, prices of the tasks.
    batch: columns that a robot offers, at most.
    mu: m, reward of each robot that leaves home.
    Returns whether any robot had new columns. The sum is rounded once (fsum over the flooded
    values), so that all robots compute the same bound.
    """
    known = yield from flood_values(
        member.place.robot,
        _price_routes(member, pool, pi, batch, mu),
        member.place.diameter,
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
    return (
        sum(pool.add(i, unpack_columns(news)) for i, (_, _, news) in told.items()) > 0
    )


def _price_routes(
    member: RoutingMember, pool: ColumnPool, pi: Vec, batch: int, mu: float
) -> list[Any] | None:
    """Return least_i, whether the table is complete, and columns of i.

    Returns None if another robot of the same group prices for this one.
    """
    if not member.speaks:
        return None
    robot = member.place.robot
    table = member.table
    columns = [
        c
        for c in table.cheapest(pi, batch, 0.0, mu)
        if c.tasks and not pool.has(robot, c)
    ]
    return [table.least(pi, mu), table.complete, pack_columns(columns)]
