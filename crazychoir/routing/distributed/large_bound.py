"""The lower bound on every plan if a robot has too many routes to list them."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from crazychoir.optimization.rounds.agreement import find_best_offer, flood_values
from crazychoir.optimization.rounds.program import Exchange
from crazychoir.routing.distributed.bound import Bound
from crazychoir.routing.distributed.master import ColumnPool, Master
from crazychoir.routing.distributed.member import RoutingMember
from crazychoir.routing.pricing.bidirectional_pricing import HalfRoutes
from crazychoir.routing.pricing.labels import MOST_TASKS
from crazychoir.routing.pricing.packing import pack_columns, unpack_columns
from crazychoir.routing.pricing.reduced_cost import (
    bound_reduced_cost,
    find_least_reduced_cost,
)
from crazychoir.routing.pricing.route_table import RouteColumn
from crazychoir.routing.pricing.subset_rows import NO_ROWS, PricedRows
from crazychoir.types import Vec

NG_ROUTE = "ng-route"
"""Name of the relaxation in which a route may serve a task again, see reduced_cost.py.

A robot prices by it if its routes cannot be halved, or can be halved in too many ways.
"""


@dataclass(frozen=True, slots=True)
class BoundPasses:
    """How the passes of a large bound mix prices, how far they search, and when they end."""

    first_share: float = 0.8
    """Share of the cost of the plan in the first prices."""
    best_price_share: float = 0.6
    """Share of the best prices so far in the next prices."""
    label_factor: int = 3
    """A half-route search may have this many times the labels of a table, which stores more a
    label.
    """
    mixing_gap: float = 0.01
    """Relative gap below which prices are no longer mixed with the best prices."""
    final_gap: float = 1e-5
    """Relative gap between the value of the known columns and the bound at which the passes end.
    """
    final_share: float = 0.01
    """The passes also end when this gap is so small a share of that between plan and bound.

    A bound that is a little higher would hardly say more about such a plan, but it takes half of
    all passes.
    """
    cut_passes: int = 16
    """Passes with subset rows, at most."""
    cuts: int = 60
    """Subset rows that are added in a pass, at most."""
    cut_share: float = 0.1
    """Rows are added when the gap between the value of the known columns and the bound is at most
    this share of that between plan and bound.
    """


BOUND_PASSES = BoundPasses()


class LargeBound:
    """Find prices for the Lagrangian bound of bound.py in passes; only the pricing is expensive.

        pi_k = w * (prices of the best bound) + (1 - w) * (prices of the known columns)
        value_k = sum_j pi_kj + sum_i K_i least_i(pi_k),     pi_kj <= cost of leaving task j out

    w is BOUND_PASSES.best_price_share. Once the gap is small, or no columns are new, pi_k are the
    prices of the known columns alone.

    In each pass each robot floods least_i and columns of negative reduced cost. They are exact,
    by bidirectional_pricing.py, if the robot has few enough half-routes. Otherwise least_i is
    that of a relaxation. Two robots solve the relaxation over all known columns, and all robots
    adopt the prices of the better solution.

    The passes end when
    - the bound is close to the value of the known columns, see BOUND_PASSES,
    - no prices bring new columns,
    - twice `passes` passes are over, or
    - the pricing of a robot is cut: it could serve more than MOST_TASKS tasks, or has too many
      routes at these prices. Bounds proven earlier still hold.

    If the pricing was exact, up to BOUND_PASSES.cut_passes passes with subset rows follow. Their
    prices are those of the known columns and rows. They end when neither columns nor rows are new.

    member: this robot.
    plan: the known plan, a column for each robot that flies.
    `value`: m, None if there is no bound.
    `relaxation`: relaxation of the routes, None if they were priced exactly.
    `bound`: the bound with its prices and rows.
    `pool`: the columns that all robots know, with the columns of the plan.
    `halves`: the routes of this robot, None if it prices by the relaxation or not at all.
    Source: Wentges 1997, International Transactions in Operational Research 4(2), for the prices.
    """

    def __init__(
        self, member: RoutingMember, plan: Sequence[tuple[int, RouteColumn]]
    ) -> None:
        self._member = member
        self._i = member.place.robot
        speaker = {i: same[0] for same in member.alike.values() for i in same}
        self._plan = [(speaker[i], column) for i, column in plan]
        self.halves: HalfRoutes | None = None
        self._rows = NO_ROWS
        self._told: dict[int, Any] = {}
        self.bound = Bound()
        self.pool = ColumnPool(len(member.local.tasks))
        self.value: float | None = None
        self.relaxation: str | None = None

    def run(self) -> Exchange[None]:
        """Run the passes; all robots end in the same round with the same value."""
        member = self._member
        settings = self._member.settings
        member.report(phase="bound")
        member.kind = "columns"
        self.halves = self._listed()
        master = Master(
            member.unserved, 0.0, {i: len(same) for i, same in member.alike.items()}
        )
        for robot, column in self._plan:
            master.add(robot, [column])
            self.pool.add(robot, [column])
        best = -np.inf
        centre = self._start()
        pi = self._start()
        drawn = True
        cut_off = False
        for _ in range(settings.columns.passes * 2):
            priced = yield from self._price_all(pi)
            if priced is None:
                cut_off = True
                break
            if priced > best:
                best = priced
                centre = pi
            new = self._add_told(master)
            if not new and not drawn:
                break
            relaxed, prices, _, _ = yield from self._agree(master, 0)
            if relaxed - best <= self._final_gap(relaxed, best):
                break
            # If mixed prices find no columns, or the gap is small, use the columns' own prices.
            drawn = new > 0 and relaxed - best > BOUND_PASSES.mixing_gap * abs(relaxed)
            pi = (
                BOUND_PASSES.best_price_share * centre
                + (1.0 - BOUND_PASSES.best_price_share) * prices
                if drawn
                else prices
            )
        if not (cut_off or self.relaxation or member.vehicle_weight):
            yield from self._cut(master)
        self.value = self.bound.value if best > -np.inf else None

    def _cut(self, master: Master) -> Exchange[None]:
        """Raise the bound by subset rows, until no pass finds columns or violated rows."""
        added = 0
        new = 1
        for _ in range(BOUND_PASSES.cut_passes):
            if self._member.budget.is_over:
                return
            relaxed, pi, rows, added = yield from self._agree(master, BOUND_PASSES.cuts)
            if not (new or added) or self._open_gap <= self._member.tolerance(relaxed):
                return
            self._rows = rows
            if (yield from self._price_all(pi)) is None:
                return
            new = self._add_told(master)

    def _price_all(self, pi: Vec) -> Exchange[float | None]:
        """Price at pi and the present rows, and keep the bound if it is better.

        Returns the bound in m at these prices; None if the pricing of a robot was cut.
        """
        member = self._member
        known = yield from flood_values(
            self._i, self._priced(pi), member.place.diameter
        )
        self._told = {i: known[i] for i in member.alike}
        if any(least == -np.inf for least, _, _ in self._told.values()):
            return None
        saved = [
            len(member.alike[i]) * least for i, (least, _, _) in self._told.items()
        ]
        value = math.fsum([*pi, *saved, self._rows.value])
        self.relaxation = (
            None if all(exact for _, exact, _ in self._told.values()) else NG_ROUTE
        )
        if value > self.bound.value:
            least = {i: float(found) for i, (found, _, _) in self._told.items()}
            self.bound = Bound(value, pi, least=least, rows=self._rows)
            member.report_bound(value)
        return value

    def _add_told(self, master: Master) -> int:
        """Add the columns of the last pass; return how many are new."""
        new = 0
        for i, (_, _, columns) in self._told.items():
            self.pool.add(i, unpack_columns(columns))
            new += master.add(i, unpack_columns(columns))
        return new

    @property
    def _open_gap(self) -> float:
        """m between the plan and the bound."""
        return self._plan_cost - self.bound.value

    def _final_gap(self, relaxed: float, best: float) -> float:
        """Return the gap in m at which the passes end."""
        least = BOUND_PASSES.final_gap * max(1.0, abs(relaxed))
        if self._member.vehicle_weight:
            return least
        open_gap = self._plan_cost - best
        return max(least, BOUND_PASSES.final_share * open_gap)

    @property
    def _plan_cost(self) -> float:
        """m: cost of the plan, with the tasks that it refuses."""
        refused = np.array(self._member.local.tasks.refusal)
        for _, column in self._plan:
            refused[list(column.tasks)] = 0.0
        lengths = (column.length for _, column in self._plan)
        return math.fsum([*lengths, *refused[np.isfinite(refused)]])

    def _listed(self) -> HalfRoutes | None:
        """Return all half-routes of this robot, None if there are too many."""
        member = self._member
        vehicle = self._member.local.vehicle
        if not (
            member.speaks
            and HalfRoutes.fits(vehicle)
            and len(vehicle.servable) <= MOST_TASKS
        ):
            return None
        halves = HalfRoutes(
            vehicle, BOUND_PASSES.label_factor * member.settings.columns.most_labels
        )
        return halves if halves.complete else None

    def _start(self) -> Vec:
        """Return the first prices: a share of the cost of each route, in equal parts on its tasks.

        The share is BOUND_PASSES.first_share. Too low prices do less harm than too high ones, at
        which very many routes have a negative reduced cost.

        A price is at most the cost of leaving the task out. All robots begin with the same prices,
        because they know the same penalty after they have introduced themselves.
        """
        pi = np.array(self._member.unserved)
        for _, column in self._plan:
            own = list(column.tasks)
            pi[own] = BOUND_PASSES.first_share * column.length / max(1, len(own))
        return np.minimum(pi, self._member.unserved)

    def _priced(self, pi: Vec) -> list[Any] | None:
        """Return least_i (-inf if unknown), whether it is exact, and columns.

        Returns None if another robot of the same group prices for this one.
        """
        member = self._member
        if not member.speaks:
            return None
        vehicle = member.local.vehicle
        batch = member.settings.columns.batch
        most = member.settings.columns.most_labels // 3
        if self.halves is not None:
            rows = self._rows
            columns = self.halves.cheapest(pi, batch, 0.0, rows)
            values = [
                c.length - math.fsum(pi[list(c.tasks)]) + rows.charge(self._i, c.tasks)
                for c in columns[:1]
            ]
            return [min([0.0, *values]), True, pack_columns(columns)]
        if len(vehicle.servable) > MOST_TASKS:
            return [-np.inf, False, pack_columns([])]
        found = find_least_reduced_cost(vehicle, pi, most=0)
        least = min(0.0, bound_reduced_cost(vehicle, pi, found.value, most=most))
        return [least, False, pack_columns(found.columns[:batch])]

    def _agree(
        self, master: Master, cuts: int
    ) -> Exchange[tuple[float, Vec, PricedRows, int]]:
        """Return the value of the known columns, their prices and rows, and how many rows are new.

        cuts: rows to add, at most, if the bound is near the value of the known columns.
        """
        own: list[Any] | None = None
        if self._i < self._member.settings.proof.searchers:
            relaxed = master.relax()
            added = 0
            open_gap = self._open_gap
            if cuts and relaxed.value - self.bound.value <= (
                BOUND_PASSES.cut_share * open_gap
            ):
                added = master.cut(cuts)
                relaxed = master.relax() if added else relaxed
            own = [
                relaxed.value,
                self._i,
                relaxed.prices,
                relaxed.rows.pack(),
                added,
            ]
        value, _, prices, rows, added = (
            yield from find_best_offer(own, self._member.place.diameter)
        ) or [np.inf, 0, self._start(), NO_ROWS.pack(), 0]
        return float(value), np.asarray(prices), PricedRows.unpack(rows), int(added)
