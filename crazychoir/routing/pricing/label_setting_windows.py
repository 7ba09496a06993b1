"""Label setting for routes with windows and several trips: the compiled kernel beside labels.py.

A label is a path from the start: (picked P, on board O, last stop) with cost, time, what is left
of the limit of its trip, and the trips begun. Of two labels that agree in the first three, a label
that is no better in any of the four is dropped.
"""

from typing import Any, NamedTuple

import numpy as np

from crazychoir.numerics.kernels import kernel
from crazychoir.routing.pricing.labels import (
    double_length,
    extend_sets,
    find_slot,
    has_bit,
    initialise_label,
    list_set,
)
from crazychoir.types import Bools, Ints, Mat, Vec, Words

DOMINANCE_ROUNDING = 1e-11
"""m and s: differences below this are rounding; far below ROUNDING_SLACK."""


class LabelEntries(NamedTuple):
    """Entries of the state of a label."""

    cost: int = 0
    """Index of the cost, m."""
    time: int = 1
    """Index of the time, s."""
    distance_left: int = 2
    """Index of what is left of the limit of its trip, m."""
    trips: int = 3
    """Index of the number of trips begun."""


LABEL_ENTRIES = LabelEntries()


@kernel()
def read_label_state(state: Mat, n: int) -> Any:
    """Return the state of label n."""
    return (
        state[n, LABEL_ENTRIES.cost],
        state[n, LABEL_ENTRIES.time],
        state[n, LABEL_ENTRIES.distance_left],
        state[n, LABEL_ENTRIES.trips],
    )


@kernel()
def is_as_good(a: Any, b: Any, by: Bools) -> bool:
    """Return whether state a is at least as good as state b in every entry that counts."""
    return bool(
        (
            not by[LABEL_ENTRIES.cost]
            or a[LABEL_ENTRIES.cost] <= b[LABEL_ENTRIES.cost] + DOMINANCE_ROUNDING
        )
        and (
            not by[LABEL_ENTRIES.time]
            or a[LABEL_ENTRIES.time] <= b[LABEL_ENTRIES.time] + DOMINANCE_ROUNDING
        )
        and (
            not by[LABEL_ENTRIES.distance_left]
            or a[LABEL_ENTRIES.distance_left]
            >= b[LABEL_ENTRIES.distance_left] - DOMINANCE_ROUNDING
        )
        and (
            not by[LABEL_ENTRIES.trips]
            or a[LABEL_ENTRIES.trips] <= b[LABEL_ENTRIES.trips]
        )
    )


@kernel()
def _add_front_label(
    table: Ints,
    keys: Words,
    last: Ints,
    state: Mat,
    after_it: Ints,
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
        if not dead[n] and is_as_good(read_label_state(state, n), mine, by):
            return False
        n = after_it[n]
    n = table[k]
    while n >= 0:
        if not dead[n] and is_as_good(mine, read_label_state(state, n), by):
            dead[n] = True
        n = after_it[n]
    if table[k] < 0:
        table[k] = new
        after_it[new] = -1
    else:  # the head stays, because the table finds the key by it
        after_it[new] = after_it[table[k]]
        after_it[table[k]] = new
    return True


@kernel()
def rebuild_hash_table(
    size: int, keys: Words, last: Ints, head: Bools, count: int
) -> Ints:
    """Return a table of `size` places with the heads of chains among the first `count` labels."""
    table = np.full(size, -1, dtype=np.int64)
    for i in range(count):
        if head[i]:
            table[
                find_slot(
                    table,
                    keys,
                    last,
                    keys[i, 0],
                    keys[i, 1],
                    keys[i, 2],
                    keys[i, 3],
                    last[i],
                )
            ] = i
    return table


@kernel()
def is_in_time(
    stop: int,
    on: Ints,
    goods: int,
    m: int,
    time: float,
    left: float,
    latest: Vec,
    shortest: Mat,
    fastest: Mat,
) -> bool:
    """Return whether each due delivery and the end can be reached in time, by lower bounds.

    The service at `stop` begins at `time`, and `left` m of the trip's limit remain.
    """
    end = 2 * m + 1
    if (
        time > latest[stop]
        or time + fastest[stop, end] > latest[end]
        or shortest[stop, end] > left
    ):
        return False
    for n in range(goods + 1):
        if stop >= m and (n == goods or on[n] == stop - m):
            continue
        k = m + (on[n] if n < goods else stop)
        due = time + fastest[stop, k]
        if due > latest[k] or due + fastest[k, end] > latest[end]:
            return False
        if shortest[stop, k] + shortest[k, end] > left:
            return False
    return True


@kernel(nogil=True)
def grow_fronts(
    distance: Mat,
    duration: Mat,
    shortest: Mat,
    fastest: Mat,
    earliest: Vec,
    latest: Vec,
    load: Vec,
    aboard: Bools,
    by: Bools,
    capacity: float,
    limit: float,
    limit_again: float,
    trips: int,
    most: int,
) -> tuple[Words, Ints, Mat, Ints, Bools, Bools, bool]:
    """Compute all labels that no other dominates, in breadth-first order.

    shortest: (2m + 2, 2m + 2) m, lower bounds of distance over any nodes.
    fastest: (2m + 2, 2m + 2) s, lower bounds of duration over any nodes.
    by: (4,), which of cost, time, left and trips count.
    capacity, limit, limit_again, latest: with their slack.
    The other arguments are those of Vehicle and grow_labels.

    Returns, in this order:
    keys: (n, 4).
    last: (n,).
    state: (n, 4): cost m, time s, left m, trips begun.
    parent: (n,).
    again: (n,), whether a new trip began before the last stop.
    dead: (n,), whether a later label dominates it.
    complete: whether no label was left out.
    """
    m = len(load)
    room = 1024
    end = 2 * m + 1
    keys = np.zeros((room, 4), np.uint64)
    last = np.zeros(room, np.int64)
    parent = np.full(room, -1, np.int64)
    state = np.zeros((room, 4))
    held = np.zeros(room)
    table = np.full(4 * room, -1, np.int64)
    chain = np.full(room, -1, np.int64)
    again = np.zeros(room, np.bool_)
    dead = np.zeros(room, np.bool_)
    head = np.zeros(room, np.bool_)
    on = np.zeros(m, np.int64)
    initialise_label(keys, held, load, aboard)
    last[0] = 2 * m
    state[0, LABEL_ENTRIES.time] = earliest[2 * m]
    state[0, LABEL_ENTRIES.distance_left] = limit
    state[0, LABEL_ENTRIES.trips] = 1.0
    count = 1
    i = 0
    complete = True
    while i < count:
        goods = 0 if dead[i] else list_set(keys, i, 2, m, on)
        ways = 2 if goods == 0 and state[i, LABEL_ENTRIES.trips] < trips else 1
        options = 0 if dead[i] else ways * m + goods
        for option in range(options):
            anew = option >= m + goods
            at = last[i]
            cost = state[i, LABEL_ENTRIES.cost]
            time = state[i, LABEL_ENTRIES.time]
            left = state[i, LABEL_ENTRIES.distance_left]
            trip = state[i, LABEL_ENTRIES.trips]
            stop = option - m if anew else option
            stop = m + on[option - m] if m <= option < m + goods else stop
            if stop < m and (
                has_bit(keys, i, 0, stop) or load[stop] > capacity - held[i]
            ):
                continue
            if anew:
                if distance[at, end] > left:
                    continue
                cost = cost + distance[at, end]
                time = max(time + duration[at, end], earliest[end])
                left = limit_again
                trip = trip + 1.0
                at = end
            cost = cost + distance[at, stop]
            left = left - distance[at, stop]
            time = max(time + duration[at, stop], earliest[stop])
            if not is_in_time(
                stop, on, goods, m, time, left, latest, shortest, fastest
            ):
                continue
            if count >= most:
                complete = False
                continue
            p0, p1, o0, o1 = extend_sets(keys, i, stop, m)
            k = find_slot(table, keys, last, p0, p1, o0, o1, stop)
            keys[count, 0] = p0
            keys[count, 1] = p1
            keys[count, 2] = o0
            keys[count, 3] = o1
            last[count] = stop
            parent[count] = i
            again[count] = anew
            dead[count] = False
            state[count, LABEL_ENTRIES.cost] = cost
            state[count, LABEL_ENTRIES.time] = time
            state[count, LABEL_ENTRIES.distance_left] = left
            state[count, LABEL_ENTRIES.trips] = trip
            held[count] = held[i] + (load[stop] if stop < m else -load[stop - m])
            head[count] = table[k] < 0
            if not _add_front_label(
                table, keys, last, state, chain, dead, k, count, by
            ):
                continue
            count += 1
            if count == len(last):
                keys = double_length(keys)
                last = double_length(last)
                parent = double_length(parent)
                state = double_length(state)
                held = double_length(held)
                chain = double_length(chain)
                again = double_length(again)
                dead = double_length(dead)
                head = double_length(head)
                table = rebuild_hash_table(2 * len(table), keys, last, head, count)
        i += 1
    return (
        keys[:count],
        last[:count],
        state[:count],
        parent[:count],
        again[:count],
        dead[:count],
        complete,
    )
