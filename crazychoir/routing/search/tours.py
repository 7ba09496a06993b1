"""Routes as a search changes them: stops in rows, and what makes a change cheap to judge."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from crazychoir.numerics.kernels import kernel
from crazychoir.types import Bools, Ints, Mat, Vec

Box = npt.NDArray[np.float64]
# Pieces of the search: inlined, and without counting of references, which took four fifths of the time of an insertion.
# They make no arrays.
OPTIONS = {"forceinline": True, "_nrt": False}


class Fleet(NamedTuple):
    """K vehicles and M tasks. Nodes: 0..M-1 pickups, M..2M-1 deliveries, from 2M on where vehicles start and end.

    distance, duration: (U, W, W) m, s, earliest, latest: (U, W) s, of which vehicle k has row kind[k];
    start, end: (K,) nodes;  load: (M,);  capacity, fixed, held: (K,), held is on board from the start;
    limit: (K, 2) m, of the first trip and of each other;  trips: (K,), at most;  capable: (K, M);
    carrier: (M,) the vehicle that has it aboard from the start, -1 if none;
    penalty: (M,) m, inf where a task must be served;  twin: (K,) the first vehicle that is the same;
    near: (2M, 2M) all stops by their distance from one;
    traits: (M, 5) by which tasks are ordered: load, length alone, width, opening and closing of its windows;
    timed: whether anything depends on time;
    on_total, on_finish: weights of the sum of distances and of the last finish in what is minimised;
    counted: whether the number of vehicles that leave is minimised before that.
    """

    distance: Box
    duration: Box
    earliest: Mat
    latest: Mat
    kind: Ints
    start: Ints
    end: Ints
    load: Vec
    capacity: Vec
    fixed: Vec
    held: Vec
    limit: Mat
    trips: Ints
    capable: Bools
    carrier: Ints
    penalty: Vec
    twin: Ints
    near: Ints
    traits: Mat
    timed: bool
    on_total: float
    on_finish: float
    counted: bool


class Tours(NamedTuple):
    """The route of vehicle k: stop[k, 0] is its start, stop[k, 1 : n + 1] its n = stops[k] stops, then its end.

    A stop in between at the vehicle's end begins a new trip. Of each position, all (K, 3M + 4):
    begin: s, of service;  late: s, the latest beginning from which the rest is in time;  load: on board behind it;
    room: m, by which the trip that goes on from it may grow.
    length, finish: (K,) m and s, of the route, 0 without stops;  at: (M,) vehicle of a task, -1 if none;
    version: (K,) another number after each change.
    """

    stop: Ints
    stops: Ints
    begin: Mat
    late: Mat
    load: Mat
    room: Mat
    length: Vec
    finish: Vec
    at: Ints
    version: Ints

    @classmethod
    def of(cls, fleet: Fleet, routes: Sequence[Any]) -> "Tours":
        """These stops of each vehicle, not yet judged."""
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


@kernel(**OPTIONS)
def way(fleet: Any, u: int, v: int, w: int) -> Any:
    """m, from v to w."""
    return fleet.distance[u, v, w]


@kernel(**OPTIONS)
def begins(fleet: Any, u: int, t: float, v: int, w: int) -> Any:
    """s, when service at w begins if it began at v at t."""
    return max(fleet.earliest[u, w], t + fleet.duration[u, v, w])


@kernel(_nrt=False)
def refresh(fleet: Any, tours: Any, k: int) -> None:
    """Judge route k anew, from its stops."""
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
        trip += way(fleet, u, v, w)
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
        _refresh_times(fleet, tours, k)


@kernel(**OPTIONS)
def _refresh_times(fleet: Any, tours: Any, k: int) -> None:
    n = tours.stops[k]
    u = fleet.kind[k]
    w = tours.stop[k, 0]
    t = fleet.earliest[u, w]
    tours.begin[k, 0] = t
    for pos in range(1, n + 2):
        v = w
        w = tours.stop[k, pos]
        t = begins(fleet, u, t, v, w)
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
def feasible(fleet: Any, tours: Any, k: int) -> bool:
    """Whether route k, refreshed, keeps capacity, limit and windows."""
    for pos in range(tours.stops[k] + 1):
        if tours.load[k, pos] > fleet.capacity[k] or tours.room[k, pos] < 0.0:
            return False
        if fleet.timed and tours.begin[k, pos] > tours.late[k, pos]:
            return False
    return True


@kernel(_nrt=False)
def drop(fleet: Any, tours: Any, k: int, gone: Any) -> None:
    """Take the stops of the tasks marked in `gone` (M,) out of route k, and trips that are empty then; refresh it."""
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
    if kept > 0 and tours.stop[k, kept] == end:
        kept -= 1
    tours.stop[k, kept + 1] = end
    tours.stops[k] = kept
    refresh(fleet, tours, k)


@kernel(**OPTIONS)
def _shift(tours: Any, k: int, last: int, first: int, by: int) -> None:
    """Positions first + 1..last of route k move on by `by`."""
    for pos in range(last, first, -1):
        tours.stop[k, pos + by] = tours.stop[k, pos]


@kernel(_nrt=False)
def insert(fleet: Any, tours: Any, k: int, j: int, first: int, second: int) -> None:
    """Put task j into route k: its pickup behind position `first`, its delivery behind position `second` of now.

    second = -1: both behind `first`, where the vehicle is at its end, as a trip of their own;
    first = -1: the goods are aboard, and only the delivery is a stop.
    """
    d = len(fleet.load) + j
    n = tours.stops[k]
    if second < 0:
        _shift(tours, k, n + 1, first, 3)
        tours.stop[k, first + 1] = j
        tours.stop[k, first + 2] = d
        tours.stop[k, first + 3] = fleet.end[k]
        tours.stops[k] = n + 3
    elif first < 0:
        _shift(tours, k, n + 1, second, 1)
        tours.stop[k, second + 1] = d
        tours.stops[k] = n + 1
    else:
        _shift(tours, k, n + 1, second, 2)
        tours.stop[k, second + 2] = d
        _shift(tours, k, second, first, 1)
        tours.stop[k, first + 1] = j
        tours.stops[k] = n + 2
    tours.at[j] = k
    refresh(fleet, tours, k)
