"""Label setting for routes that differ only by their length: the compiled kernel of exact pricing.

A label is a path from the start: (picked P, on board O, last stop). Of two labels that agree in
these three, only the shorter can be part of a shortest route, so only it is kept. Sets are
two words of 64 bits.
"""

from typing import Any

import numpy as np

from crazychoir.numerics.kernels import kernel
from crazychoir.types import Bools, Ints, Mat, Vec, Words

ONE_BIT = np.uint64(1)
HASH_MULTIPLIERS = (
    np.uint64(0x9E3779B97F4A7C15),
    np.uint64(0xC2B2AE3D27D4EB4F),
    np.uint64(0x165667B19E3779F9),
)
"""Odd multipliers that spread the bits of a key over the hash."""
HASH_SHIFT = np.uint64(29)
"""Shift of the hash."""
MOST_TASKS = 128
"""Largest number of tasks: the bits of the two words of a set."""


@kernel()
def find_slot(
    table: Ints, keys: Words, last: Ints, p0: Any, p1: Any, o0: Any, o1: Any, at: Any
) -> Any:
    """Return the place in the open-addressing table where a label is, or would be."""
    mask = len(table) - 1
    h = (
        (p0 * HASH_MULTIPLIERS[0])
        ^ (o0 * HASH_MULTIPLIERS[1])
        ^ ((p1 + np.uint64(at)) * HASH_MULTIPLIERS[2])
        ^ (o1 * HASH_MULTIPLIERS[0] + HASH_MULTIPLIERS[1])
    )
    h ^= h >> HASH_SHIFT
    h *= HASH_MULTIPLIERS[1]
    h ^= h >> HASH_SHIFT
    k = np.int64(h & np.uint64(mask))
    while True:
        i = table[k]
        if i < 0:
            return k
        if (
            keys[i, 0] == p0
            and keys[i, 1] == p1
            and keys[i, 2] == o0
            and keys[i, 3] == o1
            and last[i] == at
        ):
            return k
        k = (k + 1) & mask


@kernel()
def _rebuild_label_table(size: int, keys: Words, last: Ints, count: int) -> Ints:
    table = np.full(size, -1, dtype=np.int64)
    for i in range(count):
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
def double_length(values: Any) -> Any:
    """Return the values, followed by as many zeros."""
    return np.concatenate((values, np.zeros_like(values)))


@kernel()
def has_bit(words: Words, row: int, first: int, j: int) -> bool:
    """Return whether bit j is set in the two words of `row` that begin at column `first`."""
    return bool(words[row, first + (j >> 6)] >> np.uint64(j & 63) & ONE_BIT)


@kernel()
def list_set(words: Words, row: int, first: int, m: int, out: Ints) -> int:
    """Write the set of `row` into `out`, increasing; return its size."""
    n = 0
    for part in range(2):
        rest = words[row, first + part]
        j = 64 * part
        while rest != 0 and j < m:
            if rest & ONE_BIT:
                out[n] = j
                n += 1
            rest >>= ONE_BIT
            j += 1
    return n


@kernel()
def extend_sets(keys: Words, row: int, stop: int, m: int) -> tuple[Any, Any, Any, Any]:
    """Return the two words of P and of O after `stop`."""
    p0 = keys[row, 0]
    p1 = keys[row, 1]
    o0 = keys[row, 2]
    o1 = keys[row, 3]
    j = stop % m
    bit = ONE_BIT << np.uint64(j & 63)
    if stop < m:
        return (p0 | bit, p1, o0 | bit, o1) if j < 64 else (p0, p1 | bit, o0, o1 | bit)
    return (p0, p1, o0 & ~bit, o1) if j < 64 else (p0, p1, o0, o1 & ~bit)


@kernel()
def initialise_label(keys: Words, held: Vec, load: Vec, aboard: Bools) -> None:
    """Initialise label 0: at the start, with the goods that are aboard."""
    for j in range(len(load)):
        if aboard[j]:
            bit = ONE_BIT << np.uint64(j & 63)
            keys[0, j >> 6] |= bit
            keys[0, 2 + (j >> 6)] |= bit
            held[0] += load[j]


@kernel()
def _is_in_reach(
    rest: Mat, home: Vec, stop: int, on: Ints, count: int, so_far: float, limit: float
) -> bool:
    """Return whether the end can be reached from `stop` over each due delivery within the limit."""
    m = rest.shape[1]
    j = stop % m
    if so_far + (rest[stop, j] if stop < m else home[stop]) > limit:
        return False
    for n in range(count):  # noqa: SIM110  # a kernel
        if on[n] != j and so_far + rest[stop, on[n]] > limit:
            return False
    return True


@kernel(nogil=True)
def grow_labels(
    distance: Mat,
    rest: Mat,
    home: Vec,
    load: Vec,
    aboard: Bools,
    capacity: float,
    limit: float,
    far: float,
    most: int,
) -> tuple[Words, Ints, Vec, Ints, bool]:
    """Compute all undominated labels, in breadth-first order.

    distance: (2m + 2, 2m + 2) m, between pickups, deliveries, start, end.
    rest: (2m, m) m, lower bound of the way from a stop over delivery k to the end.
    home: (2m,) m, lower bound of the way to the end.
    load: (m,), m <= MOST_TASKS.
    aboard: (m,), goods on board at the start.
    capacity: units of load.
    limit: m.
    far: m, largest length of a label, the limit or less.
    most: labels, at most.
    Returns keys (n, 4), last (n,), length (n,), parent (n,), complete.
    Label 0 is the start with the goods aboard; its `last` is 2m. Every step adds a stop, so a label
    is final when its turn comes. Beyond `most` labels no new one is made and `complete` is False.
    """
    m = len(load)
    room = 1024
    keys = np.zeros((room, 4), np.uint64)
    last = np.zeros(room, np.int64)
    parent = np.full(room, -1, np.int64)
    length = np.zeros(room)
    held = np.zeros(room)
    table = np.full(4 * room, -1, np.int64)
    on = np.zeros(m, np.int64)
    initialise_label(keys, held, load, aboard)
    last[0] = 2 * m
    count = 1
    i = 0
    complete = True
    while i < count:
        goods = list_set(keys, i, 2, m, on)
        for option in range(m + goods):
            stop = option if option < m else m + on[option - m]
            if stop < m and (
                has_bit(keys, i, 0, stop) or load[stop] > capacity - held[i]
            ):
                continue
            so_far = length[i] + distance[last[i], stop]
            if so_far > far or not _is_in_reach(
                rest, home, stop, on, goods, so_far, limit
            ):
                continue
            p0, p1, o0, o1 = extend_sets(keys, i, stop, m)
            k = find_slot(table, keys, last, p0, p1, o0, o1, stop)
            n = table[k]
            if n >= 0:
                if so_far < length[n]:
                    length[n] = so_far
                    parent[n] = i
            elif count >= most:
                complete = False
            else:
                keys[count, 0] = p0
                keys[count, 1] = p1
                keys[count, 2] = o0
                keys[count, 3] = o1
                last[count] = stop
                length[count] = so_far
                parent[count] = i
                table[k] = count
                held[count] = held[i] + (load[stop] if stop < m else -load[stop - m])
                count += 1
                if count == len(last):
                    keys = double_length(keys)
                    last = double_length(last)
                    parent = double_length(parent)
                    length = double_length(length)
                    held = double_length(held)
                    table = _rebuild_label_table(2 * len(table), keys, last, count)
        i += 1
    return keys[:count], last[:count], length[:count], parent[:count], complete


@kernel(nogil=True)
def compute_reduced_costs(length: Vec, start: Ints, task: Ints, prices: Vec) -> Vec:
    """Return (n,): length_c - sum of the prices of the tasks start[c]:start[c + 1] of column c."""
    out = np.empty(len(length))
    for c in range(len(length)):
        worth = 0.0
        for k in range(start[c], start[c + 1]):
            worth += prices[task[k]]
        out[c] = length[c] - worth
    return out
