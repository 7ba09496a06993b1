"""The cheapest place for a task in a route, by the slacks that the route's positions keep."""

from typing import Any

import numpy as np

from crazychoir.numerics.kernels import kernel
from crazychoir.routing.search.tours import (
    KERNEL_OPTIONS,
    compute_service_begin,
    look_up_distance,
)

LOAD_ROUNDING = 1e-9
"""Units of load: load on board up to this is only rounding."""
NO_POSITION = -9
"""A position that means no place."""


@kernel(_nrt=False)
def find_cheapest_insertion(
    fleet: Any, tours: Any, extra: Any, j: int, k: int, but_first: int, but_second: int
) -> Any:
    """Find the cheapest way to insert task j into route k.

        cost = on_total * (growth of the route + fixed cost if it was empty)
               + on_finish * finish of the route

    extra: (2, L) scratch.
    but_first, but_second: a pair of places that is skipped.
    Returns the cost in m, inf if it fits nowhere, and the places (first, second) for `insert`.
    If durations violate the triangle inequality, some places that would be in time are not found.
    """
    if not fleet.capable[k, j] or fleet.load[j] > fleet.capacity[k]:
        return np.inf, 0, 0
    if fleet.carrier[j] >= 0:
        best, first, second = _find_delivery_place(fleet, tours, j, k, but_second)
    else:
        _compute_detours(fleet, tours, extra, j, k)
        best, first, second = _find_places_in_trip(
            fleet, tours, extra, j, k, but_first, but_second
        )
        if fleet.trips[k] > 1 and tours.stops[k] > 0:
            other, place = _find_new_trip(fleet, tours, j, k, best)
            if other < best:
                best = other
                first = place
                second = -1
    if tours.stops[k] == 0:
        best += fleet.on_total * (
            look_up_distance(fleet, fleet.kind[k], fleet.start[k], fleet.end[k])
            + fleet.fixed[k]
        )
    return best, first, second


@kernel(**KERNEL_OPTIONS)
def _compute_detours(fleet: Any, tours: Any, extra: Any, j: int, k: int) -> None:
    """Compute the detours of the delivery.

    extra[0]: m, detour of the delivery after each position.
    extra[1]: m, the least detour from this position to the end of the trip.
    """
    m = len(fleet.load)
    n = tours.stops[k]
    u = fleet.kind[k]
    d = m + j
    least = np.inf
    w = tours.stop[k, n + 1]
    for pos in range(n, -1, -1):
        v = tours.stop[k, pos]
        if w >= 2 * m:
            least = np.inf
        detour = (
            look_up_distance(fleet, u, v, d)
            + look_up_distance(fleet, u, d, w)
            - look_up_distance(fleet, u, v, w)
        )
        least = min(least, detour)
        extra[0, pos] = detour
        extra[1, pos] = least
        w = v


@kernel(**KERNEL_OPTIONS)
def _find_places_in_trip(
    fleet: Any, tours: Any, extra: Any, j: int, k: int, but_first: int, but_second: int
) -> Any:
    """Find the cheapest places of both stops in one of the present trips."""
    m = len(fleet.load)
    n = tours.stops[k]
    u = fleet.kind[k]
    timed = fleet.timed
    plain = fleet.on_finish == 0.0
    d = m + j
    spare = fleet.capacity[k] - fleet.load[j]
    best = np.inf
    first = 0
    second = 0
    pickup = 0.0
    w = tours.stop[k, 0]
    for i in range(n + 1):
        v = w
        w = tours.stop[k, i + 1]
        if tours.load[k, i] > spare:
            continue
        here = look_up_distance(fleet, u, v, j) - look_up_distance(fleet, u, v, w)
        detour = here + look_up_distance(fleet, u, j, w)
        both = (
            here + look_up_distance(fleet, u, j, d) + look_up_distance(fleet, u, d, w)
        )
        most = min(best, tours.room[k, i]) if plain else tours.room[k, i]
        ahead = (
            w < 2 * m
            and tours.load[k, i + 1] <= spare
            and detour + extra[1, i + 1] < most
        )
        if both >= most and not ahead:
            continue
        if timed:
            pickup = compute_service_begin(fleet, u, tours.begin[k, i], v, j)
            if pickup > fleet.latest[u, j]:
                continue
        if both < most and (i != but_first or i != but_second):
            cost = (
                _compute_delivery_cost(fleet, tours, k, both, pickup, j, d, i + 1)
                if timed
                else both
            )
            if cost < best:
                best = cost
                first = i
                second = i
                most = min(most, best) if plain else most
        if not ahead:
            continue
        but = but_second if i == but_first else NO_POSITION
        cost, place = _find_later_delivery(
            fleet, tours, extra, j, k, i, pickup, detour, best, most, but
        )
        if cost < best:
            best = cost
            first = i
            second = place
    return best, first, second


@kernel(**KERNEL_OPTIONS)
def _find_later_delivery(
    fleet: Any,
    tours: Any,
    extra: Any,
    j: int,
    k: int,
    i: int,
    pickup: float,
    detour: float,
    best: float,
    most: float,
    but: int,
) -> Any:
    """Find the cheapest place of delivery m + j after a later position than its pickup.

    extra: the detours of the delivery, see `_compute_detours`.
    i: position after which task j is picked up.
    pickup: s, begin of the service there.
    detour: m, by how much the pickup makes the route longer.
    best: cost of the best place so far, in m.
    most: m, the route may grow by less than this.
    but: a place that is skipped.
    Returns the cost in m and the place; `best` and 0 if no place is cheaper.
    """
    m = len(fleet.load)
    u = fleet.kind[k]
    timed = fleet.timed
    plain = fleet.on_finish == 0.0
    spare = fleet.capacity[k] - fleet.load[j]
    second = 0
    t = pickup
    before = j
    for s in range(i + 1, tours.stops[k] + 1):
        v = tours.stop[k, s]
        if v >= 2 * m or tours.load[k, s] > spare or detour + extra[1, s] >= most:
            break
        if timed:
            t = compute_service_begin(fleet, u, t, before, v)
            if t > tours.late[k, s]:
                break
            before = v
        growth = detour + extra[0, s]
        if growth < most and s != but:
            cost = (
                _compute_delivery_cost(fleet, tours, k, growth, t, v, m + j, s + 1)
                if timed
                else growth
            )
            if cost < best:
                best = cost
                second = s
                most = min(most, best) if plain else most
    return best, second


@kernel(**KERNEL_OPTIONS)
def _compute_delivery_cost(
    fleet: Any, tours: Any, k: int, growth: float, t: float, v: int, d: int, after: int
) -> Any:
    """Return the cost of delivery d before position `after` of route k; inf if it is too late.

    It comes after a service at v that begins at t.
    """
    u = fleet.kind[k]
    t = compute_service_begin(fleet, u, t, v, d)
    if t > fleet.latest[u, d]:
        return np.inf
    w = tours.stop[k, after]
    t = compute_service_begin(fleet, u, t, d, w)
    if t > tours.late[k, after]:
        return np.inf
    if fleet.on_finish == 0.0:
        return growth
    return fleet.on_total * growth + fleet.on_finish * _compute_finish(
        fleet, tours, k, t, after
    )


@kernel(**KERNEL_OPTIONS)
def _compute_finish(fleet: Any, tours: Any, k: int, t: float, pos: int) -> float:
    """Return when route k is over, in s, if service at position `pos` begins at t."""
    for after in range(pos + 1, tours.stops[k] + 2):
        t = compute_service_begin(
            fleet, fleet.kind[k], t, tours.stop[k, after - 1], tours.stop[k, after]
        )
    return t


@kernel(**KERNEL_OPTIONS)
def _find_new_trip(fleet: Any, tours: Any, j: int, k: int, below: float) -> Any:
    """Find the cheapest place for a new trip with task j after one of the present trips.

    Returns the cost in m and the position at the vehicle's end before the new trip.
    """
    n = tours.stops[k]
    u = fleet.kind[k]
    end = fleet.end[k]
    d = len(fleet.load) + j
    growth = (
        look_up_distance(fleet, u, end, j)
        + look_up_distance(fleet, u, j, d)
        + look_up_distance(fleet, u, d, end)
    )
    trips = 0
    cost = below
    place = 0
    for pos in range(1, n + 2):
        trips += tours.stop[k, pos] == end
    if growth >= fleet.limit[k, 1] or trips >= fleet.trips[k]:
        return np.inf, 0
    for pos in range(n + 1, 0, -1):
        if tours.stop[k, pos] != end or tours.load[k, pos] > LOAD_ROUNDING:
            continue
        here = growth
        if fleet.timed:
            pickup = compute_service_begin(fleet, u, tours.begin[k, pos], end, j)
            delivery = compute_service_begin(fleet, u, pickup, j, d)
            back = compute_service_begin(fleet, u, delivery, d, end)
            if (
                pickup > fleet.latest[u, j]
                or delivery > fleet.latest[u, d]
                or back > tours.late[k, pos]
            ):
                continue
            if fleet.on_finish > 0.0:
                here = fleet.on_total * growth + fleet.on_finish * _compute_finish(
                    fleet, tours, k, back, pos
                )
        if here < cost:
            cost = here
            place = pos
    return (cost, place) if place > 0 else (np.inf, 0)


@kernel(**KERNEL_OPTIONS)
def _find_delivery_place(fleet: Any, tours: Any, j: int, k: int, but: int) -> Any:
    """Find the cheapest place in the first trip for the delivery of goods that are aboard."""
    m = len(fleet.load)
    u = fleet.kind[k]
    d = len(fleet.load) + j
    best = np.inf
    second = 0
    for pos in range(tours.stops[k] + 1 if fleet.carrier[j] == k else 0):
        v = tours.stop[k, pos]
        w = tours.stop[k, pos + 1]
        if pos > 0 and v >= 2 * m:
            break
        growth = (
            look_up_distance(fleet, u, v, d)
            + look_up_distance(fleet, u, d, w)
            - look_up_distance(fleet, u, v, w)
        )
        if pos == but or growth >= tours.room[k, pos]:
            continue
        cost = (
            _compute_delivery_cost(
                fleet, tours, k, growth, tours.begin[k, pos], v, d, pos + 1
            )
            if fleet.timed
            else growth
        )
        if cost < best:
            best = cost
            second = pos
    return best, -1, second
