"""Clusters: disjoint groups of robots with routes near each other, the same at all robots.

And the passes in which a team searches them again.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import count

import numpy as np

from crazychoir.routing.distributed.member import AnytimeSettings, SearchSettings
from crazychoir.routing.distributed.team_order import TeamOrder
from crazychoir.routing.instance.instance import LocalProblem
from crazychoir.routing.instance.legs import measure_distances
from crazychoir.routing.search.search import SEARCH_DEFAULTS, SearchOptions
from crazychoir.types import Mat, Vec

Stops = Mapping[int, Sequence[int]]
"""Nodes of each robot's route, see vehicle.py. A robot that stays is absent or has no nodes."""


@dataclass(frozen=True)
class Cluster:
    """A group of robots that re-plan together."""

    robots: tuple[int, ...]
    """Ids, in the order of the team."""
    tasks: tuple[int, ...]
    """The tasks that they serve now, and unserved ones, in the order of the team."""
    leaders: tuple[int, ...]
    """The robots of the cluster that solve the joint problem."""


def list_served_tasks(stops: Sequence[int], m: int) -> list[int]:
    """Return the tasks that a route serves, increasing; m: number of all tasks."""
    return sorted({s % m for s in stops if s < 2 * m})


def list_unserved_tasks(routes: Stops, m: int) -> list[int]:
    """Return the tasks that no route serves, increasing."""
    served = {j for stops in routes.values() for j in list_served_tasks(stops, m)}
    return [j for j in range(m) if j not in served]


class Neighbors:
    """Distances between robots, from points that all know: homes or starts, pickups, deliveries."""

    def __init__(self, robots: Mapping[int, LocalProblem], order: TeamOrder) -> None:
        self._order = order
        self.robots = order.robots
        tasks = robots[self.robots[0]].tasks
        self.m = len(tasks)
        starts = np.array([_choose_start(robots[i]) for i in self.robots])
        self._between = tasks.between
        self._out = measure_distances(starts, tasks.stops)  # (N, 2M)
        can = np.array(
            [
                robots[i].capable & (tasks.load <= robots[i].capacity)
                for i in self.robots
            ]
        )
        alone = self._out[:, : self.m] + self._out[:, self.m :]
        self._alone = np.where(can, alone, np.inf)  # (N, M)
        self._last: tuple[object, list[Cluster]] | None = None

    def draw(
        self, routes: Stops, most: tuple[int, int], leaders: int, seed: Sequence[int]
    ) -> list[Cluster]:
        """Divide the robots into clusters.

        Robots in random order gather the robots nearest to them, by `nearness` with noise. The size
        limits are random too, so that clusters differ from pass to pass. An unserved task
        goes to the cluster of the robot that would serve it alone at the least cost.

        routes: the present routes.
        most: robots and tasks in a cluster, at most; the tasks of the two longest routes fit in any case.
        leaders: leaders of each cluster, at most.
        seed: the same seed gives the same clusters at all robots.
        The last clusters are kept: the robots of a process draw the same ones, one after the other.
        """
        plan = tuple((i, tuple(routes.get(i, ()))) for i in self.robots)
        key = (plan, most, leaders, tuple(seed))
        last = self._last
        if last is None or last[0] != key:
            last = (key, self._draw_anew(routes, most, leaders, seed))
            self._last = last
        return last[1]

    def _draw_anew(
        self, routes: Stops, most: tuple[int, int], leaders: int, seed: Sequence[int]
    ) -> list[Cluster]:
        random = np.random.default_rng(seed)
        share = random.uniform(0.5, 1.0)
        size = [len(list_served_tasks(routes.get(i, ()), self.m)) for i in self.robots]
        two_longest = sum(sorted(size)[-2:])
        room = (
            max(2, round(share * most[0])),
            max(two_longest, round(share * most[1])),
        )
        far = self.nearness(routes) * random.uniform(
            0.5, 1.5, size=(len(size), len(size))
        )
        groups = _gather_groups(
            far, size, room, [int(k) for k in random.permutation(len(size))]
        )
        nearest = {
            j: int(np.argmin(self._alone[:, j]))
            for j in list_unserved_tasks(routes, self.m)
        }
        return [
            self._cluster(
                group,
                routes,
                nearest,
                random.permutation(len(group))[:leaders].tolist(),
            )
            for group in groups
        ]

    def _cluster(
        self,
        group: list[int],
        routes: Stops,
        nearest: dict[int, int],
        leaders: list[int],
    ) -> Cluster:
        ids = [self.robots[k] for k in group]
        tasks = {
            j for i in ids for j in list_served_tasks(routes.get(i, ()), self.m)
        } | {j for j, k in nearest.items() if k in group}
        return Cluster(
            tuple(sorted(ids, key=self._order.robot_rank.__getitem__)),
            tuple(sorted(tasks, key=self._order.task_rank.__getitem__)),
            tuple(sorted(ids[k] for k in leaders)),
        )

    def nearness(self, routes: Stops) -> Mat:
        """Return (N, N) m, small if two routes run close together; rows in the order of the team.

            d_ab = mean over the nodes u of a of min over the nodes v of b of distance(u, v)
            nearness = min(d_ab, d_ba)

        The nodes of a robot are its stops and its start; starts are compared with stops only.
        """
        stops = [
            np.array([s for s in routes.get(i, ()) if s < 2 * self.m], np.int64)
            for i in self.robots
        ]
        to_route = np.array(
            [
                _find_least_distances(self._between[:, own], out)
                for own, out in zip(stops, self._out, strict=True)
            ]
        )
        starts = np.column_stack(
            [self._out[:, own].min(axis=1, initial=np.inf) for own in stops]
        )
        farthest = float(to_route.max())
        one_way = np.array(
            [
                _average_ways(start, to_route[:, own], farthest)
                for start, own in zip(starts, stops, strict=True)
            ]
        )
        return np.asarray(np.minimum(one_way, one_way.T))


def _average_ways(start: Vec, ways: Mat, farthest: float) -> Vec:
    """Return (N,) m: the mean distance from the nodes of a robot to each route.

    start: (N,) m, from its start to the stops of each route; inf if the route has none.
    ways: (N, S) m, from its S stops to the nodes of each route.
    farthest: m, its distance to a route without stops if it has none either.
    """
    if not ways.shape[1]:
        return np.where(np.isfinite(start), start, farthest)
    start = np.where(np.isfinite(start), start, ways.min(axis=1))
    # cumsum adds from left to right on every machine, sum does not; all robots must draw alike.
    return np.asarray(
        np.column_stack([start, ways]).cumsum(axis=1)[:, -1] / (ways.shape[1] + 1)
    )


def _gather_groups(
    far: Mat, size: list[int], room: tuple[int, int], order: list[int]
) -> list[list[int]]:
    """Return groups of rows; the first free row of `order` gathers the nearest that fit."""
    free = list(order)
    groups = []
    while free:
        first = free[0]
        group = [first]
        tasks = size[first]
        for k in sorted(free[1:], key=lambda k: (far[first, k], k)):
            if len(group) < room[0] and tasks + size[k] <= room[1]:
                group.append(k)
                tasks += size[k]
        free = [k for k in free if k not in group]
        groups.append(group)
    return groups


def _choose_start(local: LocalProblem) -> Vec:
    return local.home if local.start is None else local.start


def _find_least_distances(to_stops: Mat, to_start: Vec) -> Vec:
    return (
        np.asarray(np.minimum(to_stops.min(axis=1), to_start))
        if to_stops.shape[1]
        else to_start
    )


@dataclass(frozen=True)
class SearchPass:
    """One pass; all robots know it, so that all draw the same clusters."""

    number: int
    """Seed of the clusters and of their searches."""
    steps: int
    """Search steps of each leader."""
    cluster: tuple[int, int]
    """Largest number of robots and of tasks in a cluster."""
    leaders: int
    """Leaders of each cluster."""
    options: SearchOptions = SEARCH_DEFAULTS
    """Parameters of the searches."""


def list_usual_passes(
    settings: SearchSettings, robots: int, tasks: int, diameter: int
) -> Iterator[SearchPass]:
    """Yield the passes of a team without a budget.

    They share the search steps equally, except in a small team with long routes, see SearchSettings.
    """
    if robots <= settings.small_team and tasks > settings.cluster[1]:
        yield from _list_long_passes(settings, robots, tasks)
        return
    passes = settings.count_passes(robots, tasks, diameter)
    for number in range(passes):
        yield SearchPass(
            number,
            settings.steps // passes,
            settings.cluster,
            settings.leaders,
        )


def _list_long_passes(
    settings: SearchSettings, robots: int, tasks: int
) -> Iterator[SearchPass]:
    """Yield few passes in which all robots are one cluster."""
    # A cluster has at least half of these numbers, so that the whole team always fits.
    cluster = (2 * robots, 2 * tasks)
    for number, (share, temperature) in enumerate(settings.long_passes):
        steps = round(share * settings.steps)
        options = SearchOptions(first_temperature=temperature)
        yield SearchPass(number, steps, cluster, settings.leaders, options)


def list_anytime_passes(settings: AnytimeSettings) -> Iterator[SearchPass]:
    """Yield passes without end, which do not depend on the budget.

    The first ones are short, so that a better plan comes soon and often. A larger budget of search
    steps begins with all passes of a smaller one, and is therefore never worse.
    """
    short = SearchOptions(first_temperature=settings.first_temperature, rounds=1)
    long = SearchOptions(first_temperature=settings.temperature)
    for number in count():
        is_short = number < settings.first_passes
        yield SearchPass(
            number,
            settings.first_steps if is_short else settings.steps,
            settings.cluster,
            settings.leaders,
            short if is_short else long,
        )
