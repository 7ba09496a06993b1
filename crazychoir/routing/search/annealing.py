"""The loop of the search: ruin, recreate, accept or take back; and the routes that it saw."""

from typing import Any, NamedTuple

import numpy as np

from crazychoir.numerics.kernels import kernel
from crazychoir.routing.search.recreate import recreate, take_back
from crazychoir.routing.search.route_pool import remember
from crazychoir.routing.search.ruin import begin_step, draw, empty, ruin
from crazychoir.routing.search.tours import OPTIONS, Fleet, Tours, feasible, refresh
from crazychoir.types import Ints, Vec, Words

LEVELS = 1024
COOLER = 0.9955128609158502
"""A hundredth over all levels of temperature: 100^(-1/1024)."""
TIE = 1e-9
LN2 = 0.6931471805599453


class Best(NamedTuple):
    """The best plan so far: stop (K, L), stops (K,), score (4,): tasks missing, and the
    three values of `judge` by which plans are compared.
    """

    stop: Ints
    stops: Ints
    score: Vec

    @classmethod
    def of(cls, tours: Tours) -> "Best":
        """None yet."""
        return cls(np.zeros_like(tours.stop), np.zeros_like(tours.stops), np.zeros(4))

    def tours(self, fleet: Fleet) -> Tours:
        """Its routes, judged."""
        tours = Tours.of(
            fleet,
            [row[1 : n + 1] for row, n in zip(self.stop, self.stops, strict=True)],
        )
        for k in range(len(self.stops)):
            refresh(fleet, tours, k)
        return tours


@kernel(nogil=True, _nrt=False)
def anneal(
    fleet: Any,
    tours: Any,
    step: Any,
    memory: Any,
    best: Any,
    pool: Any,
    random: Words,
    absence: Vec,
    steps: int,
    hot: float,
    average: float,
    fewer: bool,
) -> int:
    """Search from `tours`; the best plan is in `best`. Returns how many steps it took, `steps` at most.

        accept a plan of cost c', c being the plan's of now, if  c' < c - T ln U,   T from `hot` to hot / 100

    A plan in which tasks are missing is accepted if they are fewer, or if they were missing less often till now.
    fewer: after each plan that misses none a vehicle is closed, and the steps end when no more can be.
    Source: Christiaens & Vanden Berghe 2020, Transportation Science 54(2).
    """
    _start(fleet, tours, step, memory, random)
    missing, _, heavy, cost, first, second = judge(fleet, tours, absence)
    _keep(tours, best, missing, heavy, first, second)
    for k in range(len(fleet.start)):
        remember(fleet, tours, pool, k, 0)
    temperature = hot
    level = 0
    for now in range(1, steps + 1):
        if fewer and missing == 0:
            if not _close_one(fleet, tours, step, memory, absence):
                return now
            missing, _, heavy, cost, _, _ = judge(fleet, tours, absence)
        while level * steps < now * LEVELS:
            temperature *= COOLER
            level += 1
        absent = _absent(fleet, tours, absence) if missing > 0 else 0.0
        begin_step(step)
        ruin(fleet, tours, step, random, average)
        recreate(fleet, tours, step, memory, random)
        new_missing, new_absent, new_heavy, new_cost, first, second = judge(
            fleet, tours, absence
        )
        if new_missing < missing or new_absent < absent:
            accepted = True
        elif new_missing > missing or new_absent > absent:
            accepted = False
        elif new_heavy != heavy:
            accepted = new_heavy < heavy
        else:
            accepted = new_cost < cost + temperature * exponential(random)
        if new_missing > 0:
            _count_absence(fleet, tours, absence)
        if not accepted:
            take_back(fleet, tours, step)
            continue
        missing = new_missing
        heavy = new_heavy
        cost = new_cost
        for t in range(step.counts[0]):
            remember(fleet, tours, pool, step.touched[t], now)
        if missing < best.score[0] or (
            missing == best.score[0] and (fewer or _better(best, heavy, first, second))
        ):
            _keep(tours, best, missing, heavy, first, second)
    return steps


@kernel(**OPTIONS)
def _start(fleet: Any, tours: Any, step: Any, memory: Any, random: Words) -> None:
    """Empty the routes that are not feasible, and put all tasks without a vehicle into routes."""
    for k in range(len(fleet.start)):
        refresh(fleet, tours, k)
        if tours.stops[k] > 0 and not feasible(fleet, tours, k):
            empty(fleet, tours, step, k)
    begin_step(step)
    recreate(fleet, tours, step, memory, random)


@kernel(**OPTIONS)
def exponential(random: Words) -> float:
    """-ln U of a uniform U, by sums and products alone, so that every machine rounds it alike.

    -ln u = n ln 2 - 2 (s + s^3 / 3 + s^5 / 5 + ...),   s = (2^n u - 1) / (2^n u + 1),   1/2 <= 2^n u < 1
    """
    u = draw(random)
    doublings = 0
    while u < 0.5:
        u += u
        doublings += 1
    s = (u - 1.0) / (u + 1.0)
    power = s
    total = 0.0
    for odd in range(1, 26, 2):
        total += power / odd
        power *= s * s
    return doublings * LN2 - 2.0 * total


@kernel(_nrt=False)
def judge(fleet: Any, tours: Any, absence: Vec) -> Any:
    """Tasks missing that must be served, how often these were missing till now, what comes before all lengths, what is
    annealed, and two values by which plans are compared after these, the second where the first are equal.

    What comes before lengths, where vehicles are counted: their fixed costs, which are all alike, and the penalties,
    so that the same number of vehicles and of tasks left out is the same value, to the last bit. Else it is 0.
    """
    missing = 0
    absent = 0.0
    heavy = 0.0
    total = 0.0
    penalty = 0.0
    finish = 0.0
    for k in range(len(fleet.start)):
        if tours.stops[k] > 0:
            if fleet.counted:
                heavy += fleet.fixed[k]
                total += tours.length[k]
            else:
                total += tours.length[k] + fleet.fixed[k]
            finish = max(finish, tours.finish[k])
    for j in range(len(fleet.load)):
        if tours.at[j] < 0:
            if fleet.penalty[j] == np.inf:
                missing += 1
                absent += absence[j]
            else:
                penalty += fleet.penalty[j]
    if fleet.counted:
        return missing, absent, heavy + penalty, total, total, finish
    cost = fleet.on_total * total + fleet.on_finish * finish + penalty
    if fleet.on_finish > 0.0:
        return missing, absent, heavy, cost, finish + penalty, total
    return missing, absent, heavy, cost, cost, finish


@kernel(**OPTIONS)
def _absent(fleet: Any, tours: Any, absence: Vec) -> float:
    """How often the tasks that are missing were missing till now, together."""
    absent = 0.0
    for j in range(len(fleet.load)):
        if tours.at[j] < 0 and fleet.penalty[j] == np.inf:
            absent += absence[j]
    return absent


@kernel(**OPTIONS)
def _count_absence(fleet: Any, tours: Any, absence: Vec) -> None:
    for j in range(len(fleet.load)):
        if tours.at[j] < 0:
            absence[j] += 1.0


@kernel(**OPTIONS)
def _better(best: Any, heavy: float, first: float, second: float) -> Any:
    """Whether the values of a plan are less than those of the best one, in order."""
    if heavy != best.score[1]:
        return heavy < best.score[1]
    if first < best.score[2] - TIE:
        return True
    return first <= best.score[2] and second < best.score[3] - TIE


@kernel(_nrt=False)
def _keep(
    tours: Any, best: Any, missing: int, heavy: float, first: float, second: float
) -> None:
    """The plan of now is the best one."""
    best.score[0] = missing
    best.score[1] = heavy
    best.score[2] = first
    best.score[3] = second
    for k in range(len(tours.stops)):
        best.stops[k] = tours.stops[k]
        for pos in range(tours.stops[k] + 2):
            best.stop[k, pos] = tours.stop[k, pos]


@kernel(_nrt=False)
def _close_one(fleet: Any, tours: Any, step: Any, memory: Any, absence: Vec) -> bool:
    """Close all empty vehicles and the one whose tasks were missing least often, and empty it; False if there is none.

    A vehicle with goods aboard must leave.
    """
    victim = -1
    least = np.inf
    for k in range(len(fleet.start)):
        if tours.stops[k] == 0:
            memory.closed[k] = True
        elif fleet.held[k] == 0.0:
            total = 0.0
            for j in range(len(fleet.load)):
                if tours.at[j] == k:
                    total += 1.0 + absence[j]
            if total < least:
                victim = k
                least = total
    if victim < 0:
        return False
    memory.closed[victim] = True
    empty(fleet, tours, step, victim)
    return True
