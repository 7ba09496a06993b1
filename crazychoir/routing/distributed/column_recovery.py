"""Recovery from shared columns: robots share promising routes and agree on one proven plan."""

import numpy as np

from crazychoir.optimization.rounds.agreement import flood_values
from crazychoir.optimization.rounds.program import Exchange
from crazychoir.routing.distributed.bound import Bound, improve_bound
from crazychoir.routing.distributed.master import ColumnPool
from crazychoir.routing.distributed.member import RoutingMember
from crazychoir.routing.distributed.primal_decomposition import PriceRounds
from crazychoir.routing.distributed.proof import PlanProof, TaskPartition
from crazychoir.routing.pricing.packing import pack_columns, unpack_columns
from crazychoir.types import Vec

COLUMN_RECOVERY_DISCLOSURES: tuple[str, ...] = (
    "task prices",
    "largest change of a share",
    "whether its routes could be listed",
    "route columns (task sets and lengths)",
    "least reduced costs",
    "plan",
)
"""Data that the robots disclose to each other."""


class ColumnRecovery:
    """Generate columns with floods, then solve the set partitioning with a proof.

    1. Flood the active columns and mean prices of all robots; pi = the mean over the robots.
    2. Each robot prices exactly at pi; flood least_i and its best columns: bound.py.
    3. Each robot solves the relaxed restricted master; flood its duals; pi = their mean. Repeat
    from 2
       until the relaxation is within `tolerance` of the bound.
    4. Set partitioning: proof.py.

    Every decision that ends a loop is taken from flooded values, with sums that every machine
    rounds alike, so that all robots end in the same round.
    """

    def __init__(self, member: RoutingMember, prices: PriceRounds) -> None:
        self._member = member
        self._prices = prices
        self._i = member.place.robot
        self._diameter = member.place.diameter
        self._pool = ColumnPool(len(member.local.tasks))
        self._bound = Bound(prices=prices.mean_price)

    def run(self) -> Exchange[TaskPartition]:
        """Run steps 1 to 4."""
        pi = yield from self._start()
        yield from self._generate(pi)
        return (yield from PlanProof(self._member, self._pool, self._bound).run())

    def _start(self) -> Exchange[Vec]:
        self._member.report(phase="columns")
        own = pack_columns([c for _, c in sorted(self._prices.active.items())])
        known = yield from flood_values(
            self._i, [own, self._prices.mean_price.tolist()], self._diameter
        )
        for robot, (columns, _) in known.items():
            self._pool.add(robot, unpack_columns(columns))
        return _average_rows([mu for _, mu in known.values()])

    def _generate(self, pi: Vec) -> Exchange[None]:
        member = self._member
        bound = self._bound
        for _ in range(member.settings.columns.passes):
            new = yield from improve_bound(
                bound, member, self._pool, pi, member.settings.columns.batch
            )
            relaxed = self._pool.relax(member.unserved)
            known = yield from flood_values(
                self._i, [relaxed.value, relaxed.prices.tolist()], self._diameter
            )
            value = min(v for v, _ in known.values())
            met = value - bound.value <= member.tolerance(value)
            if not new or met or member.budget.is_over:
                return
            pi = _average_rows([prices for _, prices in known.values()])


def _average_rows(rows: list[list[float]]) -> Vec:
    return np.asarray(np.mean(np.array(rows), axis=0))
