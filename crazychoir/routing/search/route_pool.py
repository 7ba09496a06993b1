"""The routes that a search has seen."""

from typing import Any, NamedTuple

import numpy as np

from crazychoir.numerics.kernels import kernel
from crazychoir.routing.search.tours import Fleet, Tours
from crazychoir.types import Ints, Vec, Words

PLACES = 4096
"""Routes that are kept, at most; a power of two."""
WAYS = 4
"""Places where a route may be kept."""


class Pool(NamedTuple):
    """Routes seen, P a power of two: key (P,) of vehicle and set of tasks, vehicle (P,), -1 where there is none, cost
    (P,) m, stops (P,), stop (P, L), age (P,) step in which it was last seen;  sign (M + K,) of which keys are made.
    """

    key: Words
    vehicle: Ints
    cost: Vec
    stops: Ints
    stop: Ints
    age: Ints
    sign: Words

    @classmethod
    def of(cls, fleet: Fleet, tours: Tours) -> "Pool":
        """Empty."""
        zero = np.zeros(PLACES, np.int64)
        words = np.zeros(PLACES, np.uint64)
        # Any fixed words will do whose exclusive sums differ.
        draw = np.random.default_rng(0)
        sign = draw.integers(1, 2**64, len(fleet.load) + len(fleet.start), np.uint64)
        stop = np.zeros((PLACES, tours.stop.shape[1]), np.int64)
        return cls(words, zero - 1, np.zeros(PLACES), zero, stop, zero.copy(), sign)


@kernel(_nrt=False)
def remember(fleet: Any, tours: Any, pool: Any, k: int, now: int) -> None:
    """Put route k into the pool, if it is new or cheaper than the one of the same tasks; the oldest makes room."""
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
    for ahead in range(WAYS):
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
