"""Label setting at given prices: the least reduced cost of a robot with too many routes to list.

A label is a path from the start. It has the set U of tasks that it can no longer pick up, the
set O on board, the last stop, reduced cost, time, what is left of its trip's limit, and the trips
begun. Label a is as good as b if O and the last stop are the same, U_a is part of U_b, and a is
no worse in the others: whatever completes b then completes a. A label is dropped if its cost,
with a lower bound of what may follow, is no less than the cost of the best route so far.
"""

from typing import Any

import numpy as np

from crazychoir.numerics.kernels import kernel
from crazychoir.routing.pricing.label_setting_windows import (
    LABEL_ENTRIES,
    is_as_good,
    is_in_time,
    read_label_state,
    rebuild_hash_table,
)
from crazychoir.routing.pricing.labels import (
    ONE_BIT,
    double_length,
    extend_sets,
    find_slot,
    initialise_label,
    list_set,
)
from crazychoir.types import Bools, Ints, Mat, Vec, Words

# Pieces of the kernel are inlined. They make no arrays, so that references are not counted.
PIECE_OPTIONS = {"forceinline": True, "_nrt": False}


@kernel()
def _is_subset(words: Words, a: int, b: int) -> bool:
    """Return whether the set of row a is part of the set of row b."""
    return bool((words[a, 0] & ~words[b, 0]) == 0 and (words[a, 1] & ~words[b, 1]) == 0)


@kernel()
def _add_priced_label(
    table: Ints,
    gone: Words,
    state: Mat,
    level: Ints,
    chain: Ints,
    dead: Bools,
    k: int,
    new: int,
    by: Bools,
) -> bool:
    """Add label `new` to the chain of slot k, unless a label there is as good.

    Labels of the chain that are no better than the new one are marked dead.
    Returns whether it was added.
    """
    mine = read_label_state(state, new)
    n = table[k]
    while n >= 0:
        if (
            not dead[n]
            and level[n] <= level[new]
            and is_as_good(read_label_state(state, n), mine, by)
            and _is_subset(gone, n, new)
        ):
            return False
        n = chain[n]
    n = table[k]
    while n >= 0:
        if (
            not dead[n]
            and level[n] >= level[new]
            and is_as_good(mine, read_label_state(state, n), by)
            and _is_subset(gone, new, n)
        ):
            dead[n] = True
        n = chain[n]
    if table[k] < 0:
        table[k] = new
        chain[new] = -1
    else:  # the head stays, because the table finds the key by it
        chain[new] = chain[table[k]]
        chain[table[k]] = new
    return True


@kernel()
def _bound_remainder(
    gone: Words,
    row: int,
    stop: int,
    on: Ints,
    goods: int,
    time: float,
    left: float,
    whole: float,
    latest: Vec,
    shortest: Mat,
    fastest: Mat,
    into: Vec,
    prices: Vec,
    order: Ints,
) -> float:
    """Return a lower bound on the reduced cost of what may follow, in m.

        min  sum_w into_w - sum_j price_j x_j
             over the due deliveries, the end, and both stops of each task j taken
        s.t. sum_w into_w <= whole,   0 <= x_j <= 1 (a part of a task is allowed)

    Tasks that are out of reach are added to `gone`.

    into: (2m + 2,) m, the shortest way into each node.
    left: m of this trip, inf if another trip may follow: a task out of reach now may then be
        reached later.
    whole: m of this and all further trips.
    """
    m = len(prices)
    end = 2 * m + 1
    due = into[end]
    for n in range(goods):
        due += into[m + on[n]]
    cost = due
    room = whole - due
    for n in range(m):
        j = order[n]
        if gone[row, j >> 6] >> np.uint64(j & 63) & ONE_BIT:
            continue
        there = time + fastest[stop, j]
        back = there + fastest[j, m + j]
        if (
            there > latest[j]
            or back > latest[m + j]
            or back + fastest[m + j, end] > latest[end]
            or shortest[stop, j] + shortest[j, m + j] + shortest[m + j, end] > left
        ):
            gone[row, j >> 6] |= ONE_BIT << np.uint64(j & 63)
            continue
        need = into[j] + into[m + j]
        if prices[j] > need and room > 0.0:
            share = 1.0 if need <= room else room / need
            cost -= share * (prices[j] - need)
            room -= share * need
    return float(cost)


@kernel()
def _keep_promising(
    guide: Vec, dead: Bools, first: int, count: int, width: int
) -> bool:
    """Keep the `width` most promising labels from `first` on.

    Returns whether any label was dropped.
    """
    alive = np.zeros(count - first)
    n = 0
    for i in range(first, count):
        if not dead[i]:
            alive[n] = guide[i]
            n += 1
    if n <= width:
        return False
    most = np.sort(alive[:n])[width - 1]
    for i in range(first, count):
        if guide[i] > most:
            dead[i] = True
    return True


@kernel(**PIECE_OPTIONS)
def _pay_for_goods_aboard(state: Mat, aboard: Bools, prices: Vec) -> None:
    """Subtract the prices of the goods that are aboard from the cost of label 0."""
    for j in range(len(prices)):
        if aboard[j]:
            state[0, LABEL_ENTRIES.cost] -= prices[j]


@kernel(**PIECE_OPTIONS)
def _may_stop(
    gone: Words,
    load: Vec,
    row: int,
    stop: int,
    room: float,
) -> bool:
    """Return whether the task of a pickup is not gone and fits aboard; True for a delivery.

    room: units of load that fit aboard the vehicle of label `row`.
    """
    m = len(load)
    if stop >= m:
        return True
    is_gone = gone[row, stop >> 6] >> np.uint64(stop & 63) & ONE_BIT
    return not (is_gone or load[stop] > room)


@kernel(**PIECE_OPTIONS)
def _extend_state(
    before: Any,
    at: int,
    stop: int,
    anew: bool,
    distance: Mat,
    duration: Mat,
    earliest: Vec,
    prices: Vec,
    limit_again: float,
) -> Any:
    """Return the state of a label at its next stop.

    before: its state, see LabelEntries.
    at: its last stop.
    stop: its next stop.
    anew: whether it ends its trip and begins another one before this stop.
    """
    m = len(prices)
    end = 2 * m + 1
    cost, time, left, trip = before
    if anew:
        cost = cost + distance[at, end]
        time = max(time + duration[at, end], earliest[end])
        left = limit_again
        trip = trip + 1.0
        at = end
    cost += distance[at, stop] - (prices[stop] if stop < m else 0.0)
    left -= distance[at, stop]
    time = max(time + duration[at, stop], earliest[stop])
    return cost, time, left, trip


@kernel(**PIECE_OPTIONS)
def _list_due_tasks(on: Ints, goods: int, stop: int, m: int, due: Ints) -> int:
    """Write the tasks on board after `stop` into `due`; return their number.

    on: the tasks on board before, the first `goods` entries.
    """
    j = stop % m
    waiting = 0
    for n in range(goods):
        if on[n] != j:
            due[waiting] = on[n]
            waiting += 1
    if stop < m:
        due[waiting] = j
        waiting += 1
    return waiting


@kernel(**PIECE_OPTIONS)
def _guide_label(
    shortest: Mat, cost: float, stop: int, due: Ints, waiting: int, m: int
) -> float:
    """Return a lower bound of the cost in m over each due delivery to the end, without prices."""
    end = 2 * m + 1
    bound = cost + shortest[stop, end]
    for n in range(waiting):
        bound = max(
            bound,
            cost + shortest[stop, m + due[n]] + shortest[m + due[n], end],
        )
    return float(bound)


@kernel(nogil=True)
def grow_priced_labels(
    distance: Mat,
    duration: Mat,
    shortest: Mat,
    fastest: Mat,
    earliest: Vec,
    latest: Vec,
    load: Vec,
    aboard: Bools,
    prices: Vec,
    into: Vec,
    order: Ints,
    memory: Words,
    by: Bools,
    capacity: float,
    limit: float,
    limit_again: float,
    trips: int,
    best: float,
    most: int,
    width: int,
) -> tuple[float, Ints, Vec, Ints, Ints, Bools, bool]:
    """Find the least reduced cost of a route that is not empty, and less than `best`.

    The cost excludes the fixed cost.

    prices: (m,) m.
    into: (2m + 2,) m, the shortest way into each node.
    order: (m,) tasks; tasks with a high price for their way come first.
    memory: (m, 2) words, the tasks that are remembered as done at a stop of task k. With all tasks,
        routes do not repeat a task.
    best: m, only routes below this count.
    most: labels, at most.
    width: labels of the same number of stops, at most.
    The other arguments are those of grow_fronts.

    Returns, in this order:
    best: that cost in m.
    ends: (n,), the labels that end a route.
    worths: (n,) m, the cost of these routes.
    last, parent, again: of all labels.
    exact: whether no label was dropped because there were too many.
    """
    m = len(load)
    room = 1024
    end = 2 * len(load) + 1
    zero = np.uint64(0)
    keys = np.zeros((room, 4), np.uint64)
    last = np.zeros(room, np.int64)
    parent = np.full(room, -1, np.int64)
    gone = np.zeros((room, 2), np.uint64)
    level = np.zeros(room, np.int64)
    state = np.zeros((room, 4))
    held = np.zeros(room)
    table = np.full(4 * room, -1, np.int64)
    chain = np.full(room, -1, np.int64)
    dead = np.zeros(room, np.bool_)
    head = np.zeros(room, np.bool_)
    guide = np.zeros(room)
    again = np.zeros(room, np.bool_)
    ends = np.zeros(room, np.int64)
    worths = np.zeros(room)
    on = np.zeros(m, np.int64)
    found = 0
    due = np.zeros(m, np.int64)
    initialise_label(keys, held, load, aboard)
    gone[0, 0] = keys[0, 0]
    gone[0, 1] = keys[0, 1]
    keys[0, 0] = zero
    keys[0, 1] = zero
    last[0] = 2 * m
    state[0, LABEL_ENTRIES.time] = earliest[2 * m]
    state[0, LABEL_ENTRIES.distance_left] = limit
    state[0, LABEL_ENTRIES.trips] = 1.0
    _pay_for_goods_aboard(state, aboard, prices)
    count = 1
    i = 0
    first = 1
    exact = True
    below = best
    while i < count:
        if i == first:  # a new number of stops begins
            exact = not _keep_promising(guide, dead, first, count, width) and exact
            first = count
        goods = 0 if dead[i] else list_set(keys, i, 2, m, on)
        ways = 2 if goods == 0 and state[i, LABEL_ENTRIES.trips] < trips else 1
        options = 0 if dead[i] or level[i] >= 2 * m else ways * m + goods
        for option in range(options):
            anew = option >= m + goods
            at = last[i]
            stop = option - m if anew else option
            stop = m + on[option - m] if m <= option < m + goods else stop
            if not _may_stop(gone, load, i, stop, capacity - held[i]):
                continue
            if anew and distance[at, end] > state[i, LABEL_ENTRIES.distance_left]:
                continue
            cost, time, left, trip = _extend_state(
                read_label_state(state, i),
                at,
                stop,
                anew,
                distance,
                duration,
                earliest,
                prices,
                limit_again,
            )
            if not is_in_time(
                stop, on, goods, m, time, left, latest, shortest, fastest
            ):
                continue
            _, _, o0, o1 = extend_sets(keys, i, stop, m)
            # Labels that differ only in what they have picked up share a key.
            p0 = zero
            p1 = zero
            keys[count, 0] = p0
            keys[count, 1] = p1
            keys[count, 2] = o0
            keys[count, 3] = o1
            j = stop % m
            bit = ONE_BIT << np.uint64(j & 63)
            gone[count, 0] = (
                (gone[i, 0] & memory[j, 0]) | o0 | (bit if j < 64 else zero)
            )
            gone[count, 1] = (
                (gone[i, 1] & memory[j, 1]) | o1 | (bit if j >= 64 else zero)
            )
            waiting = _list_due_tasks(on, goods, stop, m, due)
            follow = trips - trip
            promise = cost + _bound_remainder(
                gone,
                count,
                stop,
                due,
                waiting,
                time,
                np.inf if follow > 0 else left,
                left + (follow * limit_again if follow > 0 else 0.0),
                latest,
                shortest,
                fastest,
                into,
                prices,
                order,
            )
            if promise >= best:
                continue
            if count >= most:
                exact = False
                continue
            last[count] = stop
            parent[count] = i
            again[count] = anew
            dead[count] = False
            level[count] = level[i] + 1
            guide[count] = _guide_label(shortest, cost, stop, due, waiting, m)
            state[count, LABEL_ENTRIES.cost] = cost
            state[count, LABEL_ENTRIES.time] = time
            state[count, LABEL_ENTRIES.distance_left] = left
            state[count, LABEL_ENTRIES.trips] = trip
            held[count] = held[i] + (load[stop] if stop < m else -load[stop - m])
            k = find_slot(table, keys, last, p0, p1, o0, o1, stop)
            head[count] = table[k] < 0
            if not _add_priced_label(
                table, gone, state, level, chain, dead, k, count, by
            ):
                continue
            total = cost + distance[stop, end]
            finish = max(time + duration[stop, end], earliest[end])
            if (
                waiting == 0
                and total < below
                and distance[stop, end] <= left
                and finish <= latest[end]
            ):
                ends[found] = count
                worths[found] = total
                found = found + 1
                best = min(best, total)
            count += 1
            if count == len(last):
                keys = double_length(keys)
                last = double_length(last)
                parent = double_length(parent)
                state = double_length(state)
                held = double_length(held)
                chain = double_length(chain)
                dead = double_length(dead)
                head = double_length(head)
                gone = double_length(gone)
                level = double_length(level)
                guide = double_length(guide)
                again = double_length(again)
                ends = double_length(ends)
                worths = double_length(worths)
                table = rebuild_hash_table(2 * len(table), keys, last, head, count)
        i += 1
    return (
        best,
        ends[:found],
        worths[:found],
        last[:count],
        parent[:count],
        again[:count],
        exact,
    )
