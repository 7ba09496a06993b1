"""Routes as rows of stops, with data that make changes cheap to evaluate."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from crazychoir.numerics.kernels import kernel
from crazychoir.types import Bools, Ints, Mat, Vec

Box = npt.NDArray[np.float64]
"""Array of three dimensions."""
# Pieces of the search are inlined. They make no arrays, so that reference counting, which took four
# fifths of the time of an insertion, is switched off.
KERNEL_OPTIONS = {"forceinline": True, "_nrt": False}


class Fleet(NamedTuple):
    """K vehicles and M tasks as arrays.

    Nodes: 0..M-1 pickups, M..2M-1 deliveries, from 2M the starts and ends of vehicles. U is the
    number of kinds of matrices, W the number of nodes.
    """

    distance: Box
    """(U, W, W) m; vehicle k has row kind[k]."""
    duration: Box
    """(U, W, W) s: service at v and flight to w."""
    earliest: Mat
    """(U, W) s: earliest begin of service."""
    latest: Mat
    """(U, W) s: latest begin of service."""
    kind: Ints
    """(K,): row of a vehicle in the four arrays above."""
    start: Ints
    """(K,): start node of each vehicle."""
    end: Ints
    """(K,): end node of each vehicle."""
    load: Vec
    """(M,) units of load."""
    capacity: Vec
    """(K,) units of load."""
    fixed: Vec
    """(K,) m: cost of leaving home."""
    held: Vec
    """(K,) units of load: on board from the start."""
    limit: Mat
    """(K, 2) m: limit of the first trip, and of each other trip."""
    trips: Ints
    """(K,): largest number of trips."""
    capable: Bools
    """(K, M): whether vehicle k may serve task j."""
    carrier: Ints
    """(M,): the vehicle with the goods aboard from the start, -1 if none."""
    penalty: Vec
    """(M,) m: cost of refusing the task, inf if it must be served."""
    twin: Ints
    """(K,): the first vehicle that is identical."""
    near: Ints
    """(2M, 2M): for each stop, all stops by their distance from it."""
    traits: Mat
    """(M, 5): values by which tasks are ordered.

    They are load, length of a route with the task alone, width of the windows, opening, closing.
    """
    timed: bool
    """Whether anything depends on time."""
    on_total: float
    """Weight of the sum of distances in the objective."""
    on_finish: float
    """Weight of the last finish time in the objective."""
    counted: bool
    """Whether the number of vehicles that leave is minimised before the rest."""


class Tours(NamedTuple):
    """The routes of all vehicles.

    A stop at the vehicle's end between two other stops begins a new trip. The arrays over positions
    are (K, 3M + 4).
    """

    stop: Ints
    """(K, 3M + 4): stop[k, 0] is the start of vehicle k.

    stop[k, 1 : n + 1] are its n = stops[k] stops, then comes its end.
    """
    stops: Ints
    """(K,): number of stops."""
    begin: Mat
    """(K, 3M + 4) s: begin of service at each position."""
    late: Mat
    """(K, 3M + 4) s: the latest begin from which the rest of the route is in time."""
    load: Mat
    """(K, 3M + 4) units of load: on board after each position."""
    room: Mat
    """(K, 3M + 4) m: by how much the trip that leaves this position may grow."""
    length: Vec
    """(K,) m: length of the route, 0 without stops."""
    finish: Vec
    """(K,) s: when the route is over, 0 without stops."""
    at: Ints
    """(M,): vehicle of each task, -1 if none."""
    version: Ints
    """(K,): a number that is new after each change."""

    @classmethod
    def of(cls, fleet: Fleet, routes: Sequence[Any]) -> "Tours":
        """Return these stops of each vehicle; `refresh_route` computes the rest."""
        k = len(fleet.start)
        m = len(fleet.load)
        length = 3 * m + 4  # each trip has a task
        stop = np.zeros((k, length), np.int64)
        stops = np.zeros(k, np.int64)
        at = np.full(m, -1, np.int64)
        for i, route in enumerate(routes):
            nodes = np.array(route, np.int64)
            n = len(route)
            stop[i, 0] = fleet.start[i]
            stop[i, n + 1] = fleet.end[i]
            stop[i, 1 : n + 1] = np.where(nodes < 2 * m, nodes, fleet.end[i])
            stops[i] = n
            at[nodes[nodes < 2 * m] % m] = i
        begin, late, load, room = (np.zeros((k, length)) for _ in range(4))
        return cls(
            stop,
            stops,
            begin,
            late,
            load,
            room,
            np.zeros(k),
            np.zeros(k),
            at,
            np.arange(k, dtype=np.int64),
        )


@kernel(**KERNEL_OPTIONS)
def look_up_distance(fleet: Any, u: int, v: int, w: int) -> Any:
    """Return the distance in m from v to w."""
    return fleet.distance[u, v, w]


@kernel(**KERNEL_OPTIONS)
def compute_service_begin(fleet: Any, u: int, t: float, v: int, w: int) -> Any:
    """Return when service at w begins, in s, if service at v began at t."""
    return max(fleet.earliest[u, w], t + fleet.duration[u, v, w])


@kernel(_nrt=False)
def refresh_route(fleet: Any, tours: Any, k: int) -> None:
    """Compute all values of route k from its stops."""
    m = len(fleet.load)
    n = tours.stops[k]
    u = fleet.kind[k]
    tours.load[k, 0] = fleet.held[k]
    total = 0.0
    trip = 0.0
    first = 0
    limit = fleet.limit[k, 0]
    w = tours.stop[k, 0]
    for pos in range(1, n + 2):
        v = w
        w = tours.stop[k, pos]
        trip += look_up_distance(fleet, u, v, w)
        load = tours.load[k, pos - 1]
        if w < m:
            load += fleet.load[w]
        elif w < 2 * m:
            load -= fleet.load[w - m]
        else:
            for back in range(first, pos):
                tours.room[k, back] = limit - trip
            total = total + trip
            trip = 0.0
            first = pos
            limit = fleet.limit[k, 1]
        tours.load[k, pos] = load
    tours.length[k] = total if n > 0 else 0.0
    if fleet.timed:
        _refresh_route_times(fleet, tours, k)


@kernel(**KERNEL_OPTIONS)
def _refresh_route_times(fleet: Any, tours: Any, k: int) -> None:
    n = tours.stops[k]
    u = fleet.kind[k]
    w = tours.stop[k, 0]
    t = fleet.earliest[u, w]
    tours.begin[k, 0] = t
    for pos in range(1, n + 2):
        v = w
        w = tours.stop[k, pos]
        t = compute_service_begin(fleet, u, t, v, w)
        tours.begin[k, pos] = t
    tours.finish[k] = t if n > 0 else 0.0
    t = fleet.latest[u, w]
    tours.late[k, n + 1] = t
    for pos in range(n, -1, -1):
        v = tours.stop[k, pos]
        t = min(fleet.latest[u, v], t - fleet.duration[u, v, w])
        w = v
        tours.late[k, pos] = t


@kernel(_nrt=False)
def is_route_feasible(fleet: Any, tours: Any, k: int) -> bool:
    """Return whether route k, refreshed, keeps capacity, limit, windows and number of trips."""
    trips = 1
    for pos in range(tours.stops[k] + 1):
        trips += pos > 0 and tours.stop[k, pos] == fleet.end[k]
        if tours.load[k, pos] > fleet.capacity[k] or tours.room[k, pos] < 0.0:
            return False
        if fleet.timed and tours.begin[k, pos] > tours.late[k, pos]:
            return False
    return bool(trips <= fleet.trips[k])


@kernel(_nrt=False)
def end_route(fleet: Any, tours: Any, k: int, kept: int) -> None:
    """Let route k end after its first `kept` stops, and compute its lengths and loads anew.

    A visit to the depot as the last of these stops is left out.
    """
    end = fleet.end[k]
    if kept > 0 and tours.stop[k, kept] == end:
        kept -= 1
    tours.stop[k, kept + 1] = end
    tours.stops[k] = kept
    refresh_route(fleet, tours, k)


@kernel(_nrt=False)
def drop_tasks(fleet: Any, tours: Any, k: int, gone: Any) -> None:
    """Remove the tasks marked in `gone` (M,) and empty trips from route k; refresh it."""
    m = len(fleet.load)
    end = fleet.end[k]
    kept = 0
    for pos in range(1, tours.stops[k] + 1):
        v = tours.stop[k, pos]
        if v < 2 * m:
            j = v if v < m else v - m
            if gone[j]:
                tours.at[j] = -1
                continue
        elif kept == 0 or tours.stop[k, kept] == end:
            continue
        kept += 1
        tours.stop[k, kept] = v
    end_route(fleet, tours, k, kept)


@kernel(**KERNEL_OPTIONS)
def _shift_stops(tours: Any, k: int, last: int, first: int, by: int) -> None:
    """Move positions first + 1..last of route k by `by` positions to the right."""
    for pos in range(last, first, -1):
        tours.stop[k, pos + by] = tours.stop[k, pos]


@kernel(_nrt=False)
def insert_task(
    fleet: Any, tours: Any, k: int, j: int, first: int, second: int
) -> None:
    """Insert task j into route k: its pickup after position `first`, its delivery after `second`.

    first, second: positions of the present route.
    second = -1: both stops come after `first`, where the vehicle is at its end, as a new trip.
    first = -1: the goods are aboard, and only the delivery is a stop.
    """
    d = len(fleet.load) + j
    n = tours.stops[k]
    if second < 0:
        _shift_stops(tours, k, n + 1, first, 3)
        tours.stop[k, first + 1] = j
        tours.stop[k, first + 2] = d
        tours.stop[k, first + 3] = fleet.end[k]
        tours.stops[k] = n + 3
    elif first < 0:
        _shift_stops(tours, k, n + 1, second, 1)
        tours.stop[k, second + 1] = d
        tours.stops[k] = n + 1
    else:
        _shift_stops(tours, k, n + 1, second, 2)
        tours.stop[k, second + 2] = d
        _shift_stops(tours, k, second, first, 1)
        tours.stop[k, first + 1] = j
        tours.stops[k] = n + 2
    tours.at[j] = k
    refresh_route(fleet, tours, k)
