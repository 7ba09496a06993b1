"""Primal decomposition of pickup and delivery: robots trade shares of the tasks by prices."""

from typing import Any

import numpy as np

from crazychoir.optimization.rounds.program import Exchange
from crazychoir.routing.distributed.columns import ColumnProgram
from crazychoir.routing.distributed.member import RoutingMember
from crazychoir.routing.pricing.route_table import RouteColumn
from crazychoir.types import Vec


class PriceRounds:
    """Robot i holds a share y_ij of every task j and moves it to robots that serve it more cheaply.

        sum_i y_i = 1                                             (kept by every round)
        p_i(y_i) = min c_i'z + sum_j M_j v_j
                   s.t.  visits(z) + v >= y_i : mu_i,   z in conv(Z_i), v >= 0
        y_i <- y_i - a_k sum_{j in N_i} w_ij (mu_i - mu_j)
        a_k = step / (scale (k + 1)^exponent)

    w: Metropolis weights.
    mu_i: (M,) m, a subgradient of p_i.

    A message contains only mu_i and one number for the end. After every `diameter` rounds all
    robots know the largest change of a share at the start of that window (max-consensus). They
    stop together if it is at most `still`.

    `y`: (M,) shares.
    `mean_price`: (M,) m, mean of mu_i over the rounds.
    `active`: columns used in any round, by their tasks.
    Source: Camisa, Testa, Notarstefano, T-RO 2022, DOI 10.1109/TRO.2022.3216801, here with one v
    a task.
    """

    def __init__(self, member: RoutingMember) -> None:
        self._member = member
        tasks = len(member.local.tasks)
        self.y: Vec = np.full(tasks, 1.0 / member.place.robots)
        self.mean_price: Vec = np.zeros(tasks)
        self.active: dict[tuple[int, ...], RouteColumn] = {}
        self.rounds = 0

    def run(self) -> Exchange[None]:
        """Run the rounds until all robots stop."""
        member = self._member
        program = ColumnProgram(member.table, member.unserved, member.local.robot)
        window = max(1, member.place.diameter)
        worst = 0.0
        change = 1.0
        for k in range(member.settings.prices.rounds):
            mu = self._price(program, k)
            if k % window == 0:
                worst = change
            heard = yield [mu, worst]
            change = self._trade(k, mu, {j: message[0] for j, message in heard.items()})
            worst = max([worst, *(float(message[1]) for message in heard.values())])
            still = (k + 1) % window == 0 and worst <= member.settings.prices.still
            if still or member.budget.is_over:
                return

    def _price(self, program: ColumnProgram, k: int) -> Vec:
        local = program.solve(self.y)
        for column in local.active:
            self.active[column.tasks] = column
        self.mean_price += (local.mu - self.mean_price) / (k + 1)
        self.rounds = k + 1
        self._member.report(phase="prices", violation=float(local.violation.max()))
        return local.mu

    def _trade(self, k: int, mu: Vec, heard: dict[int, Any]) -> float:
        """Move the shares; return the largest change."""
        member = self._member
        flow = np.zeros_like(mu)
        for j, other in sorted(heard.items()):
            flow += member.place.weight(j) * (mu - np.asarray(other))
        size = member.settings.prices.step / (
            member.scale * (k + 1) ** member.settings.prices.exponent
        )
        self.y = self.y - size * flow
        return float(np.abs(size * flow).max())
