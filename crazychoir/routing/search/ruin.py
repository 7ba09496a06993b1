"""The first half of a search step: remove strings of neighbouring stops from several routes."""

from typing import Any, NamedTuple

import numpy as np

from crazychoir.numerics.kernels import kernel
from crazychoir.routing.search.tours import (
    KERNEL_OPTIONS,
    Tours,
    drop_tasks,
    is_route_feasible,
)
from crazychoir.types import Bools, Ints, Words


class SplitMix64Constants(NamedTuple):
    """Constants of the generator SplitMix64."""

    increment: np.uint64 = np.uint64(0x9E3779B97F4A7C15)
    """Increment of splitmix64."""
    multipliers: tuple[np.uint64, ...] = (
        np.uint64(0xBF58476D1CE4E5B9),
        np.uint64(0x94D049BB133111EB),
    )
    """Multipliers of splitmix64."""
    shifts: tuple[np.uint64, ...] = (
        np.uint64(30),
        np.uint64(27),
        np.uint64(31),
        np.uint64(11),
    )
    """Shifts of splitmix64; the last one leaves 53 bits for a float."""
    spacing: float = 2.0**-53
    """Distance between two numbers that `draw_fraction` can return."""


SPLITMIX64_CONSTANTS = SplitMix64Constants()


class StringRemoval(NamedTuple):
    """How strings of stops are drawn for removal."""

    longest_string: float = 10.0
    """Largest number of stops in a string."""
    split_probability: float = 0.5
    """Probability that a string keeps some stops in its middle."""
    stop_probability: float = 0.01
    """Probability, for each kept stop, that no further one is kept."""


STRING_REMOVAL = StringRemoval()


class SearchStep(NamedTuple):
    """The changes of a step."""

    gone: Bools
    """(M,) scratch: tasks to remove."""
    row: Ints
    """(L,) scratch: stops of a new route."""
    touched: Ints
    """(K,): the touched routes are the first counts[0] entries."""
    seen: Ints
    """(K,): the step in which a route was last touched."""
    counts: Ints
    """(3,): number of touched routes, number of the step, last version given."""
    stop: Ints
    """(K, L): stops of the touched routes before the step."""
    stops: Ints
    """(K,): their numbers of stops before the step."""
    version: Ints
    """(K,): their versions before the step."""

    @classmethod
    def of(cls, tours: Tours) -> "SearchStep":
        """Return the record before the first step."""
        zero = np.zeros(len(tours.stops), np.int64)
        none = np.zeros(len(tours.at), np.bool_)
        counts = np.array([0, 0, len(zero)], np.int64)
        return cls(
            none,
            np.zeros_like(tours.stop[0]),
            zero,
            zero.copy(),
            counts,
            np.zeros_like(tours.stop),
            zero.copy(),
            zero.copy(),
        )


@kernel(**KERNEL_OPTIONS)
def draw_fraction(random: Words) -> float:
    """Return a uniform number in (0, 1) by splitmix64, the same on every machine.

    random: (1,), its state, changed in place.
    Source: Steele, Lea, Flood 2014, OOPSLA, "Fast splittable pseudorandom number generators".
    """
    random[0] += SPLITMIX64_CONSTANTS.increment
    z = random[0]
    z = (z ^ (z >> SPLITMIX64_CONSTANTS.shifts[0])) * SPLITMIX64_CONSTANTS.multipliers[
        0
    ]
    z = (z ^ (z >> SPLITMIX64_CONSTANTS.shifts[1])) * SPLITMIX64_CONSTANTS.multipliers[
        1
    ]
    z = z ^ (z >> SPLITMIX64_CONSTANTS.shifts[2])
    return (
        float(z >> SPLITMIX64_CONSTANTS.shifts[3]) + 0.5
    ) * SPLITMIX64_CONSTANTS.spacing


@kernel(**KERNEL_OPTIONS)
def begin_step(step: Any) -> None:
    """Begin a step in which no route is touched yet."""
    step.counts[0] = 0
    step.counts[1] += 1


@kernel(_nrt=False)
def save_route(tours: Any, step: Any, k: int) -> None:
    """Save route k before it changes for the first time in this step, and give it a new version."""
    if step.seen[k] != step.counts[1]:
        step.seen[k] = step.counts[1]
        step.touched[step.counts[0]] = k
        step.counts[0] += 1
        step.stops[k] = tours.stops[k]
        step.version[k] = tours.version[k]
        for pos in range(tours.stops[k] + 2):
            step.stop[k, pos] = tours.stop[k, pos]
    step.counts[2] += 1
    tours.version[k] = step.counts[2]


@kernel(_nrt=False)
def remove_strings(
    fleet: Any, tours: Any, step: Any, random: Words, average: float
) -> None:
    """Remove strings of stops from neighbouring routes, around a randomly drawn stop.

    Each route loses one string. If there are fewer routes than strings, some lose several.

    average: number of stops that are removed together, on average.
    Source: Christiaens & Vanden Berghe 2020, Transportation Science 54(2), "Slack induction by
    string removals"; here the other stop of the same task is removed too.
    """
    m = len(fleet.load)
    longest = min(STRING_REMOVAL.longest_string, _compute_mean_stops(tours))
    strings = 1 + int(draw_fraction(random) * (4.0 * average / (1.0 + longest) - 1.0))
    seed = int(draw_fraction(random) * 2 * m)
    for is_again in (False, True):
        for rank in range(2 * m):
            v = fleet.near[seed, rank]
            k = tours.at[v if v < m else v - m]
            if k < 0 or (step.seen[k] == step.counts[1] and not is_again):
                continue
            at = _find_position(tours, k, v)
            if at == 0:
                continue
            save_route(tours, step, k)
            _mark_string(fleet, tours, step, random, k, at, longest)
            drop_tasks(fleet, tours, k, step.gone)
            if not is_route_feasible(fleet, tours, k):
                empty_route(fleet, tours, step, k)
            strings -= 1
            if strings <= 0:
                return


@kernel(_nrt=False)
def empty_route(fleet: Any, tours: Any, step: Any, k: int) -> None:
    """Remove all tasks from route k.

    Used if a route that has lost some stops is infeasible. This can happen
    - if distances do not satisfy the triangle inequality,
    - if the first trip loses all its stops, and the next trip exceeds the limit of a first trip, or
    - if goods that are on board at the start lose their delivery.
    """
    for j in range(len(fleet.load)):
        step.gone[j] = tours.at[j] == k
    save_route(tours, step, k)
    drop_tasks(fleet, tours, k, step.gone)


@kernel(**KERNEL_OPTIONS)
def _compute_mean_stops(tours: Any) -> float:
    """Return the mean number of stops of the routes that have any."""
    used = 0
    stops = 0
    for n in tours.stops:
        used += n > 0
        stops += n
    return stops / max(used, 1)


@kernel(**KERNEL_OPTIONS)
def _find_position(tours: Any, k: int, v: int) -> int:
    """Return the position of stop v in route k; 0 if it is not in the route."""
    for pos in range(1, tours.stops[k] + 1):
        if tours.stop[k, pos] == v:
            return pos
    return 0


@kernel(**KERNEL_OPTIONS)
def _mark_string(
    fleet: Any, tours: Any, step: Any, random: Words, k: int, at: int, longest: float
) -> None:
    """Mark the tasks of a string of stops of route k around position `at`.

    Half of the strings have a gap.
    """
    m = len(fleet.load)
    n = tours.stops[k]
    size = min(1 + int(draw_fraction(random) * min(float(n), longest)), n)
    gap = 0
    if 1 < size < n and draw_fraction(random) < STRING_REMOVAL.split_probability:
        gap = 1
        while (
            size + gap < n and draw_fraction(random) > STRING_REMOVAL.stop_probability
        ):
            gap += 1
    low = max(1, at - size - gap + 1)
    high = min(at, n - size - gap + 1)
    first = low + int(draw_fraction(random) * (high - low + 1))
    hole = first + 1 + int(draw_fraction(random) * (size - 1)) if gap > 0 else n + 2
    for j in range(m):
        step.gone[j] = False
    for pos in range(first, first + size + gap):
        v = tours.stop[k, pos]
        if v < 2 * m and not hole <= pos < hole + gap:
            step.gone[v if v < m else v - m] = True
