"""Vehicles as the arrays of a search; data that all vehicles share are stored once."""

from collections.abc import Sequence

import numpy as np

from crazychoir.routing.instance.vehicle import (
    OBJECTIVE_NAMES,
    ROUNDING_SLACK,
    Vehicle,
)
from crazychoir.routing.search.tours import Fleet
from crazychoir.types import Ints, Mat, Vec

TIE_BREAK = 1e-3
"""Weight of the total in the annealed cost if the makespan is the first objective."""


def build_fleet(
    vehicles: Sequence[Vehicle],
    penalty: Vec,
    objective: Sequence[str] = (OBJECTIVE_NAMES.total,),
) -> Fleet:
    """Return the arrays of these vehicles; capacities, limits and windows include ROUNDING_SLACK.

    If all vehicles have the same distances between stops, and the same windows, they share one
    matrix that contains all starts and ends as nodes. Otherwise each has its own. Goods that are
    aboard must be delivered, whatever their penalty.
    """
    first = vehicles[0]
    k = len(vehicles)
    m = first.tasks
    timed = OBJECTIVE_NAMES.makespan in objective or any(v.timed for v in vehicles)
    shared = all(_is_same_between_stops(first, v, timed) for v in vehicles[1:])
    kind = np.zeros(k, np.int64) if shared else np.arange(k, dtype=np.int64)
    start = 2 * m + (np.arange(k, dtype=np.int64) if shared else np.zeros(k, np.int64))
    end = start + (k if shared else 1)
    distance, duration, earliest, latest = _stack_matrices(vehicles, kind, start, end)
    carrier = np.full(m, -1, np.int64)
    for i, v in enumerate(vehicles):
        carrier[v.aboard] = i
    on_total, on_finish = (
        (TIE_BREAK, 1.0) if objective[0] == OBJECTIVE_NAMES.makespan else (1.0, 0.0)
    )
    return Fleet(
        distance=distance,
        duration=duration,
        earliest=earliest,
        latest=latest,
        kind=kind,
        start=start,
        end=end,
        load=np.array(first.load, float),
        capacity=np.array([v.capacity + ROUNDING_SLACK for v in vehicles]),
        fixed=np.array([v.fixed for v in vehicles], float),
        held=np.array([float(v.load[v.aboard].sum()) for v in vehicles]),
        limit=np.array(
            [
                [v.limit + ROUNDING_SLACK, v.limit_again + ROUNDING_SLACK]
                for v in vehicles
            ]
        ),
        trips=np.array([v.trips for v in vehicles], np.int64),
        capable=np.array([v.capable | v.aboard for v in vehicles]),
        carrier=carrier,
        penalty=np.where(carrier >= 0, np.inf, penalty),
        twin=_find_twins(vehicles, shared),
        near=_sort_near_stops(first.ways.between),
        traits=_compute_traits(vehicles),
        timed=timed,
        on_total=on_total,
        on_finish=on_finish,
        counted=OBJECTIVE_NAMES.vehicles in objective,
    )


def _is_same_between_stops(v: Vehicle, w: Vehicle, timed: bool) -> bool:
    s = 2 * v.tasks
    pairs = [(v.ways.between, w.ways.between)]
    if timed:
        pairs += [
            (v.times.between, w.times.between),
            (v.earliest[:s], w.earliest[:s]),
            (v.latest[:s], w.latest[:s]),
        ]
    return all(a is b or np.array_equal(a, b) for a, b in pairs)


def _stack_matrices(
    vehicles: Sequence[Vehicle], kind: Ints, start: Ints, end: Ints
) -> tuple[Mat, Mat, Mat, Mat]:
    """Return distance, duration, earliest, latest of a Fleet."""
    s = 2 * vehicles[0].tasks
    u = int(kind.max()) + 1
    w = int(end.max()) + 1
    distance = np.zeros((u, w, w))
    duration = np.zeros((u, w, w))
    earliest = np.zeros((u, w))
    latest = np.zeros((u, w))
    for row, v in enumerate(vehicles[:u]):
        distance[row, :s, :s] = v.ways.between
        duration[row, :s, :s] = v.times.between
    for v, row, *ends in zip(vehicles, kind, start, end, strict=True):
        for whole, own in ((distance, v.ways), (duration, v.times)):
            whole[row, ends, :s] = own.to_stops
            whole[row, :s, ends] = own.from_stops.T
            whole[row, ends[0], ends] = own.ends[0]
            whole[row, ends[1], ends] = own.ends[1]
        earliest[row, :s] = v.earliest[:s]
        latest[row, :s] = v.latest[:s] + ROUNDING_SLACK
        earliest[row, ends] = v.earliest[s:]
        latest[row, ends] = v.latest[s:] + ROUNDING_SLACK
    return distance, duration, earliest, latest


def _find_twins(vehicles: Sequence[Vehicle], shared: bool) -> Ints:
    """Return (K,): the first identical vehicle. Vehicles with goods aboard have no twin."""
    seen: dict[object, int] = {}
    twin = np.arange(len(vehicles), dtype=np.int64)
    for i, v in enumerate(vehicles):
        parts = [v.capable, v.earliest, v.latest, *v.ways.outer, *v.times.outer]
        parts += [] if shared else [v.ways.between, v.times.between]
        numbers = (v.capacity, v.limit, v.limit_again, v.trips, v.fixed)
        if not v.aboard.any():
            twin[i] = seen.setdefault((numbers, *(part.tobytes() for part in parts)), i)
    return twin


def _sort_near_stops(distance: Mat) -> Ints:
    """Return (2M, 2M): for each stop, all stops by the shorter of the distances there and back."""
    return np.argsort(np.minimum(distance, distance.T), axis=1, kind="stable")


def _compute_traits(vehicles: Sequence[Vehicle]) -> Mat:
    """Return the traits of the tasks, (M, 5).

    They are load, shortest distance of a route with the task alone, width of its windows, first
    opening, last closing.
    """
    first = vehicles[0]
    m = first.tasks
    p = np.arange(m)
    d = np.arange(m, 2 * m)
    alone = [
        v.ways.to_stops[0, p] + v.ways.between[p, d] + v.ways.from_stops[d, 1]
        for v in vehicles
    ]
    width = np.minimum(
        first.latest[p] - first.earliest[p], first.latest[d] - first.earliest[d]
    )
    return np.column_stack(
        [first.load, np.min(alone, axis=0), width, first.earliest[p], first.latest[d]]
    )
