"""Plans of cheapest insertions, by bids in an auction or in CBBA: fast baselines, not optimal."""

from collections.abc import Generator
from typing import Any

import numpy as np

from crazychoir.errors import SolverError
from crazychoir.optimization.assignment.bundles import (
    CBBA,
    Bundle,
    run_sequential_auction,
)
from crazychoir.optimization.rounds.program import Exchange
from crazychoir.routing.distributed.member import RoutingMember
from crazychoir.routing.distributed.proof import TaskPartition
from crazychoir.routing.instance.instance import LocalProblem
from crazychoir.routing.search.fleet import build_fleet
from crazychoir.routing.search.insertion import find_cheapest_insertion
from crazychoir.routing.search.tours import Tours, insert_task, refresh_route
from crazychoir.types import Vec

BIDDING_METHODS = ("cbba", "auction")
"""Names of the methods of this module."""
INSERTION_BIDS_DISCLOSURES = (
    "what tasks would cost robots",
    "which robot serves which task",
)
"""Data that the robots disclose to each other."""
NO_EXCLUDED_PLACE = -9
"""Place that excludes no pair of positions."""
REQUIRED_TASK_WORTH = 1e7
"""m: worth of a task that must be served.

It exceeds any detour and is the same at all robots.
"""
Stops = tuple[int, ...]
"""Nodes of a route."""


class InsertionBids:
    """Bids of a robot: the worth of a task minus the least growth of the route.

        c_j(route) = worth_j - min over both places in the route of (its length with j - its length)

    worth_j is the cost of refusing j, the same at all robots; for a task that must be served, more
    than any detour. A robot does not bid below 0 for a task that may be refused. All limits of the
    robot are kept.

    local: the problem of the robot.
    `start`: stops of the route that delivers the goods aboard.
    """

    def __init__(self, local: LocalProblem) -> None:
        refusal = local.tasks.refusal
        self._must = np.isinf(refusal)
        self._worth = np.where(self._must, REQUIRED_TASK_WORTH, refusal)
        self._fleet = build_fleet([local.vehicle], refusal)
        self._end = 2 * len(refusal) + 1
        self._extra = np.zeros((2, 3 * len(refusal) + 4))
        self.start: Stops = ()
        for j in np.flatnonzero(local.vehicle.aboard):
            self.start = self.insert(self.start, int(j))

    def scores(self, path: Stops) -> Vec:
        """Return the bids (M,) at the route `path`; -inf for tasks in it or without a bid."""
        tours = self._tours(path)
        growth = np.array(
            [self._cheapest(tours, j)[0] for j in range(len(self._worth))]
        )
        growth[tours.at >= 0] = np.inf
        scores = self._worth - growth
        return np.where(self._must | (scores > 0.0), scores, -np.inf)

    def insert(self, path: Stops, task: int) -> Stops:
        """Return the stops with the task inserted where the route grows least.

        Raises SolverError if it fits nowhere.
        """
        tours = self._tours(path)
        cost, first, second = self._cheapest(tours, task)
        if cost == np.inf:
            raise SolverError(f"a route with task {task}", "infeasible")
        insert_task(self._fleet, tours, 0, task, first, second)
        return tuple(
            np.minimum(tours.stop[0, 1 : tours.stops[0] + 1], self._end).tolist()
        )

    def _cheapest(self, tours: Tours, j: int) -> Any:
        return find_cheapest_insertion(
            self._fleet, tours, self._extra, j, 0, NO_EXCLUDED_PLACE, NO_EXCLUDED_PLACE
        )

    def _tours(self, path: Stops) -> Tours:
        tours = Tours.of(self._fleet, [path])
        refresh_route(self._fleet, tours, 0)
        return tours


def plan_by_insertion(member: RoutingMember, method: str) -> Exchange[TaskPartition]:
    """Return this robot's route by a method of BIDDING_METHODS, without a bound on the optimum.

    Raises SolverError at all robots if no robot takes a task that must be served.
    """
    place = member.place
    tasks = len(member.local.tasks)
    bidder = InsertionBids(member.local)
    member.report(phase="bids")
    member.kind = "bids"
    if method == "auction":
        bundle = yield from run_sequential_auction(
            place.robot, bidder, tasks, place.diameter
        )
    else:
        bundle = yield from _run_inside(
            CBBA(place.robot, bidder, range(place.robots), tasks, place.diameter)
        )
    missing = [j for j in bundle.open_tasks if np.isinf(member.local.tasks.refusal[j])]
    if missing:
        names = ", ".join(map(str, missing))
        raise SolverError(
            f"robot {place.robot}: {method}",
            f"incomplete: no route has room for task(s) {names}; use the method columns",
        )
    mine = tuple(sorted(bundle.tasks))
    return TaskPartition({place.robot: mine}, None, {place.robot: bundle.path})


def _run_inside(program: CBBA) -> Generator[Any, Any, Bundle]:
    """Run a program inside another one and return its result."""
    while not program.done:
        program.step((yield program.message()))
    return program.result
