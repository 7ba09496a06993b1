"""A search step on whole routes: two vehicles exchange the tails of their routes."""

from typing import Any, NamedTuple

from crazychoir.numerics.kernels import kernel
from crazychoir.routing.search.ruin import draw_fraction, empty_route, save_route
from crazychoir.routing.search.tours import (
    KERNEL_OPTIONS,
    end_route,
    is_route_feasible,
)
from crazychoir.types import Words


class TailExchange(NamedTuple):
    """How often tails are exchanged, and where routes are cut."""

    step_probability: float = 0.1
    """Probability that a step exchanges tails instead of removing strings."""
    whole_probability: float = 0.5
    """Probability that the tail of a route is the whole route."""
    segment_probability: float = 0.3


TAIL_EXCHANGE = TailExchange()


@kernel(_nrt=False)
def exchange_tails(
    fleet: Any, tours: Any, step: Any, memory: Any, random: Words
) -> None:
    """Exchange the tails of a route that serves tasks and of the route of any other vehicle.

    With heads H and tails T, and 0 for nothing:

        H1 T1, H2 T2 -> H1 T2, H2 T1
        0 T1, 0 T2  -> T2, T1       exchange of routes
        0 T1, 0 0   -> 0, T1        hand-over to an idle vehicle
        H1 T1, 0 0  -> H1, T1       split
        H1 0, 0 T2  -> H1 T2, 0     merge

    A task is removed if its stops are then in different routes, or if the new vehicle cannot carry
    it. A route that is infeasible for another reason loses all its tasks.
    Source: Potvin & Rousseau 1995, Journal of the Operational Research Society 46(12), "An exchange
    heuristic for routeing problems with time windows" (2-opt*); here with pairs of stops.
    """
    tasks = len(fleet.load)
    if tasks == 0:
        return
    first = tours.at[int(draw_fraction(random) * tasks)]
    second = int(draw_fraction(random) * len(fleet.start))
    if first < 0 or first == second or memory.closed[second]:
        return
    first_cut = _draw_cut(tours, random, first)
    second_cut = _draw_cut(tours, random, second)
    save_route(tours, step, first)
    save_route(tours, step, second)
    for j in range(tasks):
        if tours.at[j] == first or tours.at[j] == second:
            tours.at[j] = -1
    size = _copy_stops(step, first, 0, first_cut, 0)
    size = _copy_stops(step, second, second_cut, step.stops[second], size)
    _rebuild_route(fleet, tours, step, first, size)
    size = _copy_stops(step, second, 0, second_cut, 0)
    size = _copy_stops(step, first, first_cut, step.stops[first], size)
    _rebuild_route(fleet, tours, step, second, size)


@kernel(**KERNEL_OPTIONS)
def _draw_cut(tours: Any, random: Words, k: int) -> int:
    """Return the number of stops in the head of route k."""
    if draw_fraction(random) < TAIL_EXCHANGE.whole_probability:
        return 0
    return int(draw_fraction(random) * (tours.stops[k] + 1))


@kernel(**KERNEL_OPTIONS)
def _copy_stops(step: Any, k: int, first: int, last: int, size: int) -> int:
    """Append the stops `first` to `last` - 1, counted from 0, of the saved route k to the row."""
    for pos in range(first, last):
        step.row[size] = step.stop[k, pos + 1]
        size += 1
    return size


@kernel(_nrt=False)
def _rebuild_route(fleet: Any, tours: Any, step: Any, k: int, size: int) -> None:
    """Replace route k by the stops in the row, as far as vehicle k can serve their tasks."""
    m = len(fleet.load)
    end = fleet.end[k]
    _mark_lost_tasks(fleet, step, k, size)
    load = fleet.held[k]
    kept = 0
    for pos in range(size):
        v = step.row[pos]
        if v < m:
            if step.gone[v] or load + fleet.load[v] > fleet.capacity[k]:
                continue
            load += fleet.load[v]
            tours.at[v] = k
        elif v < 2 * m:
            if fleet.carrier[v - m] == k:
                tours.at[v - m] = k
            elif tours.at[v - m] != k:
                continue
            load -= fleet.load[v - m]
        elif kept == 0 or tours.stop[k, kept] == end:
            continue
        else:
            v = end
        kept += 1
        tours.stop[k, kept] = v
    end_route(fleet, tours, k, kept)
    if not is_route_feasible(fleet, tours, k):
        empty_route(fleet, tours, step, k)


@kernel(**KERNEL_OPTIONS)
def _mark_lost_tasks(fleet: Any, step: Any, k: int, size: int) -> None:
    """Mark the tasks without a delivery in the row, and the tasks that vehicle k must not serve."""
    m = len(fleet.load)
    for j in range(m):
        step.gone[j] = True
    for pos in range(size):
        v = step.row[pos]
        if m <= v < 2 * m:
            step.gone[v - m] = not fleet.capable[k, v - m]
