"""Distributed column generation: robots exchange bases and price at their own duals."""

from typing import Any

from crazychoir.optimization.rounds.agreement import find_best_offer
from crazychoir.optimization.rounds.program import Exchange
from crazychoir.routing.distributed.bound import (
    Bound,
    count_needed_robots,
    improve_bound,
)
from crazychoir.routing.distributed.master import ColumnPool, Master, Relaxation
from crazychoir.routing.distributed.member import RoutingMember
from crazychoir.routing.pricing.packing import pack_columns, unpack_columns
from crazychoir.types import Vec

REDUCED_COST_ROUNDING = 1e-7
"""m: a reduced cost above minus this value is rounding."""
RIGHT_HAND_SIDE_SPREAD = 1e-3
"""Spread of the master's right-hand sides.

With degenerate bases each robot could stop at different prices.
"""


class Gossip:
    """Robot i solves the master problem over the columns it knows and sends the basis.

        pool_i <- pool_i + bases of the neighbours
                  + own columns of least reduced cost at (pi_i, sigma_ii)
        (pi_i, sigma_i), basis_i <- the relaxation over pool_i
        send the neighbours the columns of basis_i that were not sent before

    Pools only grow, so the gossip ends. It ends when no robot has learned a column for
    diameter + 1 rounds, or after `gossip_rounds`. All robots know this in the same round from
    `latest`, the last round in which any robot learned a column.

    Then all robots use the prices of the robot with the least value: they price exactly, flood, and
    compute the bound. If the bound is below the value, some column was unknown to that robot. The
    gossip then repeats with the new columns.

    If robots have a fixed cost, fractions of robots leave a gap of fractions of it. Everything then
    repeats with the additional row that at least n robots leave, see `count_needed_robots`. Every plan
    satisfies that row.

    `run` returns the value of the relaxation in m.
    `bound`: the proven bound.
    `master`: the master problem with all columns that robot i knows.
    `pool`: the columns that all robots know.
    Source: the idea of distributed simplex (Burger, Notarstefano, Bullo, Allgower 2012,
    Automatica 48(9)), with columns priced instead of listed.
    """

    def __init__(self, member: RoutingMember) -> None:
        self._member = member
        self._i = member.place.robot
        self.master = Master(
            member.unserved,
            RIGHT_HAND_SIDE_SPREAD,
            {i: len(same) for i, same in member.alike.items()},
        )
        self.pool = ColumnPool(len(member.local.tasks))
        self.bound = Bound()
        self._told: set[Any] = set()
        self._latest = 0

    def run(self) -> Exchange[float]:
        """Return the value; if robots have a fixed cost, with their number rounded up."""
        self._member.report(phase="columns")
        value, used = yield from self._converge()
        if self._member.fixed > 0.0:
            robots = yield from count_needed_robots(self.bound, self._member)
            if robots > used:
                self.bound.robots = robots
                self.master.at_least(robots, self._member.fixed)
                value, _ = yield from self._converge()
        return value

    def _converge(self) -> Exchange[tuple[float, float]]:
        """Gossip and agree until the bound equals the value or `passes` are over.

        Returns the value in m and the number of robots that the relaxation uses.
        """
        settings = self._member.settings
        best = self._priced()
        for _ in range(settings.columns.passes):
            best = yield from self._spread(best)
            value, pi, used, reward = yield from self._agree(best)
            news = yield from improve_bound(
                self.bound, self._member, self.pool, pi, settings.columns.batch, reward
            )
            if (
                not news
                or value - self.bound.value <= self._member.tolerance(value)
                or self._member.budget.is_over
            ):
                break
            for robot, column in self.pool.items():
                self.master.add(robot, [column])
            best = self._priced()
        return value, used

    def _spread(self, best: Relaxation) -> Exchange[Relaxation]:
        """Run rounds until no robot learns a column."""
        self._latest = 0
        for k in range(1, self._member.settings.columns.gossip_rounds + 1):
            self._member.kind = "bases"
            heard = yield [self._latest, self._news()]
            learned = self._learn([news for _, news in heard.values()])
            self._latest = max(
                [self._latest, *(int(latest) for latest, _ in heard.values())]
            )
            if learned:
                size = len(self.master)
                best = self._priced()
                self._latest = k if len(self.master) > size or learned else self._latest
            if (
                k - self._latest > self._member.place.diameter
                or self._member.budget.is_over
            ):
                break
        return best

    def _news(self) -> list[Any]:
        """Return the columns of the basis that were not sent yet."""
        news = [(i, c) for i, c in self.master.basis if (i, c) not in self._told]
        self._told.update(news)
        return [[i for i, _ in news], pack_columns([c for _, c in news])]

    def _learn(self, arrived: list[list[Any]]) -> int:
        new = 0
        for robots, columns in arrived:
            for robot, column in zip(robots, unpack_columns(columns), strict=True):
                new += self.master.add(robot, [column])
        return new

    def _priced(self) -> Relaxation:
        """Price until no own column has a negative reduced cost, and return the relaxation."""
        member = self._member
        batch = self._member.settings.columns.batch
        while True:
            best = self.master.relax()
            below = self.master.sigma(self._i) - REDUCED_COST_ROUNDING
            own = (
                member.table.cheapest(best.prices, batch, below, best.reward)
                if member.speaks
                else []
            )
            if not self.master.add(self._i, own) or member.budget.is_spent:
                member.report(relaxed=float(best.value))
                return best

    def _agree(self, best: Relaxation) -> Exchange[tuple[float, Vec, float, float]]:
        """Agree on the robot with the least value.

        Returns its value, its prices, its number of robots and its reward.
        """
        self._member.kind = "prices"
        own: list[Any] = [best.value, self._i, best.prices, best.used, best.reward]
        offer = yield from find_best_offer(own, self._member.place.diameter)
        value, _, prices, used, reward = offer or own  # every robot makes an offer
        return float(value), prices, float(used), float(reward)
