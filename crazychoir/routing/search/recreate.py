"""The second half of a search step: put tasks back into routes, or undo the step."""

from enum import IntEnum
from typing import Any, NamedTuple

import numpy as np

from crazychoir.numerics.kernels import kernel
from crazychoir.routing.search.insertion import NO_POSITION, find_cheapest_insertion
from crazychoir.routing.search.ruin import draw_fraction, save_route
from crazychoir.routing.search.tours import (
    KERNEL_OPTIONS,
    Tours,
    insert_task,
    refresh_route,
)
from crazychoir.types import Bools, Ints, Mat, Vec, Words


class InsertionChances(NamedTuple):
    """Probabilities of the random choices while tasks are put back."""

    skip_place: float = 0.05
    """Probability that the cheapest place is skipped."""
    serve_task: float = 0.4
    """Probability that a task is served although refusing it is cheaper."""
    refuse_task: float = 0.05
    """Probability that a task is refused although serving it is cheaper."""
    order_weights: tuple[int, ...] = (4, 8, 10, 11, 13, 15, 17)
    """Cumulative weights of the orders in which tasks are put back.

    Only the first four orders are used if there are no windows.
    """


INSERTION_CHANCES = InsertionChances()


class InsertionOrder(IntEnum):
    """Orders in which tasks are put back; all but the first follow the traits of Fleet."""

    RANDOM = 0
    """At random."""
    LOAD = 1
    """The largest load first."""
    FARTHEST = 2
    """The farthest task first."""
    CLOSEST = 3
    """The closest task first."""
    WINDOW_WIDTH = 4
    """The narrowest time window first."""
    OPENING_TIME = 5
    """The time window that opens first."""
    CLOSING_TIME = 6
    """The time window that closes last."""


class InsertionMemory(NamedTuple):
    """Known cheapest places of tasks, and scratch arrays."""

    cost: Mat
    """(M, K) m: least cost of task j in route k."""
    place: Ints
    """(M, K, 2): places of that cost."""
    version: Ints
    """(M, K): version of the route for which they hold."""
    bank: Ints
    """(M,) scratch: tasks to be put back, in order."""
    rank: Vec
    """(M,) scratch: values by which they are ordered."""
    extra: Mat
    """(2, L) scratch of `find_cheapest_insertion`."""
    closed: Bools
    """(K,): vehicles that must not be used."""

    @classmethod
    def of(cls, tours: Tours, closed: Bools) -> "InsertionMemory":
        """Return an empty memory; the search may close more vehicles than `closed`."""
        (k, length), m = tours.stop.shape, len(tours.at)
        unknown = np.full((m, k), -1, np.int64)
        place = np.zeros((m, k, 2), np.int64)
        bank = np.zeros(m, np.int64)
        extra = np.zeros((2, length))
        return cls(
            np.zeros((m, k)), place, unknown, bank, np.zeros(m), extra, closed.copy()
        )


@kernel(_nrt=False)
def insert_missing_tasks(
    fleet: Any, tours: Any, step: Any, memory: Any, random: Words
) -> None:
    """Insert the tasks without a vehicle one after the other, each at its cheapest place.

    Sometimes the next best place is taken instead.
    """
    for b in range(_fill_bank(fleet, tours, memory, random)):
        j = memory.bank[b]
        best = _bound_insertion_cost(fleet, tours, random, j)
        vehicle = -1
        first = 0
        second = 0
        for k in range(len(fleet.start)):
            if memory.closed[k] or _has_twin(fleet, tours, memory, k):
                continue
            cost, at_first, at_second = _find_best_place(
                fleet, tours, memory, random, j, k, best
            )
            if cost < best:
                best = cost
                vehicle = k
                first = at_first
                second = at_second
        if vehicle >= 0:
            save_route(tours, step, vehicle)
            insert_task(fleet, tours, vehicle, j, first, second)


@kernel(**KERNEL_OPTIONS)
def _bound_insertion_cost(fleet: Any, tours: Any, random: Words, j: int) -> Any:
    """Return the largest cost at which task j is inserted.

    Sometimes a task that can be refused is served even if that costs more, because two such tasks
    together can be worth a detour that neither is worth alone. Sometimes it is refused if the
    last finish time counts, because two such tasks together can delay it.
    """
    if fleet.penalty[j] == np.inf:
        return np.inf
    u = draw_fraction(random)
    if u < INSERTION_CHANCES.serve_task:
        return np.inf
    if fleet.on_finish == 0.0:
        return fleet.penalty[j]
    finish = 0.0
    for k in range(len(fleet.start)):
        finish = max(finish, tours.finish[k])
    if u > 1.0 - INSERTION_CHANCES.refuse_task and fleet.penalty[j] < finish:
        return -np.inf
    return fleet.penalty[j] + fleet.on_finish * finish


@kernel(**KERNEL_OPTIONS)
def _has_twin(fleet: Any, tours: Any, memory: Any, k: int) -> bool:
    """Return whether k is empty and an earlier identical vehicle is too: one of them is enough."""
    twin = fleet.twin[k]
    return (
        twin < k
        and tours.stops[k] == 0
        and tours.stops[twin] == 0
        and not memory.closed[twin]
    )


@kernel(**KERNEL_OPTIONS)
def _find_best_place(
    fleet: Any, tours: Any, memory: Any, random: Words, j: int, k: int, best: float
) -> Any:
    """Return cost and places of task j in route k; sometimes of the next best place.

    They come from memory if the route has not changed.
    """
    if memory.version[j, k] != tours.version[k]:
        cost, first, second = find_cheapest_insertion(
            fleet, tours, memory.extra, j, k, NO_POSITION, NO_POSITION
        )
        memory.cost[j, k] = cost
        memory.version[j, k] = tours.version[k]
        memory.place[j, k, 0] = first
        memory.place[j, k, 1] = second
    if (
        memory.cost[j, k] < best
        and draw_fraction(random) < INSERTION_CHANCES.skip_place
    ):
        return find_cheapest_insertion(
            fleet,
            tours,
            memory.extra,
            j,
            k,
            memory.place[j, k, 0],
            memory.place[j, k, 1],
        )
    return memory.cost[j, k], memory.place[j, k, 0], memory.place[j, k, 1]


@kernel(**KERNEL_OPTIONS)
def _fill_bank(fleet: Any, tours: Any, memory: Any, random: Words) -> int:
    """Fill the bank in a random kind of order, goods that are aboard first; return their number."""
    choice = int(
        draw_fraction(random)
        * (
            INSERTION_CHANCES.order_weights[-1]
            if fleet.timed
            else INSERTION_CHANCES.order_weights[3]
        )
    )
    order = 0
    n = 0
    while choice >= INSERTION_CHANCES.order_weights[order]:
        order += 1
    for j in range(len(fleet.load)):
        if tours.at[j] >= 0:
            continue
        rank = (
            -np.inf if fleet.carrier[j] >= 0 else _compute_rank(fleet, random, order, j)
        )
        at = n
        while at > 0 and memory.rank[at - 1] > rank:
            memory.rank[at], memory.bank[at] = memory.rank[at - 1], memory.bank[at - 1]
            at -= 1
        memory.rank[at] = rank
        memory.bank[at] = j
        n += 1
    return n


@kernel(**KERNEL_OPTIONS)
def _compute_rank(fleet: Any, random: Words, order: int, j: int) -> Any:
    if order == InsertionOrder.RANDOM:
        return draw_fraction(random)
    if order == InsertionOrder.LOAD:
        return -fleet.traits[j, 0]
    if order == InsertionOrder.FARTHEST:
        return -fleet.traits[j, 1]
    if order == InsertionOrder.CLOSING_TIME:
        return -fleet.traits[j, 4]
    return fleet.traits[j, order - 2]


@kernel(_nrt=False)
def restore_routes(fleet: Any, tours: Any, step: Any) -> None:
    """Restore the routes that this step touched."""
    for t in range(step.counts[0]):
        _assign_tasks(fleet, tours, step.touched[t], -1)
    for t in range(step.counts[0]):
        k = step.touched[t]
        tours.stops[k] = step.stops[k]
        tours.version[k] = step.version[k]
        for pos in range(step.stops[k] + 2):
            tours.stop[k, pos] = step.stop[k, pos]
        _assign_tasks(fleet, tours, k, k)
        refresh_route(fleet, tours, k)


@kernel(**KERNEL_OPTIONS)
def _assign_tasks(fleet: Any, tours: Any, k: int, vehicle: int) -> None:
    """Assign the tasks of route k to the vehicle."""
    m = len(fleet.load)
    for pos in range(1, tours.stops[k] + 1):
        v = tours.stop[k, pos]
        if v < 2 * m:
            tours.at[v if v < m else v - m] = vehicle
