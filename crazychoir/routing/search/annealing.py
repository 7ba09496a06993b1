"""The loop of the search: ruin, recreate, accept or take back."""

from typing import Any, NamedTuple

import numpy as np

from crazychoir.numerics.kernels import kernel
from crazychoir.routing.search.recreate import insert_missing_tasks, restore_routes
from crazychoir.routing.search.route_pool import store_route
from crazychoir.routing.search.ruin import (
    begin_step,
    draw_fraction,
    empty_route,
    remove_strings,
)
from crazychoir.routing.search.tail_exchange import TAIL_EXCHANGE, exchange_tails
from crazychoir.routing.search.tours import (
    KERNEL_OPTIONS,
    Fleet,
    Tours,
    is_route_feasible,
    refresh_route,
)
from crazychoir.types import Ints, Vec, Words

TEMPERATURE_LEVELS = 1024
"""Number of temperatures."""
COOLING_FACTOR = 0.9955128609158502
"""Factor from one temperature to the next: 100^(-1/1024), so that the last is a hundredth."""
TIE_TOLERANCE = 1e-9
"""m or s: values that differ by less count as equal."""
NATURAL_LOG_OF_2 = 0.6931471805599453
"""Natural logarithm of 2."""


class BestTours(NamedTuple):
    """The best plan so far."""

    stop: Ints
    """(K, L): its stops, as in Tours."""
    stops: Ints
    """(K,): number of stops."""
    score: Vec
    """(4,): number of missing tasks, then three values of `evaluate_tours` that compare plans."""

    @classmethod
    def of(cls, tours: Tours) -> "BestTours":
        """Return an empty record, before any plan."""
        return cls(np.zeros_like(tours.stop), np.zeros_like(tours.stops), np.zeros(4))

    def tours(self, fleet: Fleet) -> Tours:
        """Return the routes of the best plan as Tours, with lengths, times and loads."""
        tours = Tours.of(
            fleet,
            [row[1 : n + 1] for row, n in zip(self.stop, self.stops, strict=True)],
        )
        for k in range(len(self.stops)):
            refresh_route(fleet, tours, k)
        return tours


@kernel(nogil=True, _nrt=False)
def anneal_tours(
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
    """Search from `tours`; the best plan is in `best`.

        accept cost c' after cost c if  c' < c - T ln U,   T from `hot` to hot / 100

    A plan in which tasks are missing is accepted if fewer are missing, or if the missing tasks were
    missing less often so far.

    fewer: after each plan without missing tasks a vehicle is closed. The steps end when no
        further vehicle can be closed.
    Returns the number of steps, at most `steps`.
    Source: Christiaens & Vanden Berghe 2020, Transportation Science 54(2).
    """
    _repair_tours(fleet, tours, step, memory, random)
    missing, _, heavy, cost, first, second = evaluate_tours(fleet, tours, absence)
    _store_best(tours, best, missing, heavy, first, second)
    for k in range(len(fleet.start)):
        store_route(fleet, tours, pool, k, 0)
    temperature = hot
    level = 0
    for now in range(1, steps + 1):
        if fewer and missing == 0:
            if not _close_vehicle(fleet, tours, step, memory, absence):
                return now
            missing, _, heavy, cost, _, _ = evaluate_tours(fleet, tours, absence)
        while level * steps < now * TEMPERATURE_LEVELS:
            temperature *= COOLING_FACTOR
            level += 1
        absent = _sum_absences(fleet, tours, absence) if missing > 0 else 0.0
        begin_step(step)
        if draw_fraction(random) < TAIL_EXCHANGE.step_probability:
            exchange_tails(fleet, tours, step, memory, random)
        else:
            remove_strings(fleet, tours, step, random, average)
        insert_missing_tasks(fleet, tours, step, memory, random)
        new_missing, new_absent, new_heavy, new_cost, first, second = evaluate_tours(
            fleet, tours, absence
        )
        accepted = _is_accepted(
            (missing, absent, heavy, cost),
            (new_missing, new_absent, new_heavy, new_cost),
            temperature,
            random,
        )
        if new_missing > 0:
            _count_absence(fleet, tours, absence)
        if not accepted:
            restore_routes(fleet, tours, step)
            continue
        missing = new_missing
        heavy = new_heavy
        cost = new_cost
        for t in range(step.counts[0]):
            store_route(fleet, tours, pool, step.touched[t], now)
        if missing < best.score[0] or (
            missing == best.score[0]
            and (fewer or _improves_best(best, heavy, first, second))
        ):
            _store_best(tours, best, missing, heavy, first, second)
    return steps


@kernel(**KERNEL_OPTIONS)
def _repair_tours(
    fleet: Any, tours: Any, step: Any, memory: Any, random: Words
) -> None:
    """Empty the infeasible routes, and insert all tasks without a vehicle."""
    for k in range(len(fleet.start)):
        refresh_route(fleet, tours, k)
        if tours.stops[k] > 0 and not is_route_feasible(fleet, tours, k):
            empty_route(fleet, tours, step, k)
    begin_step(step)
    insert_missing_tasks(fleet, tours, step, memory, random)


@kernel(**KERNEL_OPTIONS)
def _is_accepted(old: Any, new: Any, temperature: float, random: Words) -> Any:
    """Return whether a new plan replaces the present one, as described in `anneal_tours`.

    old, new: the first four values of `evaluate_tours`, of the present plan and of the new one.
    temperature: T.
    """
    missing, absent, heavy, cost = old
    new_missing, new_absent, new_heavy, new_cost = new
    if new_missing < missing or new_absent < absent:
        return True
    if new_missing > missing or new_absent > absent:
        return False
    if new_heavy != heavy:
        return new_heavy < heavy
    return new_cost < cost + temperature * draw_exponential(random)


@kernel(**KERNEL_OPTIONS)
def draw_exponential(random: Words) -> float:
    """Return -ln U for a uniform U, by sums and products alone, so that every machine rounds alike.

    -ln u = n ln 2 - 2 (s + s^3 / 3 + s^5 / 5 + ...),   s = (2^n u - 1) / (2^n u + 1),   1/2 <=
    2^n u < 1
    """
    u = draw_fraction(random)
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
    return doublings * NATURAL_LOG_OF_2 - 2.0 * total


@kernel(_nrt=False)
def evaluate_tours(fleet: Any, tours: Any, absence: Vec) -> Any:
    """Return six values that evaluate a plan.

    1. The number of missing tasks that must be served.
    2. How often these tasks were missing so far.
    3. The value that comes before all lengths. If vehicles are counted, it is the sum of their
       fixed costs, which are all alike, and of the penalties. The same number of vehicles and of
       refused tasks then gives the same value, to the last bit. Otherwise it is 0.
    4. The cost that is annealed.
    5. The first value by which plans are then compared.
    6. The second such value, for plans that are equal in the first.
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


@kernel(**KERNEL_OPTIONS)
def _sum_absences(fleet: Any, tours: Any, absence: Vec) -> float:
    """Return the sum over the missing tasks of how often they were missing so far."""
    absent = 0.0
    for j in range(len(fleet.load)):
        if tours.at[j] < 0 and fleet.penalty[j] == np.inf:
            absent += absence[j]
    return absent


@kernel(**KERNEL_OPTIONS)
def _count_absence(fleet: Any, tours: Any, absence: Vec) -> None:
    for j in range(len(fleet.load)):
        if tours.at[j] < 0:
            absence[j] += 1.0


@kernel(**KERNEL_OPTIONS)
def _improves_best(best: Any, heavy: float, first: float, second: float) -> Any:
    """Return whether the values of a plan are less than those of the best plan, in order."""
    if heavy != best.score[1]:
        return heavy < best.score[1]
    if first < best.score[2] - TIE_TOLERANCE:
        return True
    return first <= best.score[2] and second < best.score[3] - TIE_TOLERANCE


@kernel(_nrt=False)
def _store_best(
    tours: Any, best: Any, missing: int, heavy: float, first: float, second: float
) -> None:
    """Store the present plan as the best one."""
    best.score[0] = missing
    best.score[1] = heavy
    best.score[2] = first
    best.score[3] = second
    for k in range(len(tours.stops)):
        best.stops[k] = tours.stops[k]
        for pos in range(tours.stops[k] + 2):
            best.stop[k, pos] = tours.stop[k, pos]


@kernel(_nrt=False)
def _close_vehicle(
    fleet: Any, tours: Any, step: Any, memory: Any, absence: Vec
) -> bool:
    """Close all empty vehicles and one more, which is emptied; return False if there is none.

    The additional vehicle is the vehicle with the tasks that were missing least often. A vehicle
    with goods aboard must leave.
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
    empty_route(fleet, tours, step, victim)
    return True
