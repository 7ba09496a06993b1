"""Subset rows: cuts that make the linear relaxation of the set partitioning tighter."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import permutations
from typing import Any, NamedTuple

import numpy as np

from crazychoir.numerics.kernels import kernel
from crazychoir.types import Ints, Vec, Words


class SubsetRow(NamedTuple):
    """An inequality that every plan satisfies.

        sum_c floor(w(S in c) / d) x_c <= floor(w(S) / d)

    S: some tasks and robots with whole weights w. S in c: those in column c.
    It follows from the rows "task j is served at most once" and "robot i flies at most one route":
    their sum, weighed by w / d, with both sides rounded down.
    Source: Jepsen, Petersen, Spoorendonk & Pisinger 2008, Operations Research 56(2), for w = 1 and
    d = 2; Pecin, Pessoa, Poggi, Uchoa & Santos 2017, Operations Research Letters 45(3), for other
    weights.
    """

    tasks: tuple[int, ...]
    """Tasks of S, increasing."""
    robots: tuple[int, ...] = ()
    """Robots of S, each without an identical robot."""
    weights: tuple[int, ...] = ()
    """w of the tasks, then of the robots, 1 to 3; all are 1 if it is empty."""
    divisor: int = 2
    """d."""

    @property
    def limit(self) -> int:
        """Right-hand side."""
        members = len(self.tasks) + len(self.robots)
        return (sum(self.weights) or members) // self.divisor

    def coefficient(self, robot: int, tasks: Sequence[int]) -> int:
        """Return the coefficient of a column; 0 for the idle column."""
        served = set(tasks)
        if not served:
            return 0
        held = [j in served for j in self.tasks] + [i == robot for i in self.robots]
        weights = self.weights or (1,) * len(held)
        return (
            sum(w for w, has in zip(weights, held, strict=True) if has) // self.divisor
        )


class RowCharges(NamedTuple):
    """What the subset rows charge for the routes of one robot."""

    mask: Words
    """(R, 4) words: the tasks of odd weight, then the tasks of weight 2 or 3, in two words each.

    Tasks are numbered among the robot's own tasks.
    """
    extra: Ints
    """(R,): weight of the robot, 0 if it is not in the row."""
    divisor: Ints
    """(R,)."""
    price: Vec
    """(R,) m."""


@dataclass(frozen=True)
class PricedRows:
    """Subset rows with their prices."""

    rows: tuple[SubsetRow, ...] = ()
    """The rows."""
    price: tuple[float, ...] = ()
    """m >= 0: cost of each unit of the left-hand side."""

    @property
    def value(self) -> float:
        """m <= 0: what the rows add to a Lagrangian bound, without their effect on the routes."""
        return -math.fsum(
            row.limit * price for row, price in zip(self.rows, self.price, strict=True)
        )

    def charge(self, robot: int, tasks: Sequence[int]) -> float:
        """Return what the rows add to the reduced cost of a column, m >= 0."""
        return math.fsum(
            price * row.coefficient(robot, tasks)
            for row, price in zip(self.rows, self.price, strict=True)
        )

    def charges(self, robot: int, servable: Ints) -> RowCharges:
        """Return the rows for the routes of a robot.

        servable: the tasks that the robot can serve, increasing.
        """
        place = {int(j): k for k, j in enumerate(servable)}
        mask = np.zeros((len(self.rows), 4), np.uint64)
        extra = np.zeros(len(self.rows), np.int64)
        for r, row in enumerate(self.rows):
            weights = row.weights or (1,) * (len(row.tasks) + len(row.robots))
            for j, weight in zip(row.tasks, weights, strict=False):
                if j in place:
                    k = place[j]
                    bit = np.uint64(1) << np.uint64(k & 63)
                    for part in range(2):
                        if weight >> part & 1:
                            mask[r, 2 * part + (k >> 6)] |= bit
            if robot in row.robots:
                extra[r] = weights[len(row.tasks) + row.robots.index(robot)]
        divisor = np.array([row.divisor for row in self.rows], np.int64)
        return RowCharges(mask, extra, divisor, np.array(self.price, float))

    def pack(self) -> list[Any]:
        """Return the rows for a message."""
        return [
            [
                [list(row.tasks), list(row.robots), list(row.weights), row.divisor]
                for row in self.rows
            ],
            np.array(self.price, float),
        ]

    @staticmethod
    def unpack(parts: Sequence[Any]) -> "PricedRows":
        """Return the rows that `pack` coded."""
        rows = tuple(
            SubsetRow(
                tuple(map(int, tasks)),
                tuple(map(int, robots)),
                tuple(map(int, weights)),
                int(divisor),
            )
            for tasks, robots, weights, divisor in parts[0]
        )
        return PricedRows(rows, tuple(np.asarray(parts[1], float).tolist()))


NO_ROWS = PricedRows()


@dataclass(frozen=True, slots=True)
class RowSearch:
    """How violated rows are searched."""

    least: float = 0.02
    """Violation, at least."""
    most_each: int = 5
    """Rows of one kind with the same task or robot, at most."""
    near: int = 14
    """Tasks and robots that are tried beside another one, by how many columns they share."""


ROW_SEARCH = RowSearch()
ROW_KINDS = (
    (3, (2, 1, 1, 1)),
    (2, (1, 1, 1, 1, 1)),
    (3, (1, 1, 1, 1, 1)),
    (4, (2, 2, 1, 1, 1)),
    (4, (3, 1, 1, 1, 1)),
    (5, (3, 2, 2, 1, 1)),
)
"""Divisor and weights of the rows with four or five members."""


def find_violated_rows(
    columns: Sequence[tuple[int, tuple[int, ...]]],
    parts: Vec,
    single: Sequence[int],
    most: int,
) -> list[SubsetRow]:
    """Return subset rows that a fractional solution violates: of each kind, the most violated.

    Rows of three members are found exactly. Rows of more members are searched only if there are few
    of these, among members that share columns.

    columns: (robot, tasks) of each column in use.
    parts: (n,), x of each column.
    single: robots without an identical robot; only these can be in a row.
    most: rows, at most.
    """
    tasks = sorted({j for _, served in columns for j in served})
    robots = sorted({i for i, _ in columns} & set(single))
    place = {j: k for k, j in enumerate(tasks)}
    place_of = {i: len(tasks) + k for k, i in enumerate(robots)}
    e = len(place) + len(place_of)
    held = np.zeros((len(columns), e), np.int64)
    for c, (i, served) in enumerate(columns):
        held[c, [place[j] for j in served]] = 1
        if i in place_of:
            held[c, place_of[i]] = 1
    found = _find_triples(held, parts, most)
    if len(found) < most // 2 and e >= 5:
        found += _find_larger(held, parts, most)
    rows = []
    for members, weights, divisor in found[:most]:
        weight = dict(zip(members, weights, strict=True))
        order = sorted(members)
        plain = set(weights) == {1}
        rows.append(
            SubsetRow(
                tuple(tasks[p] for p in order if p < len(tasks)),
                tuple(robots[p - len(tasks)] for p in order if p >= len(tasks)),
                () if plain else tuple(weight[p] for p in order),
                divisor,
            )
        )
    return rows


_Found = list[tuple[tuple[int, ...], tuple[int, ...], int]]
"""Members, their weights, and the divisor of each row."""


def _find_triples(held: Ints, parts: Vec, most: int) -> _Found:
    """Return the most violated rows of three members; held: (n, e), 1 if column c has member k."""
    e = held.shape[1]
    pair = np.zeros((e, e))
    triple = np.zeros((e, e, e))
    for own, x in zip(held, parts, strict=True):
        at = np.flatnonzero(own)
        pair[np.ix_(at, at)] += x
        triple[np.ix_(at, at, at)] += x
    left = pair[:, :, None] + pair[:, None, :] + pair[None, :, :] - 2.0 * triple
    k = np.arange(e)
    left[(k[:, None, None] >= k[:, None]) | (k[:, None] >= k)] = 0.0
    flat = left.ravel()
    found = np.flatnonzero(flat > 1.0 + ROW_SEARCH.least)
    members = np.column_stack(np.unravel_index(found, left.shape))
    return [
        (chosen, (1, 1, 1), 2) for chosen in _choose_rows(members, flat[found], e, most)
    ]


def _find_larger(held: Ints, parts: Vec, most: int) -> _Found:
    """Return violated rows of four or five members."""
    e = held.shape[1]
    shared = (held * parts[:, None]).T @ held
    np.fill_diagonal(shared, -1.0)
    order = np.argsort(-np.round(shared, 9), axis=1, kind="stable")
    near = order[:, : min(ROW_SEARCH.near, e - 1)]
    found: _Found = []
    for divisor, weights in ROW_KINDS:
        limit = sum(weights) // divisor
        others = sorted(set(permutations(weights[1:])), reverse=True)
        arranged = np.zeros((len(others), 4), np.int64)
        arranged[:, : len(weights) - 1] = others
        members, value = _search_larger(
            held, parts, near, weights[0], arranged, divisor, limit + ROW_SEARCH.least
        )
        if not len(value):
            continue
        size = len(weights)
        rank = np.lexsort((*members.T, -np.round(value - limit, 9)))
        seen: set[frozenset[tuple[int, int]]] = set()
        used = np.zeros(e, np.int64)
        for row in members[rank].tolist():
            chosen = tuple(row[:size])
            given = tuple(row[5 : 5 + size])
            name = frozenset(zip(chosen, given, strict=True))
            if name in seen or used[list(chosen)].max() >= ROW_SEARCH.most_each:
                continue
            seen.add(name)
            used[list(chosen)] += 1
            found.append((chosen, given, divisor))
            if len(seen) >= most // 2:
                break
    return found


def _choose_rows(members: Ints, left: Vec, e: int, most: int) -> list[tuple[int, ...]]:
    """Return the rows with the largest left-hand sides, few of them with the same member."""
    used = np.zeros(e, np.int64)
    chosen: list[tuple[int, ...]] = []
    for row in members[np.argsort(-np.round(left, 9), kind="stable")].tolist():
        if len(chosen) == most:
            break
        if used[row].max() < ROW_SEARCH.most_each:
            used[row] += 1
            chosen.append(tuple(row))
    return chosen


@kernel(nogil=True)
def _search_larger(
    held: Ints,
    parts: Vec,
    near: Ints,
    first: int,
    arranged: Ints,
    divisor: int,
    above: float,
) -> tuple[Ints, Vec]:
    """Return (n, 10) members and weights, and (n,) left-hand sides larger than `above`.

    Each member with weight `first` is tried with each four of its near members.
    arranged: (A, 4), weights of the others; a weight of 0 leaves the last one out.
    """
    room = 20_000
    out = np.zeros((room, 10), np.int64)
    value = np.zeros(room)
    n = 0
    k = near.shape[1]
    has_four = arranged[0, 3] > 0
    for a in range(len(near)):
        for p in range(k):
            for q in range(p + 1, k):
                for r in range(q + 1, k):
                    for s in range(r + 1 if has_four else k - 1, k):
                        for arrangement in range(len(arranged)):
                            w = arranged[arrangement]
                            total = 0.0
                            for c in range(len(parts)):
                                weight = (
                                    first * held[c, a]
                                    + w[0] * held[c, near[a, p]]
                                    + w[1] * held[c, near[a, q]]
                                    + w[2] * held[c, near[a, r]]
                                    + w[3] * held[c, near[a, s]]
                                )
                                if weight >= divisor:
                                    total += parts[c] * (weight // divisor)
                            if total > above and n < room:
                                out[n, 0] = a
                                out[n, 1] = near[a, p]
                                out[n, 2] = near[a, q]
                                out[n, 3] = near[a, r]
                                out[n, 4] = near[a, s]
                                out[n, 5] = first
                                out[n, 6:10] = w
                                value[n] = total
                                n += 1
    return out[:n], value[:n]
