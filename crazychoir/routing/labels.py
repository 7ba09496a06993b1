"""Label setting over routes: the compiled kernel of exact route pricing.

A label is a path from home: (picked P, on board O, last stop); of two labels with the same three only
the shorter can be part of a shortest route, so only it is kept. Sets are two words of 64 bits.
"""

from typing import Any

import numpy as np
import numpy.typing as npt
from numba import njit

from crazychoir.types import Mat, Vec

Words = npt.NDArray[np.uint64]
Ints = npt.NDArray[np.int64]
Problem = tuple[Mat, Vec, float, float]
ONE = np.uint64(1)
SPREAD = (np.uint64(0x9E3779B97F4A7C15), np.uint64(0xC2B2AE3D27D4EB4F), np.uint64(0x165667B19E3779F9))
SHIFT = np.uint64(29)
MOST_TASKS = 128
"""Bits of the two words of a set."""


@njit(nogil=True, cache=True)
def _slot(table: Ints, keys: Words, last: Ints, p0: Any, p1: Any, o0: Any, o1: Any, at: Any) -> Any:
    """Where a label is, or would be, in the open-addressing table."""
    mask = len(table) - 1
    h = (p0 * SPREAD[0]) ^ (o0 * SPREAD[1]) ^ ((p1 + np.uint64(at)) * SPREAD[2]) ^ (o1 * SPREAD[0] + SPREAD[1])
    h ^= h >> SHIFT
    h *= SPREAD[1]
    h ^= h >> SHIFT
    k = np.int64(h & np.uint64(mask))
    while True:
        i = table[k]
        if i < 0:
            return k
        if keys[i, 0] == p0 and keys[i, 1] == p1 and keys[i, 2] == o0 and keys[i, 3] == o1 and last[i] == at:
            return k
        k = (k + 1) & mask


@njit(nogil=True, cache=True)
def _rehashed(size: int, keys: Words, last: Ints, count: int) -> Ints:
    table = np.full(size, -1, dtype=np.int64)
    for i in range(count):
        table[_slot(table, keys, last, keys[i, 0], keys[i, 1], keys[i, 2], keys[i, 3], last[i])] = i
    return table


@njit(nogil=True, cache=True)
def _doubled(values: Any) -> Any:
    return np.concatenate((values, np.zeros_like(values)))


@njit(nogil=True, cache=True)
def _inside(words: Words, row: int, first: int, j: int) -> bool:
    """Whether bit j is set in the two words of `row` that begin at column `first`."""
    return bool(words[row, first + (j >> 6)] >> np.uint64(j & 63) & ONE)


@njit(nogil=True, cache=True)
def _fits(distance: Mat, load: Vec, keys: Words, row: int, stop: int, room: float, so_far: float, limit: float) -> bool:
    """Whether label `row` may go on to `stop`: capacity, and a way home by each delivery due within the limit."""
    m = len(load)
    j = stop % m
    if stop < m and load[j] > room:
        return False
    rest = distance[stop, 2 * m] if stop >= m else distance[stop, m + j] + distance[m + j, 2 * m]
    if so_far + rest > limit:
        return False
    for k in range(m):
        if k != j and _inside(keys, row, 2, k) and so_far + distance[stop, m + k] + distance[m + k, 2 * m] > limit:
            return False
    return True


@njit(nogil=True, cache=True)
def _after(keys: Words, row: int, stop: int, m: int) -> tuple[int, int, int, int]:
    """The two words of P and of O after `stop`."""
    p0, p1, o0, o1 = keys[row, 0], keys[row, 1], keys[row, 2], keys[row, 3]
    j = stop % m
    bit = ONE << np.uint64(j & 63)
    if stop < m:
        return (p0 | bit, p1, o0 | bit, o1) if j < 64 else (p0, p1 | bit, o0, o1 | bit)
    return (p0, p1, o0 & ~bit, o1) if j < 64 else (p0, p1, o0, o1 & ~bit)


@njit(nogil=True, cache=True)
def grow_labels(problem: Problem, most: int) -> tuple[Words, Ints, Vec, Ints, bool]:
    """All undominated labels, in breadth-first order: keys (n, 4), last (n,), length (n,), parent (n,), complete.

    problem: distance (2m + 1, 2m + 1) m of pickups, deliveries, home; load (m,), m <= MOST_TASKS; capacity; limit m.
    most: labels.
    Label 0 is home with nothing done; its `last` is 2m. Every step adds a stop, so a label is final when its turn
    comes. Beyond `most` labels no new one is made and `complete` is False.
    """
    distance, load, capacity, limit = problem
    m, room = len(load), 1024
    keys, last, parent = np.zeros((room, 4), np.uint64), np.zeros(room, np.int64), np.full(room, -1, np.int64)
    length, held, table = np.zeros(room), np.zeros(room), np.full(4 * room, -1, np.int64)
    last[0], count, i, complete = 2 * m, 1, 0, True
    while i < count:
        for stop in range(2 * m):
            if _inside(keys, i, 0, stop) if stop < m else not _inside(keys, i, 2, stop - m):
                continue
            so_far = length[i] + distance[last[i], stop]
            if not _fits(distance, load, keys, i, stop, capacity - held[i], so_far, limit):
                continue
            p0, p1, o0, o1 = _after(keys, i, stop, m)
            k = _slot(table, keys, last, p0, p1, o0, o1, stop)
            n = table[k]
            if n >= 0:
                if so_far < length[n]:
                    length[n], parent[n] = so_far, i
            elif count >= most:
                complete = False
            else:
                keys[count, 0], keys[count, 1], keys[count, 2], keys[count, 3] = p0, p1, o0, o1
                last[count], length[count], parent[count], table[k] = stop, so_far, i, count
                held[count] = held[i] + (load[stop] if stop < m else -load[stop - m])
                count += 1
                if count == len(last):
                    keys, last, parent = _doubled(keys), _doubled(last), _doubled(parent)
                    length, held = _doubled(length), _doubled(held)
                    table = _rehashed(2 * len(table), keys, last, count)
        i += 1
    return keys[:count], last[:count], length[:count], parent[:count], complete


@njit(nogil=True, cache=True)
def reduced_costs(length: Vec, start: Ints, task: Ints, prices: Vec) -> Vec:
    """(n,) length_c - sum of the prices of the tasks start[c]:start[c + 1] of column c."""
    out = np.empty(len(length))
    for c in range(len(length)):
        worth = 0.0
        for k in range(start[c], start[c + 1]):
            worth += prices[task[k]]
        out[c] = length[c] - worth
    return out
