"""The joint problem of a cluster, solved by its leader."""

from collections.abc import Mapping, Sequence

import numpy as np

from crazychoir.routing.clusters import Cluster, Stops
from crazychoir.routing.labels import Ints
from crazychoir.routing.search import Found, search
from crazychoir.routing.vehicle import Vehicle
from crazychoir.types import Vec


def reoptimize(
    vehicles: Mapping[int, Vehicle], routes: Stops, cluster: Cluster, penalty: Vec, iterations: int, seed: int
) -> tuple[dict[int, list[int]], Found]:
    """The routes of the cluster's robots that the search finds from the present ones, and what it has seen.

    penalty: (M,) cost of leaving a task out.
    """
    m, chosen = len(penalty), np.array(cluster.tasks, dtype=np.int64)
    own = [vehicles[i].only(chosen) for i in cluster.robots]
    present = [_renamed(routes.get(i, ()), _inner(chosen, m)) for i in cluster.robots]
    found = search(own, present, penalty[chosen], iterations, seed)
    outer = _outer(chosen, m)
    return {i: _renamed(stops, outer) for i, stops in zip(cluster.robots, found.routes, strict=True)}, found


def _inner(chosen: Ints, m: int) -> dict[int, int]:
    """Nodes of the whole problem -> nodes of the part."""
    return {v: k for k, v in _outer(chosen, m).items()}


def _outer(chosen: Ints, m: int) -> dict[int, int]:
    """Nodes of the part -> nodes of the whole problem."""
    nodes = [*chosen.tolist(), *(m + chosen).tolist(), 2 * m, 2 * m + 1]
    return dict(enumerate(nodes))


def _renamed(stops: Sequence[int], name: Mapping[int, int]) -> list[int]:
    return [name[s] for s in stops]
