"""How a step of the search puts tasks back, and what it takes back."""

from typing import Any, NamedTuple

import numpy as np

from crazychoir.numerics.kernels import kernel
from crazychoir.routing.search.insertion import cheapest
from crazychoir.routing.search.ruin import draw, touch
from crazychoir.routing.search.tours import OPTIONS, Tours, insert, refresh
from crazychoir.types import Bools, Ints, Mat, Vec, Words

BLINK = 0.05
"""How often the cheapest place is not seen."""
SERVE, REFUSE = 0.4, 0.05
"""How often a task that can be refused is served anyway, and refused anyway."""
NONE = -9
"""No place."""
RANDOM, LOAD, FAR, CLOSE, WIDTH, OPENING, CLOSING = range(7)
ORDERS = (4, 8, 10, 11, 13, 15, 17)
"""Cumulative weights of the orders in which tasks are put back; the first four where there are no windows."""


class Memory(NamedTuple):
    """Cheapest places that are known: cost (M, K), place (M, K, 2), of the route's version (M, K);  and scratch:
    bank, rank: (M,) tasks to be put back and by what they are ordered;  extra: (2, L);  closed: (K,) vehicles that may
    not be used.
    """

    cost: Mat
    place: Ints
    version: Ints
    bank: Ints
    rank: Vec
    extra: Mat
    closed: Bools

    @classmethod
    def of(cls, tours: Tours, closed: Bools) -> "Memory":
        """Nothing is known; the search may close more."""
        (k, length), m = tours.stop.shape, len(tours.at)
        unknown = np.full((m, k), -1, np.int64)
        place = np.zeros((m, k, 2), np.int64)
        bank = np.zeros(m, np.int64)
        extra = np.zeros((2, length))
        return cls(
            np.zeros((m, k)), place, unknown, bank, np.zeros(m), extra, closed.copy()
        )


@kernel(_nrt=False)
def recreate(fleet: Any, tours: Any, step: Any, memory: Any, random: Words) -> None:
    """Put each task without a vehicle where it is cheapest, one after the other; now and then where it is next best."""
    for b in range(_order(fleet, tours, memory, random)):
        j = memory.bank[b]
        best = _most(fleet, tours, random, j)
        vehicle = -1
        first = 0
        second = 0
        for k in range(len(fleet.start)):
            if memory.closed[k] or _has_twin(fleet, tours, memory, k):
                continue
            cost, at_first, at_second = _best_place(
                fleet, tours, memory, random, j, k, best
            )
            if cost < best:
                best = cost
                vehicle = k
                first = at_first
                second = at_second
        if vehicle >= 0:
            touch(tours, step, vehicle)
            insert(fleet, tours, vehicle, j, first, second)


@kernel(**OPTIONS)
def _most(fleet: Any, tours: Any, random: Words, j: int) -> Any:
    """What task j may cost.

    One that can be refused is served at times even if that costs more, since two of them together can be worth a way
    that neither is alone; and is refused at times, where the last finish counts, since two of them can delay it.
    """
    if fleet.penalty[j] == np.inf:
        return np.inf
    u = draw(random)
    if u < SERVE:
        return np.inf
    if fleet.on_finish == 0.0:
        return fleet.penalty[j]
    finish = 0.0
    for k in range(len(fleet.start)):
        finish = max(finish, tours.finish[k])
    if u > 1.0 - REFUSE and fleet.penalty[j] < finish:
        return -np.inf
    return fleet.penalty[j] + fleet.on_finish * finish


@kernel(**OPTIONS)
def _has_twin(fleet: Any, tours: Any, memory: Any, k: int) -> bool:
    """Whether k is empty and the first of its kind is too: one of them is enough to be looked at."""
    twin = fleet.twin[k]
    return (
        twin < k
        and tours.stops[k] == 0
        and tours.stops[twin] == 0
        and not memory.closed[twin]
    )


@kernel(**OPTIONS)
def _best_place(
    fleet: Any, tours: Any, memory: Any, random: Words, j: int, k: int, best: float
) -> Any:
    """Cost and places of task j in route k, from memory if the route is as it was; at times the next best."""
    if memory.version[j, k] != tours.version[k]:
        cost, first, second = cheapest(fleet, tours, memory.extra, j, k, NONE, NONE)
        memory.cost[j, k] = cost
        memory.version[j, k] = tours.version[k]
        memory.place[j, k, 0] = first
        memory.place[j, k, 1] = second
    if memory.cost[j, k] < best and draw(random) < BLINK:
        return cheapest(
            fleet,
            tours,
            memory.extra,
            j,
            k,
            memory.place[j, k, 0],
            memory.place[j, k, 1],
        )
    return memory.cost[j, k], memory.place[j, k, 0], memory.place[j, k, 1]


@kernel(**OPTIONS)
def _order(fleet: Any, tours: Any, memory: Any, random: Words) -> int:
    """Fill the bank, in an order drawn at random, goods that are aboard first; returns how many there are."""
    choice = int(draw(random) * (ORDERS[-1] if fleet.timed else ORDERS[3]))
    order = 0
    n = 0
    while choice >= ORDERS[order]:
        order += 1
    for j in range(len(fleet.load)):
        if tours.at[j] >= 0:
            continue
        rank = -np.inf if fleet.carrier[j] >= 0 else _rank(fleet, random, order, j)
        at = n
        while at > 0 and memory.rank[at - 1] > rank:
            memory.rank[at], memory.bank[at] = memory.rank[at - 1], memory.bank[at - 1]
            at -= 1
        memory.rank[at] = rank
        memory.bank[at] = j
        n += 1
    return n


@kernel(**OPTIONS)
def _rank(fleet: Any, random: Words, order: int, j: int) -> Any:
    if order == RANDOM:
        return draw(random)
    if order == LOAD:
        return -fleet.traits[j, 0]
    if order == FAR:
        return -fleet.traits[j, 1]
    if order == CLOSING:
        return -fleet.traits[j, 4]
    return fleet.traits[j, order - 2]


@kernel(_nrt=False)
def take_back(fleet: Any, tours: Any, step: Any) -> None:
    """Make the routes that this step touched what they were."""
    for t in range(step.counts[0]):
        _assign(fleet, tours, step.touched[t], -1)
    for t in range(step.counts[0]):
        k = step.touched[t]
        tours.stops[k] = step.stops[k]
        tours.version[k] = step.version[k]
        for pos in range(step.stops[k] + 2):
            tours.stop[k, pos] = step.stop[k, pos]
        _assign(fleet, tours, k, k)
        refresh(fleet, tours, k)


@kernel(**OPTIONS)
def _assign(fleet: Any, tours: Any, k: int, vehicle: int) -> None:
    """The tasks of route k are the vehicle's."""
    m = len(fleet.load)
    for pos in range(1, tours.stops[k] + 1):
        v = tours.stop[k, pos]
        if v < 2 * m:
            tours.at[v if v < m else v - m] = vehicle
