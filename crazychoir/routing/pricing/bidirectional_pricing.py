"""Exact pricing of too many limited routes: list halves of routes and join them."""

from collections.abc import Collection
from copy import copy
from typing import Any, NamedTuple

import numpy as np

from crazychoir.numerics.kernels import kernel
from crazychoir.routing.instance.legs import Legs
from crazychoir.routing.instance.vehicle import ROUNDING_SLACK, Vehicle
from crazychoir.routing.pricing.label_setting import list_bits
from crazychoir.routing.pricing.labels import HASH_MULTIPLIERS, grow_labels
from crazychoir.routing.pricing.route_table import RouteColumn, restrict_vehicle
from crazychoir.routing.pricing.subset_rows import NO_ROWS, PricedRows
from crazychoir.types import Bools, Ints, Mat, Vec, Words

MOST_HALF_LABELS = 3_000_000
"""Largest number of labels of one half."""
MOST_PAIRS_OF_SET = 16
"""Largest number of pairs of halves that are listed for each column that is asked for.

Many pairs make routes with the same tasks, often some ten of them.
"""


class _HalfLabels(NamedTuple):
    """Labels in the order of their groups.

    Labels of one group have the same goods on board, apart from hash collisions.
    """

    keys: Words
    """(n, 4) words: the tasks with a stop on the label, and the tasks on board at its open end."""
    length: Vec
    """(n,) m."""
    open: Ints
    """(n,): the node at the open end."""
    start: Ints
    """(G + 1,): where groups begin."""


class HalfRoutes:
    """All routes of one robot, each as two halves.

    Pricing is exact, as with a RouteTable, which would be too large.

        reduced cost of a route at prices pi = cost_a + way from a to b + cost_b
        cost_a = length_a - sum of pi_j picked up on a
        cost_b = length_b - sum of pi_j picked up on b

    a: the path from the start as long as it is within half of the limit, by the labels of
        labels.py.
    b: the path from the next stop to the end, by the same labels of the route flown backwards.

    Two halves fit if
    - the goods on board after a are exactly the goods that b delivers but does not pick up,
    - they have no other task in common, and
    - the route is within the limit.

    This needs about the square root of the number of labels of whole routes. It works for robots
    with a limit, one trip, no windows and nothing aboard; `fits` checks this.

    vehicle: the robot.
    most: labels of each half, at most.
    `complete`: whether each half had at most `most` labels.
    `size`: number of columns without the idle one; inf, because it is not known.
    Raises InstanceError if the robot could serve more than MOST_TASKS tasks.
    Source: Righini & Salani 2006, Discrete Optimization 3(3), bounded bidirectional dynamic
    programming.
    """

    size = np.inf

    def __init__(self, vehicle: Vehicle, most: int = MOST_HALF_LABELS) -> None:
        self._servable = vehicle.servable
        self._tasks = vehicle.tasks
        self._vehicle = v = restrict_vehicle(vehicle, self._servable)
        there, complete = _compute_half_labels(v, most)
        back, also = _compute_half_labels(_reverse_vehicle(v), most)
        self.complete = complete and also
        self._there, self._back = _group_halves(
            there, back._replace(open=_reverse_node(back.open, v.tasks))
        )

    @staticmethod
    def fits(vehicle: Vehicle) -> bool:
        """Return whether the routes of this vehicle can be halved."""
        return bool(np.isfinite(vehicle.limit)) and not (
            vehicle.timed or vehicle.trips > 1 or vehicle.aboard.any()
        )

    def without(self, tasks: Collection[int]) -> "HalfRoutes":
        """Return the routes that serve none of these tasks."""
        mask = np.zeros(2, np.uint64)
        for k in np.flatnonzero(np.isin(self._servable, list(tasks))).tolist():
            mask[k >> 6] |= np.uint64(1) << np.uint64(k & 63)
        other = copy(self)
        there = _list_labels_without(self._there, mask)
        back = _list_labels_without(self._back, mask)
        some = (there[1] > 0) & (back[1] > 0)
        other._there = _take_labels(self._there, *there, some)
        other._back = _take_labels(self._back, *back, some)
        return other

    def cheapest(
        self, prices: Vec, count: int, below: float, rows: PricedRows = NO_ROWS
    ) -> list[RouteColumn]:
        """Return columns with a reduced cost below `below`, the least first.

        The column with the least reduced cost of all is among them.

        prices: (M,) m.
        count: columns, at most.
        below: m.
        rows: subset rows; their charges are part of the reduced costs.
        """
        found: dict[tuple[int, ...], RouteColumn] = {}
        for _, a, b in self._joined(prices, below - self._vehicle.fixed, rows):
            words = self._there.keys[a, :2] | self._back.keys[b, :2]
            tasks = tuple(self._servable[list_bits(words)].tolist())
            if tasks not in found and len(found) < count:
                found[tasks] = RouteColumn(self._length(a, b), tasks)
        return list(found.values())

    def within(
        self,
        prices: Vec,
        below: float,
        most: float,
        reward: float = 0.0,
        rows: PricedRows = NO_ROWS,
    ) -> list[RouteColumn] | None:
        """Return all columns but the idle one with a reduced cost below `below`.

        Returns None if there are more than `most`, or if very many pairs of halves have equal tasks.

        prices: (M,) m.
        below: m.
        most: columns, at most; finite.
        reward: m, subtracted from the reduced cost of each column.
        rows: subset rows; their charges are part of the reduced costs.
        """
        if not len(self._there.length):
            return []
        room = MOST_PAIRS_OF_SET * int(most)
        sides = self._select(prices, below + reward - self._vehicle.fixed, rows)
        first, second = _list_pairs(room, *sides)
        if len(first) > room:
            return None
        found: dict[tuple[int, ...], float] = {}
        for a, b in zip(first.tolist(), second.tolist(), strict=True):
            words = self._there.keys[a, :2] | self._back.keys[b, :2]
            tasks = tuple(self._servable[list_bits(words)].tolist())
            found[tasks] = min(found.get(tasks, np.inf), self._length(a, b))
        if len(found) > most:
            return None
        return [RouteColumn(length, tasks) for tasks, length in sorted(found.items())]

    def _length(self, a: int, b: int) -> float:
        """Return the length in m of the route of halves a and b, with the fixed cost.

        It is computed without prices: their rounding would make a known column look new.
        """
        v = self._vehicle
        there = self._there
        back = self._back
        way = float(v.distance[there.open[a], back.open[b]])
        return float(there.length[a]) + way + float(back.length[b]) + v.fixed

    def least(self, prices: Vec, rows: PricedRows = NO_ROWS) -> float:
        """Return the least reduced cost; at most 0, which is that of the idle column."""
        joined = self._joined(prices, -self._vehicle.fixed, rows)
        values = [value for value, _, _ in joined[:1]]
        return min([0.0, *(value + self._vehicle.fixed for value in values)])

    def _joined(
        self, prices: Vec, below: float, rows: PricedRows
    ) -> list[tuple[float, int, int]]:
        """Return the best pair of halves of each group, the least first.

        An entry is (reduced cost without the fixed cost, half a, half b).
        """
        if not len(self._there.length):
            return []
        best, a, b = _join_halves(*self._select(prices, below, rows))
        order = [int(g) for g in np.argsort(best, kind="stable") if a[g] >= 0]
        return [(float(best[g]), int(a[g]), int(b[g])) for g in order]

    def _select(self, prices: Vec, below: float, rows: PricedRows) -> tuple[Any, ...]:
        """Return the arguments of `_join_halves`: halves that can be part of a route below `below`.

        Each half is charged for the subset rows as if it were the whole route, but only the first
        half for the robot. That is at most what the route is charged.
        """
        own = prices[self._servable]
        v = self._vehicle
        there = self._there
        back = self._back
        sums = _sum_prices(own)
        one = there.length - _price_labels(there.keys, sums, False)
        two = back.length - _price_labels(back.keys, sums, True)
        least = np.minimum.reduceat(one, there.start[:-1])
        least_back = np.minimum.reduceat(two, back.start[:-1])
        first, start = _select_promising(one, least_back, there.start, below)
        second, start_back = _select_promising(two, least, back.start, below)
        charges = rows.charges(v.robot, self._servable)
        full_one, full_two = one, two
        if rows.rows:
            full_one = _charge_labels(one, there.keys, first, *charges, False)
            full_two = _charge_labels(two, back.keys, second, *charges, True)
            first, start = _sort_groups(full_one, first, start)
            second, start_back = _sort_groups(full_two, second, start_back)
        return (
            first,
            second,
            start,
            start_back,
            full_one,
            full_two,
            one,
            two,
            *charges,
            there.keys,
            back.keys,
            there.length,
            back.length,
            there.open,
            back.open,
            v.distance,
            v.limit + ROUNDING_SLACK,
            below,
        )


def _compute_half_labels(v: Vehicle, most: int) -> tuple[_HalfLabels, bool]:
    """Return the labels within half of the limit, and whether they are complete."""
    m = v.tasks
    way = v.shortest
    rest = way[: 2 * m, m : 2 * m] + way[m : 2 * m, 2 * m + 1]
    home = np.ascontiguousarray(way[: 2 * m, 2 * m + 1])
    limit = v.limit + ROUNDING_SLACK
    keys, last, length, _, complete = grow_labels(
        v.distance,
        rest,
        home,
        v.load,
        v.aboard,
        v.capacity + ROUNDING_SLACK,
        limit,
        limit / 2.0 + ROUNDING_SLACK,
        most,
    )
    return _HalfLabels(keys, length, last, np.zeros(0, np.int64)), complete


def _reverse_node(v: Ints, m: int) -> Ints:
    """Return the node of a route that is node v of the same route flown backwards."""
    return np.where(v == 2 * m, 2 * m + 1, np.where(v < m, v + m, v - m))


def _reverse_vehicle(v: Vehicle) -> Vehicle:
    """Return the robot that flies the routes of v from their end to their start."""
    m = v.tasks
    nodes = [*range(m, 2 * m), *range(m), 2 * m + 1, 2 * m]
    square = np.ix_(nodes, nodes)
    return Vehicle(
        ways=Legs.of(v.distance.T[square]),
        times=Legs.of(v.duration.T[square]),
        earliest=v.earliest[nodes],
        latest=v.latest[nodes],
        load=v.load,
        capacity=v.capacity,
        limit=v.limit,
        capable=v.capable,
        aboard=v.aboard,
        robot=v.robot,
        metric=v.metric,
    )


def _group_halves(
    there: _HalfLabels, back: _HalfLabels
) -> tuple[_HalfLabels, _HalfLabels]:
    """Return the labels of each half for which the other half has labels with the same on board."""
    one, two = (
        half.keys[:, 2] * HASH_MULTIPLIERS[0] ^ half.keys[:, 3] * HASH_MULTIPLIERS[1]
        for half in (there, back)
    )
    common = np.intersect1d(one, two)
    return _select_groups(there, one, common), _select_groups(back, two, common)


def _select_groups(half: _HalfLabels, name: Words, common: Words) -> _HalfLabels:
    kept = np.flatnonzero(np.isin(name, common))
    kept = kept[np.argsort(name[kept], kind="stable")]
    start = np.searchsorted(name[kept], common)
    return _HalfLabels(
        half.keys[kept], half.length[kept], half.open[kept], np.append(start, len(kept))
    )


def _select_promising(
    cost: Vec, least: Vec, start: Ints, below: float
) -> tuple[Ints, Ints]:
    """Return the labels that can be part of a route below `below`, and where groups start.

    They cost less than `below` with the least cost of the other half. The least of each group is
    first.
    """
    group = np.repeat(np.arange(len(least)), np.diff(start))
    kept = np.flatnonzero(cost + least[group] < below)
    kept = kept[np.lexsort((cost[kept], group[kept]))]
    return kept, np.searchsorted(group[kept], np.arange(len(start)))


def _list_labels_without(half: _HalfLabels, mask: Words) -> tuple[Bools, Ints]:
    """Return whether each label has no task of the mask, and how many of each group have none."""
    words = half.keys[:, :2] & mask
    free = (words[:, 0] | words[:, 1]) == 0
    if not len(free):
        return free, np.zeros(0, np.int64)
    return free, np.add.reduceat(free, half.start[:-1], dtype=np.int64)


def _take_labels(
    half: _HalfLabels, kept: Bools, sizes: Ints, some: Bools
) -> _HalfLabels:
    """Return some labels of the groups `some`; sizes: their number in each group."""
    kept = kept & np.repeat(some, np.diff(half.start))
    start = np.concatenate([[0], np.cumsum(sizes[some])])
    return _HalfLabels(half.keys[kept], half.length[kept], half.open[kept], start)


def _sort_groups(cost: Vec, kept: Ints, start: Ints) -> tuple[Ints, Ints]:
    """Return the labels by group, the least cost of each group first, and where groups start."""
    group = np.repeat(np.arange(len(start) - 1), np.diff(start))
    return kept[np.lexsort((cost[kept], group))], start


def _sum_prices(prices: Vec) -> Mat:
    """Return (16, 256): for each of 16 groups of eight tasks, the sum of prices of each subset."""
    padded = np.zeros(128)
    padded[: len(prices)] = prices
    bits = np.arange(256)[:, None] >> np.arange(8) & 1
    return np.ascontiguousarray((bits @ padded.reshape(16, 8).T).T)


@kernel(nogil=True)
def _price_labels(keys: Words, sums: Mat, besides: bool) -> Vec:
    """Return (n,) m: prices of the tasks of each label; besides: without the tasks on board."""
    out = np.zeros(len(keys))
    for i in range(len(keys)):
        for part in range(2):
            rest = keys[i, part] & (~keys[i, 2 + part] if besides else ~np.uint64(0))
            for byte in range(8):
                out[i] += sums[
                    8 * part + byte, rest >> np.uint64(8 * byte) & np.uint64(255)
                ]
    return out


@kernel()
def _count_bits(word: Any) -> int:
    """Return the number of bits that are set."""
    count = 0
    while word != 0:
        word &= word - np.uint64(1)
        count += 1
    return count


@kernel()
def _weigh(one: Any, two: Any, mask: Words, r: int) -> int:
    """Return the weight in row r of the tasks in two words."""
    odd = _count_bits(one & mask[r, 0]) + _count_bits(two & mask[r, 1])
    return odd + 2 * (_count_bits(one & mask[r, 2]) + _count_bits(two & mask[r, 3]))


@kernel(nogil=True)
def _charge_labels(
    cost: Vec,
    keys: Words,
    chosen: Ints,
    mask: Words,
    extra: Ints,
    divisor: Ints,
    price: Vec,
    besides: bool,
) -> Vec:
    """Return the costs with the charges of the rows, see HalfRoutes._select.

    Only the `chosen` labels are charged.
    besides: without the tasks on board and the robot.
    """
    out = cost.copy()
    for n in range(len(chosen)):
        i = chosen[n]
        one = keys[i, 0] & (~keys[i, 2] if besides else ~np.uint64(0))
        two = keys[i, 1] & (~keys[i, 3] if besides else ~np.uint64(0))
        for r in range(len(price)):
            weight = _weigh(one, two, mask, r) + (0 if besides else extra[r])
            if weight >= divisor[r]:
                out[i] += price[r] * (weight // divisor[r])
    return out


@kernel(nogil=True)
def _charge_route(
    keys: Words,
    i: int,
    keys_back: Words,
    k: int,
    mask: Words,
    extra: Ints,
    divisor: Ints,
    price: Vec,
) -> float:
    """Return the charges of the rows for the route of halves i and k."""
    one = keys[i, 0] | keys_back[k, 0]
    two = keys[i, 1] | keys_back[k, 1]
    charge = 0.0
    for r in range(len(price)):
        weight = _weigh(one, two, mask, r) + extra[r]
        if weight >= divisor[r]:
            charge += price[r] * (weight // divisor[r])
    return charge


@kernel(nogil=True)
def _is_route(keys: Words, i: int, keys_back: Words, k: int) -> bool:
    """Return whether halves i and k fit: the same on board, no other task in common, some task."""
    if keys[i, 2] != keys_back[k, 2] or keys[i, 3] != keys_back[k, 3]:
        return False
    if (
        keys[i, 0] & keys_back[k, 0] != keys[i, 2]
        or keys[i, 1] & keys_back[k, 1] != keys[i, 3]
    ):
        return False
    tasks = keys[i, 0] | keys[i, 1] | keys_back[k, 0] | keys_back[k, 1]
    return bool(tasks != 0)


@kernel(nogil=True)
def _join_halves(
    first: Ints,
    second: Ints,
    start: Ints,
    start_back: Ints,
    full_one: Vec,
    full_two: Vec,
    one: Vec,
    two: Vec,
    mask: Words,
    extra: Ints,
    divisor: Ints,
    price: Vec,
    keys: Words,
    keys_back: Words,
    length: Vec,
    length_back: Vec,
    at: Ints,
    at_back: Ints,
    distance: Mat,
    limit: float,
    below: float,
) -> tuple[Vec, Ints, Ints]:
    """Return for each group the least reduced cost under `below`, and its halves, -1 if none; (G,).

    first, second: labels by group; within a group the labels of least cost come first.
    start, start_back: group g begins at start[g] and ends at start[g + 1].
    """
    groups = len(start) - 1
    best = np.full(groups, below)
    a = np.full(groups, -1)
    b = np.full(groups, -1)
    for g in range(groups):
        for p in range(start[g], start[g + 1]):
            i = first[p]
            for q in range(start_back[g], start_back[g + 1]):
                k = second[q]
                if full_one[i] + full_two[k] >= best[g]:
                    break
                if not _is_route(keys, i, keys_back, k):
                    continue
                way = distance[at[i], at_back[k]]
                if (
                    full_one[i] + way + full_two[k] >= best[g]
                    or length[i] + way + length_back[k] > limit
                ):
                    continue
                charge = _charge_route(
                    keys, i, keys_back, k, mask, extra, divisor, price
                )
                if one[i] + way + two[k] + charge < best[g]:
                    best[g] = one[i] + way + two[k] + charge
                    a[g] = i
                    b[g] = k
    return best, a, b


@kernel(nogil=True)
def _list_pairs(
    most: int,
    first: Ints,
    second: Ints,
    start: Ints,
    start_back: Ints,
    full_one: Vec,
    full_two: Vec,
    one: Vec,
    two: Vec,
    mask: Words,
    extra: Ints,
    divisor: Ints,
    price: Vec,
    keys: Words,
    keys_back: Words,
    length: Vec,
    length_back: Vec,
    at: Ints,
    at_back: Ints,
    distance: Mat,
    limit: float,
    below: float,
) -> tuple[Ints, Ints]:
    """Return the halves of all routes with a reduced cost below `below`, (n,) each.

    It stops after most + 1 pairs. The other arguments are those of `_join_halves`.
    """
    a = np.empty(most + 1, np.int64)
    b = np.empty(most + 1, np.int64)
    n = 0
    for g in range(len(start) - 1):
        for p in range(start[g], start[g + 1]):
            i = first[p]
            for q in range(start_back[g], start_back[g + 1]):
                k = second[q]
                if full_one[i] + full_two[k] >= below:
                    break
                if not _is_route(keys, i, keys_back, k):
                    continue
                way = distance[at[i], at_back[k]]
                if (
                    full_one[i] + way + full_two[k] >= below
                    or length[i] + way + length_back[k] > limit
                ):
                    continue
                charge = _charge_route(
                    keys, i, keys_back, k, mask, extra, divisor, price
                )
                if one[i] + way + two[k] + charge < below:
                    a[n] = i
                    b[n] = k
                    n += 1
                    if n > most:
                        return a, b
    return a[:n], b[:n]
