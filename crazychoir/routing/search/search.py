"""Ruin and recreate: a search for good plans of many vehicles and tasks that can be stopped at any time."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from crazychoir.routing.instance.vehicle import TOTAL, Vehicle
from crazychoir.routing.search.annealing import Best, anneal
from crazychoir.routing.search.fleet import fleet_of
from crazychoir.routing.search.recreate import Memory
from crazychoir.routing.search.route_pool import Pool
from crazychoir.routing.search.ruin import Step
from crazychoir.routing.search.set_partitioning import assemble
from crazychoir.routing.search.tours import Tours
from crazychoir.types import Bools, Vec, Words

HOT = 0.5
"""First temperature, as a share of the median distance of a task alone."""
FLEET_HOT = 0.02
"""The same while vehicles are left out."""
AVERAGE = 10.0
"""Stops that a step takes out, about."""
ROUNDS = 2
"""Times that the routes seen are put together anew."""


@dataclass(frozen=True)
class Found:
    """A plan. routes: the stops of each vehicle;  unserved: tasks that no route serves, increasing;

        total = sum of distances and fixed costs of the vehicles that leave + penalties of the unserved, m

    finish: s, when the last of them is done.
    """

    routes: list[list[int]]
    unserved: list[int]
    total: float
    finish: float
    pool: Pool = field(repr=False)


def search(
    vehicles: Sequence[Vehicle],
    routes: Sequence[Sequence[int]],
    penalty: Vec,
    steps: int,
    seed: int,
    *,
    objective: Sequence[str] = (TOTAL,),
    fleet_steps: int | None = None,
    hot: float = HOT,
    average: float = AVERAGE,
    rounds: int = ROUNDS,
) -> Found:
    """The best plan that `steps` of ruin and recreate find from `routes`, empty ones or infeasible ones too.

    routes: stops of each vehicle, as Vehicle says;  penalty: (M,) m, of a task that is not served, inf where it must
    be;  seed: the same one gives the same plan on every machine;  objective: TOTAL, MAKESPAN, or both in their order;
    fleet_steps: before, at most so many to leave vehicles out, which stay out then, whatever that costs; None: as many
    as `steps` where a vehicle costs more than all tasks one by one, 0 elsewhere;  hot: first temperature, as a share of
    the median distance of a task alone;  average: stops that a step takes out, about;
    rounds: the steps are parted into so many; if there is more than one, and no makespan first, each ends with set
    partitioning of the routes seen.
    Tasks that must be served can be in `unserved`: then the search has found no place for them.
    Source: Christiaens & Vanden Berghe 2020, Transportation Science 54(2), "Slack induction by string removals".
    """
    return Search(vehicles, penalty, objective).run(
        routes,
        steps,
        seed,
        fleet_steps=fleet_steps,
        hot=hot,
        average=average,
        rounds=rounds,
    )


class Search:
    """As `search`, for several runs on the same vehicles."""

    def __init__(
        self,
        vehicles: Sequence[Vehicle],
        penalty: Vec,
        objective: Sequence[str] = (TOTAL,),
    ) -> None:
        self._vehicles, self._fleet = vehicles, fleet_of(vehicles, penalty, objective)
        self._scale = (
            float(np.median(self._fleet.traits[:, 1])) if vehicles[0].tasks else 0.0
        )

    def run(
        self,
        routes: Sequence[Sequence[int]],
        steps: int,
        seed: int,
        *,
        fleet_steps: int | None = None,
        hot: float = HOT,
        average: float = AVERAGE,
        rounds: int = ROUNDS,
        closed: Sequence[int] = (),
    ) -> Found:
        """A plan; closed: vehicles that are not to leave."""
        fleet = self._fleet
        shut = np.zeros(len(self._fleet.start), np.bool_)
        shut[list(closed)] = True
        tours = Tours.of(fleet, routes)
        random = np.array([seed], np.uint64)
        pool = Pool.of(fleet, tours)
        if fleet_steps is None:
            fleet_steps = steps if fleet.fixed.min() > fleet.traits[:, 1].sum() else 0
        if fleet_steps:
            tours = self._anneal(
                tours, pool, random, shut, fleet_steps, FLEET_HOT, average, fewer=True
            )
            shut |= self._needless(tours)
        for _ in range(rounds):
            tours = self._anneal(
                tours, pool, random, shut, steps // rounds, hot, average
            )
            if rounds > 1 and not fleet.on_finish:
                tours = assemble(fleet, pool, tours, shut)
        return self._found(tours, pool)

    def _anneal(
        self,
        tours: Tours,
        pool: Pool,
        random: Words,
        shut: Bools,
        steps: int,
        hot: float,
        average: float,
        fewer: bool = False,
    ) -> Tours:
        step = Step.of(tours)
        memory = Memory.of(tours, shut)
        best = Best.of(tours)
        absence = np.zeros(len(tours.at))
        scaled = hot * self._scale
        fleet = self._fleet
        if fewer:  # a vehicle is not left out at the price of a task that is worth one
            dear = np.where(fleet.penalty > fleet.fixed.min(), np.inf, fleet.penalty)
            fleet = fleet._replace(penalty=dear)
        anneal(
            fleet,
            tours,
            step,
            memory,
            best,
            pool,
            random,
            absence,
            steps,
            scaled,
            average,
            fewer,
        )
        return best.tours(self._fleet)

    def _needless(self, tours: Tours) -> Bools:
        """(K,) whether a vehicle without stops stays at home for good.

        Where vehicles are counted first, one of another kind than all that leave may still take the place of one.
        """
        stays = np.asarray(tours.stops == 0)
        if not self._fleet.counted:
            return stays
        return np.asarray(stays & np.isin(self._fleet.twin, self._fleet.twin[~stays]))

    def _found(self, tours: Tours, pool: Pool) -> Found:
        penalty = self._fleet.penalty
        end = 2 * len(tours.at) + 1
        routes = [
            np.minimum(row[1 : n + 1], end).tolist()
            for row, n in zip(tours.stop, tours.stops, strict=True)
        ]
        flown = [
            (v, route) for v, route in zip(self._vehicles, routes, strict=True) if route
        ]
        unserved = np.flatnonzero(tours.at < 0).tolist()
        total = math.fsum(
            [
                *(v.length(route) + v.fixed for v, route in flown),
                *penalty[unserved].tolist(),
            ]
        )
        return Found(
            routes,
            unserved,
            total,
            max((v.finish(route) for v, route in flown), default=0.0),
            pool,
        )
