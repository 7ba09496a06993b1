"""Clusters: disjoint groups of robots whose routes are near each other, drawn by all robots alike."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from crazychoir.routing.labels import Ints
from crazychoir.routing.vehicle import Vehicle
from crazychoir.types import Mat

Stops = Mapping[int, Sequence[int]]
"""Nodes of each robot's route, see vehicle.py; of robots that stay, nothing or an empty list."""


@dataclass(frozen=True)
class Cluster:
    """Robots, increasing; the tasks that they serve now and open ones; who of them solves their joint problem."""

    robots: tuple[int, ...]
    tasks: tuple[int, ...]
    leader: int


def tasks_of(stops: Sequence[int], m: int) -> list[int]:
    """The tasks that a route serves, increasing; m: how many there are."""
    return sorted({s % m for s in stops if s < 2 * m})


def unserved(routes: Stops, m: int) -> list[int]:
    """The tasks that no route serves, increasing."""
    served = {j for stops in routes.values() for j in tasks_of(stops, m)}
    return [j for j in range(m) if j not in served]


def draw_clusters(vehicles: Mapping[int, Vehicle], routes: Stops, most: tuple[int, int], seed: Sequence[int]) -> list[Cluster]:
    """A partition of the robots into clusters of at most most[0] robots and about most[1] tasks.

    Robots in random order gather those nearest to them, by `nearness` with noise so that clusters differ from pass to
    pass. A task that nobody serves goes to the cluster of the robot that would serve it alone at the least cost.
    """
    random, m = np.random.default_rng(seed), next(iter(vehicles.values())).tasks
    ids = sorted(vehicles)
    far = nearness(vehicles, routes)
    far = far * random.uniform(0.5, 1.5, size=far.shape)
    size = [len(tasks_of(routes.get(i, ()), m)) for i in ids]
    free, groups = [int(k) for k in random.permutation(len(ids))], []
    while free:
        first = free.pop(0)
        group, tasks = [first], size[first]
        for k in sorted(free, key=lambda k: (far[first, k], k)):
            if len(group) < most[0] and tasks + size[k] <= most[1]:
                group.append(k)
                tasks += size[k]
        free = [k for k in free if k not in group]
        groups.append(group)
    open_tasks = _given(vehicles, unserved(routes, m))
    return [_cluster([ids[k] for k in group], routes, open_tasks, m, random) for group in groups]


def _cluster(
    group: list[int], routes: Stops, open_tasks: dict[int, int], m: int, random: np.random.Generator
) -> Cluster:
    tasks = {j for i in group for j in tasks_of(routes.get(i, ()), m)}
    tasks |= {j for j, i in open_tasks.items() if i in group}
    return Cluster(tuple(sorted(group)), tuple(sorted(tasks)), group[int(random.integers(len(group)))])


def _given(vehicles: Mapping[int, Vehicle], open_tasks: list[int]) -> dict[int, int]:
    """The robot that would serve each open task alone at the least cost."""
    robots = sorted(vehicles)
    cost = {i: np.where(_can(vehicles[i]), vehicles[i].shortest_trip, np.inf) for i in robots}
    return {j: min(robots, key=lambda i: (cost[i][j], i)) for j in open_tasks}


def _can(vehicle: Vehicle) -> npt.NDArray[np.bool_]:
    can = np.zeros(vehicle.tasks, dtype=bool)
    can[vehicle.servable] = True
    return can


def nearness(vehicles: Mapping[int, Vehicle], routes: Stops) -> Mat:
    """(N, N) m, small for robots whose routes lie along each other, rows by increasing id.

        d_ab = mean over the nodes u of a of min over the nodes v of b of distance(u, v);   the least of d_ab, d_ba

    The nodes of a robot are its start and its stops.
    """
    robots = sorted(vehicles)
    m = vehicles[robots[0]].tasks
    between = vehicles[robots[0]].distance[: 2 * m, : 2 * m]
    nodes = [np.array([s for s in routes.get(i, ()) if s < 2 * m], dtype=np.int64) for i in robots]
    out = np.array([vehicles[i].distance[2 * m, : 2 * m] for i in robots])  # (N, 2M) from starts to stops
    near = np.array([_least(between[:, own], out[k]) for k, own in enumerate(nodes)])  # (N, 2M) from stops to routes
    one_way = np.array([_mean_way(near, out, nodes, k) for k in range(len(robots))])
    return np.minimum(one_way, one_way.T)


def _least(to_stops: Mat, to_start: Mat) -> Mat:
    return np.minimum(to_stops.min(axis=1), to_start) if to_stops.shape[1] else to_start


def _mean_way(near: Mat, out: Mat, nodes: list[Ints], a: int) -> Mat:
    """(N,) mean over the nodes of robot a of the way to each route."""
    start = np.array([out[a, own].min() if len(own) else np.inf for own in nodes])
    if not len(nodes[a]):
        return np.where(np.isfinite(start), start, near.max())
    stops = near[:, nodes[a]]
    start = np.where(np.isfinite(start), start, stops.min(axis=1))
    return (stops.sum(axis=1) + start) / (len(nodes[a]) + 1)
