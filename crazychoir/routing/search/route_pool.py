"""The routes that a search has seen."""

from typing import Any, NamedTuple

import numpy as np

from crazychoir.numerics.kernels import kernel
from crazychoir.routing.search.tours import Fleet, Tours
from crazychoir.types import Ints, Vec, Words

POOL_SIZE = 4096
"""Largest number of stored routes; a power of two."""
PROBED_PLACES = 4
"""Number of places where a route may be stored."""


class RoutePool(NamedTuple):
    """Known routes, in P places; P is a power of two."""

    key: Words
    """(P,): hash of the kind of vehicle and the set of tasks."""
    vehicle: Ints
    """(P,): vehicle, -1 if the place is empty."""
    cost: Vec
    """(P,) m."""
    stops: Ints
    """(P,): number of stops."""
    stop: Ints
    """(P, L): the stops."""
    age: Ints
    """(P,): step in which the route was last seen."""
    sign: Words
    """(M + K,): random words from which keys are made."""

    @classmethod
    def of(cls, fleet: Fleet, tours: Tours) -> "RoutePool":
        """Return an empty pool."""
        zero = np.zeros(POOL_SIZE, np.int64)
        words = np.zeros(POOL_SIZE, np.uint64)
        # Any fixed words will do if the exclusive or of different subsets differs.
        draw = np.random.default_rng(0)
        sign = draw.integers(1, 2**64, len(fleet.load) + len(fleet.start), np.uint64)
        stop = np.zeros((POOL_SIZE, tours.stop.shape[1]), np.int64)
        return cls(words, zero - 1, np.zeros(POOL_SIZE), zero, stop, zero.copy(), sign)


@kernel(_nrt=False)
def store_route(fleet: Any, tours: Any, pool: Any, k: int, now: int) -> None:
    """Store route k if it is new, or cheaper than the stored route with the same tasks.

    If all PROBED_PLACES places for it are taken, it replaces the route that was not seen for longest.
    now: number of the present step
    """
    m = len(fleet.load)
    n = tours.stops[k]
    last = len(pool.key) - 1
    if n == 0:
        return
    key = pool.sign[m + fleet.twin[k]]
    for pos in range(1, n + 1):
        v = tours.stop[k, pos]
        if m <= v < 2 * m:
            key ^= pool.sign[v - m]
    place = np.int64(key & np.uint64(last))
    home = place
    for ahead in range(PROBED_PLACES):
        at = (home + ahead) & last
        if pool.vehicle[at] < 0 or pool.key[at] == key:
            place = at
            break
        if pool.age[at] < pool.age[place]:
            place = at
    pool.age[place] = now
    cost = tours.length[k] + fleet.fixed[k]
    if pool.vehicle[place] >= 0 and pool.key[place] == key and pool.cost[place] <= cost:
        return
    pool.key[place] = key
    pool.vehicle[place] = k
    pool.cost[place] = cost
    pool.stops[place] = n
    for pos in range(n):
        pool.stop[place, pos] = tours.stop[k, pos + 1]
