"""Recovery from the shares alone: robots choose tasks; claims settle which robot keeps each."""

import math

import numpy as np
import numpy.typing as npt

from crazychoir.errors import SolverError
from crazychoir.optimization.rounds.agreement import find_highest_bids, flood_values
from crazychoir.optimization.rounds.program import Exchange
from crazychoir.routing.distributed.member import RoutingMember
from crazychoir.routing.distributed.primal_decomposition import PriceRounds
from crazychoir.routing.distributed.proof import TaskPartition
from crazychoir.types import Ints, Vec

CLAIMED_SHARE = 1e-6
"""A robot asks for a task if its share of the task exceeds this."""


class ResourceRecovery:
    """Each robot solves only its own block, as in the paper; claims then settle shared tasks.

        S_i = argmin c_i'z - W sum_{j in S} (1 + y_ij)   over the routes of i,
        where i asks for every j with y_ij > 0

    Several robots can have a positive share of a task. The sets S_i therefore overlap, and serving
    each task exactly once needs one comparison a task:
    - Method `resource`: the robot with the lowest id that claims j takes it. Only ids are sent.
    - Method `resource-argmax`: the robot with the largest share y_ij takes it (ties: lowest id).
      This also discloses the winner's share; its plans are better.

    A robot claims only sets that it can serve together with the tasks it keeps. Any part of them
    that it wins is therefore feasible too. This is not so if a detour may be shorter than the
    direct
    way: then each robot sends which of the won tasks it keeps.

    Passes continue, with claims on every open task, until all tasks are kept. If a pass keeps
    nothing new, the open tasks become urgent: robots claim them before others. The claims then
    start again from robot id `attempt`, up to `attempts` times.
    Raises SolverError, at all robots alike, if tasks are open even then.
    """

    def __init__(
        self, member: RoutingMember, prices: PriceRounds, by_share: bool
    ) -> None:
        self._member = member
        self._prices = prices
        self._by_share = by_share
        self._i = member.place.robot
        self._urgency = np.zeros(len(member.local.tasks))

    @property
    def disclosed(self) -> tuple[str, ...]:
        """Data that the robots disclosed to each other."""
        claims = (
            "task prices",
            "largest change of a share",
            "claims (task, robot)",
            "least reduced costs",
            "whether its routes could be listed",
        )
        return (*claims, "largest share of each task") if self._by_share else claims

    def run(self) -> Exchange[TaskPartition]:
        """Claim until every task is kept, then compute the bound at the mean of all prices."""
        self._member.report(phase="claims")
        for attempt in range(self._member.settings.prices.attempts):
            owner = yield from self._claim(attempt)
            open_tasks = np.flatnonzero(owner < 0)
            if not len(open_tasks):
                bound = yield from self._bound()
                mine = tuple(int(j) for j in np.flatnonzero(owner == self._i))
                return TaskPartition({self._i: mine}, bound)
            self._urgency[open_tasks] += 1.0
        raise SolverError(
            f"robot {self._i}: claims on the tasks",
            f"incomplete after {self._member.settings.prices.attempts} attempts: no route has room for task(s) "
            f"{', '.join(map(str, open_tasks))}; use the method columns",
        )

    def _claim(self, attempt: int) -> Exchange[Ints]:
        """Return the robot of each task, -1 for none."""
        owner = np.full(len(self._urgency), -1)
        wanted = self._prices.y > CLAIMED_SHARE
        last = False
        while (owner < 0).any():
            bids = {
                j: [self._amount(j, attempt), self._i]
                for j in self._choice(owner, wanted)
            }
            won = yield from find_highest_bids(bids, self._member.place.diameter)
            kept = yield from self._kept(
                owner, {j: robot for j, (_, robot) in won.items()}
            )
            for j, robot in kept.items():
                owner[j] = robot
            if not kept and last:
                break
            # The same at all robots, regardless of their own shares.
            wanted = np.ones_like(wanted)
            last = True
        return owner

    def _kept(self, owner: Ints, won: dict[int, int]) -> Exchange[dict[int, int]]:
        """Return the robot that keeps each task won.

        If what a robot has won is infeasible without the tasks it lost, it keeps the best part.
        """
        if self._member.local.vehicle.metric:
            return won
        mine = np.array([won.get(j) == self._i for j in range(len(owner))])
        told = yield from flood_values(
            self._i, self._choice(owner, mine), self._member.place.diameter
        )
        return {j: robot for robot, tasks in told.items() for j in tasks}

    def _choice(self, owner: Ints, wanted: npt.NDArray[np.bool_]) -> list[int]:
        """Return the wanted open tasks that this robot serves best with the tasks it keeps."""
        mine = owner == self._i
        free = owner < 0
        large = (
            1.0 + float(self._member.penalty.sum()) + self._member.table.length.max()
        )  # positive even if all points coincide
        share = np.clip(self._prices.y, 0.0, 1.0)
        urgency = (len(owner) + 1.0) ** np.minimum(self._urgency, 3.0)
        worth = np.where(free & wanted, large * (1.0 + share) * urgency, -np.inf)
        worth[mine] = 4.0 * float(worth[np.isfinite(worth)].sum()) + 4.0 * large
        best = self._member.table.cheapest(worth, 1, below=np.inf)
        return [j for j in best[0].tasks if free[j]]

    def _amount(self, j: int, attempt: int) -> float:
        if self._by_share:
            return float(self._prices.y[j])
        return -float((self._i - attempt) % self._member.place.robots)

    def _bound(self) -> Exchange[float | None]:
        """Return the lower bound in m, None if a table is incomplete.

        sum_j pi_j + sum_i min(0, least reduced cost of i at pi),   pi the mean of the robots'
        mean prices
        """
        place = self._member.place
        table = self._member.table
        known = yield from flood_values(
            self._i, self._prices.mean_price.tolist(), place.diameter
        )
        pi: Vec = np.mean(np.array(list(known.values())), axis=0)
        least = yield from flood_values(
            self._i, [min(0.0, table.least(pi)), table.complete], place.diameter
        )
        if not all(complete for _, complete in least.values()):
            return None
        return math.fsum([*pi, *(value for value, _ in least.values())])
