"""Ruin and recreate: a search for good plans of many vehicles and tasks, stoppable at any time."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from crazychoir.routing.instance.vehicle import OBJECTIVE_NAMES, Vehicle
from crazychoir.routing.search.annealing import BestTours, anneal_tours
from crazychoir.routing.search.fleet import build_fleet
from crazychoir.routing.search.recreate import InsertionMemory
from crazychoir.routing.search.route_pool import RoutePool
from crazychoir.routing.search.ruin import SearchStep
from crazychoir.routing.search.set_partitioning import assemble_plan
from crazychoir.routing.search.tours import Tours
from crazychoir.types import Bools, Vec, Words


@dataclass(frozen=True, slots=True)
class SearchOptions:
    """Parameters of ruin and recreate."""

    fleet_steps: int | None = None
    """Earlier steps, at most, that leave vehicles out at any cost; these vehicles then stay at
    home. None: `steps` if a vehicle costs more than all tasks one by one, else 0.
    """
    first_temperature: float = 0.5
    """First temperature, as a share of the median distance of a route with one task."""
    fleet_temperature: float = 0.02
    """First temperature while the search leaves vehicles out, as the same share."""
    removed_stops: float = 10.0
    """Stops that a step removes on average."""
    rounds: int = 2
    """Number of parts of the steps; each begins at the first temperature."""
    combines: bool = True
    """Whether each part ends with set partitioning of the known routes, unless the makespan is the
    first objective.
    """


SEARCH_DEFAULTS = SearchOptions()


@dataclass(frozen=True)
class FoundPlan:
    """A plan.

    total = sum of distances and fixed costs of the vehicles that leave
            + penalties of the unserved
    """

    routes: list[list[int]]
    """Stops of each vehicle."""
    unserved: list[int]
    """Tasks that no route serves, increasing."""
    total: float
    """m: see above."""
    finish: float
    """s: when the last vehicle is done."""
    pool: RoutePool = field(repr=False)
    """The routes that the search has seen."""


def search_plan(
    vehicles: Sequence[Vehicle],
    routes: Sequence[Sequence[int]],
    penalty: Vec,
    steps: int,
    seed: int,
    *,
    objective: Sequence[str] = (OBJECTIVE_NAMES.total,),
    options: SearchOptions = SEARCH_DEFAULTS,
) -> FoundPlan:
    """Return the best plan that ruin and recreate finds from `routes`.

    The given routes may be empty or infeasible. Tasks that must be served can be in `unserved`:
    then the search has found no place for them.

    vehicles: the robots.
    routes: stops of each vehicle, as described in Vehicle.
    penalty: (M,) m, of a task that is not served, inf if it must be.
    steps: number of steps.
    seed: the same seed gives the same plan on every machine.
    objective: what is minimised, in order.
    options: parameters of the search.
    Source: Christiaens & Vanden Berghe 2020, Transportation Science 54(2), "Slack induction by
    string removals".
    """
    return PlanSearch(vehicles, penalty, objective).run(
        routes, steps, seed, options=options
    )


class PlanSearch:
    """The search of `search_plan`, for several runs on the same vehicles."""

    def __init__(
        self,
        vehicles: Sequence[Vehicle],
        penalty: Vec,
        objective: Sequence[str] = (OBJECTIVE_NAMES.total,),
    ) -> None:
        self._vehicles = vehicles
        self._fleet = build_fleet(vehicles, penalty, objective)
        self._scale = (
            float(np.median(self._fleet.traits[:, 1])) if vehicles[0].tasks else 0.0
        )

    def run(
        self,
        routes: Sequence[Sequence[int]],
        steps: int,
        seed: int,
        *,
        options: SearchOptions = SEARCH_DEFAULTS,
        closed: Sequence[int] = (),
    ) -> FoundPlan:
        """Run the search, see `search_plan`; closed: vehicles that must not leave."""
        fleet = self._fleet
        shut = np.zeros(len(self._fleet.start), np.bool_)
        shut[list(closed)] = True
        tours = Tours.of(fleet, routes)
        random = np.array([seed], np.uint64)
        pool = RoutePool.of(fleet, tours)
        fleet_steps = options.fleet_steps
        if fleet_steps is None:
            fleet_steps = steps if fleet.fixed.min() > fleet.traits[:, 1].sum() else 0
        if fleet_steps:
            tours = self._anneal(
                tours,
                pool,
                random,
                shut,
                fleet_steps,
                options,
                is_fewer=True,
            )
            shut |= self._needless(tours)
        for _ in range(options.rounds):
            tours = self._anneal(
                tours, pool, random, shut, steps // options.rounds, options
            )
            if options.combines and not fleet.on_finish:
                tours = assemble_plan(fleet, pool, tours, shut)
        return self._found(tours, pool)

    def _anneal(
        self,
        tours: Tours,
        pool: RoutePool,
        random: Words,
        shut: Bools,
        steps: int,
        options: SearchOptions,
        *,
        is_fewer: bool = False,
    ) -> Tours:
        """Return the best tours of some steps, from these on.

        is_fewer: True to leave vehicles out
        """
        step = SearchStep.of(tours)
        memory = InsertionMemory.of(tours, shut)
        best = BestTours.of(tours)
        absence = np.zeros(len(tours.at))
        temperature = options.first_temperature * self._scale
        fleet = self._fleet
        if is_fewer:
            temperature = options.fleet_temperature * self._scale
            # Do not leave a vehicle out by refusing a task that is worth a vehicle.
            dear = np.where(fleet.penalty > fleet.fixed.min(), np.inf, fleet.penalty)
            fleet = fleet._replace(penalty=dear)
        anneal_tours(
            fleet,
            tours,
            step,
            memory,
            best,
            pool,
            random,
            absence,
            steps,
            temperature,
            options.removed_stops,
            is_fewer,
        )
        return best.tours(self._fleet)

    def _needless(self, tours: Tours) -> Bools:
        """Return (K,): whether a vehicle without stops stays at home for good.

        If vehicles are counted first, a vehicle of a kind that is not in use may still replace
        another.
        """
        stays = np.asarray(tours.stops == 0)
        if not self._fleet.counted:
            return stays
        return np.asarray(stays & np.isin(self._fleet.twin, self._fleet.twin[~stays]))

    def _found(self, tours: Tours, pool: RoutePool) -> FoundPlan:
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
        return FoundPlan(
            routes,
            unserved,
            total,
            max((v.finish(route) for v, route in flown), default=0.0),
            pool,
        )
