"""The first half of a search step: remove strings of neighbouring stops from several routes."""

from typing import Any, NamedTuple

import numpy as np

from crazychoir.numerics.kernels import kernel
from crazychoir.routing.search.tours import OPTIONS, Tours, drop, feasible
from crazychoir.types import Bools, Ints, Words

GOLDEN = np.uint64(0x9E3779B97F4A7C15)
"""Increment of splitmix64."""
MIX = (np.uint64(0xBF58476D1CE4E5B9), np.uint64(0x94D049BB133111EB))
"""Multipliers of splitmix64."""
SHIFTS = (np.uint64(30), np.uint64(27), np.uint64(31), np.uint64(11))
"""Shifts of splitmix64; the last one leaves 53 bits for a float."""
ULP = 2.0**-53
"""Distance between two numbers that `draw` can return."""
LONGEST = 10.0
"""Largest number of stops in a string."""
SPLIT = 0.5
"""Probability that a string keeps some stops in its middle."""
STOP = 0.01
"""Probability, for each kept stop, that no further one is kept."""


class Step(NamedTuple):
    """The changes of a step."""

    gone: Bools
    """(M,) scratch: tasks to remove."""
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
    def of(cls, tours: Tours) -> "Step":
        """Return the record before the first step."""
        zero = np.zeros(len(tours.stops), np.int64)
        none = np.zeros(len(tours.at), np.bool_)
        counts = np.array([0, 0, len(zero)], np.int64)
        return cls(
            none,
            zero,
            zero.copy(),
            counts,
            np.zeros_like(tours.stop),
            zero.copy(),
            zero.copy(),
        )


@kernel(**OPTIONS)
def draw(random: Words) -> float:
    """Return a uniform number in (0, 1) by splitmix64, the same on every machine.

    random: (1,), its state, changed in place.
    Source: Steele, Lea, Flood 2014, OOPSLA, "Fast splittable pseudorandom number generators".
    """
    random[0] += GOLDEN
    z = random[0]
    z = (z ^ (z >> SHIFTS[0])) * MIX[0]
    z = (z ^ (z >> SHIFTS[1])) * MIX[1]
    z = z ^ (z >> SHIFTS[2])
    return (float(z >> SHIFTS[3]) + 0.5) * ULP


@kernel(**OPTIONS)
def begin_step(step: Any) -> None:
    """Begin a step in which no route is touched yet."""
    step.counts[0] = 0
    step.counts[1] += 1


@kernel(_nrt=False)
def touch(tours: Any, step: Any, k: int) -> None:
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
def ruin(fleet: Any, tours: Any, step: Any, random: Words, average: float) -> None:
    """Remove strings of stops from neighbouring routes, around a randomly drawn stop.

    average: number of stops that are removed together, on average.
    Source: Christiaens & Vanden Berghe 2020, Transportation Science 54(2), "Slack induction by
    string removals"; here the other stop of the same task is removed too.
    """
    m = len(fleet.load)
    longest = min(LONGEST, _mean_stops(tours))
    strings = 1 + int(draw(random) * (4.0 * average / (1.0 + longest) - 1.0))
    seed = int(draw(random) * 2 * m)
    for rank in range(2 * m):
        v = fleet.near[seed, rank]
        k = tours.at[v if v < m else v - m]
        if k < 0 or step.seen[k] == step.counts[1]:
            continue
        at = _position(tours, k, v)
        if at == 0:
            continue
        touch(tours, step, k)
        _mark_string(fleet, tours, step, random, k, at, longest)
        drop(fleet, tours, k, step.gone)
        if not feasible(fleet, tours, k):
            empty(fleet, tours, step, k)
        strings -= 1
        if strings <= 0:
            return


@kernel(_nrt=False)
def empty(fleet: Any, tours: Any, step: Any, k: int) -> None:
    """Remove all tasks from route k.

    This is needed because fewer stops can break a limit too: without the triangle inequality, if a
    first trip has less room than the next, or if goods that were aboard stay there.
    """
    for j in range(len(fleet.load)):
        step.gone[j] = tours.at[j] == k
    touch(tours, step, k)
    drop(fleet, tours, k, step.gone)


@kernel(**OPTIONS)
def _mean_stops(tours: Any) -> float:
    """Return the mean number of stops of the routes that have any."""
    used = 0
    stops = 0
    for n in tours.stops:
        used += n > 0
        stops += n
    return stops / max(used, 1)


@kernel(**OPTIONS)
def _position(tours: Any, k: int, v: int) -> int:
    """Return the position of stop v in route k; 0 if it is not in the route."""
    for pos in range(1, tours.stops[k] + 1):
        if tours.stop[k, pos] == v:
            return pos
    return 0


@kernel(**OPTIONS)
def _mark_string(
    fleet: Any, tours: Any, step: Any, random: Words, k: int, at: int, longest: float
) -> None:
    """Mark the tasks of a string of stops of route k around position `at`.

    Half of the strings have a gap.
    """
    m = len(fleet.load)
    n = tours.stops[k]
    size = min(1 + int(draw(random) * min(float(n), longest)), n)
    gap = 0
    if 1 < size < n and draw(random) < SPLIT:
        gap = 1
        while size + gap < n and draw(random) > STOP:
            gap += 1
    low = max(1, at - size - gap + 1)
    high = min(at, n - size - gap + 1)
    first = low + int(draw(random) * (high - low + 1))
    hole = first + 1 + int(draw(random) * (size - 1)) if gap > 0 else n + 2
    for j in range(m):
        step.gone[j] = False
    for pos in range(first, first + size + gap):
        v = tours.stop[k, pos]
        if v < 2 * m and not hole <= pos < hole + gap:
            step.gone[v if v < m else v - m] = True
