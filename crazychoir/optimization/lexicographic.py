"""The lexicographic simplex method: one optimal basis of a linear program, the same whoever computes it."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from crazychoir.errors import SolverError
from crazychoir.types import Mat, Vec

Ints = npt.NDArray[np.int64]
ZERO = 1e-9
"""What is a rounding error, relative to the numbers that were added up."""
PIVOTS = 100_000
REFRESH = 50
"""Pivots after which the inverse is computed anew."""
ARTIFICIAL = -1
"""The owner of artificial columns."""


@dataclass(frozen=True, eq=False)
class Columns:
    """n columns of a standard-form program with m rows.

    ids: (n, 2) owner and number, each once, in increasing order;  cost: (2, n), first 1 for an artificial column and 0
    for others, then c;  entries: (m, n).
    """

    ids: Ints
    cost: Mat
    entries: Mat

    def __len__(self) -> int:
        return len(self.ids)

    @classmethod
    def own(cls, owner: int, c: Vec, entries: Mat) -> "Columns":
        """The columns of one agent. c: (n,); entries: (m, n)."""
        ids = np.column_stack([np.full(len(c), owner), np.arange(len(c))]).astype(np.int64)
        return cls(ids, np.vstack([np.zeros(len(c)), c]), entries)

    @classmethod
    def artificial(cls, m: int) -> "Columns":
        """The identity."""
        return cls(cls.own(ARTIFICIAL, np.zeros(m), np.eye(m)).ids, np.vstack([np.ones(m), np.zeros(m)]), np.eye(m))

    def take(self, which: Ints) -> "Columns":
        """Those at the positions `which`, increasing."""
        return Columns(self.ids[which], self.cost[:, which], self.entries[:, which])

    def free(self) -> "Columns":
        """The same without c: what remains is to find a feasible basis."""
        return Columns(self.ids, self.cost * np.array([[1.0], [0.0]]), self.entries)


def union(parts: list[Columns]) -> Columns:
    """The columns of all parts, each once."""
    ids = np.vstack([part.ids for part in parts])
    order = np.lexsort((ids[:, 1], ids[:, 0]))
    different = np.concatenate([[True], (np.diff(ids[order], axis=0) != 0).any(axis=1)])
    which = order[different]
    cost, entries = (np.hstack([getattr(part, name) for part in parts]) for name in ("cost", "entries"))
    return Columns(ids[which], cost[:, which], np.ascontiguousarray(entries[:, which]))


@dataclass(frozen=True, eq=False)
class Basis:
    """An optimal basis of the columns that were given, or the end of a ray.

    columns: (m of them), in increasing order of id;  level: (m,) their values x_B;  prices: (2, m), of the rows, at
    the two levels of cost;  ray: id of a column that may grow for ever while c'x falls, or None.
    """

    columns: Columns
    level: Vec
    prices: Mat
    ray: tuple[int, int] | None = None


def optimal_basis(columns: Columns, start: Columns, b: Vec) -> Basis:
    """The lexicographically optimal basis among `columns`, by pivots from the basis `start`, which is part of them.

        min (a'x, c'x, delta'x)   s.t.  A x = b + (e, e^2, ..., e^m),  x >= 0,     delta_j = d^{rank of id j}

    The three costs come in this order: a, 1 for artificial columns, is a big M without a number, and delta, d -> 0,
    makes the optimum unique. e -> 0 makes the basis of a vertex unique. Neither d nor e is ever a number:
    signs are those of the first term that is not zero, in the reduced costs (entering) and in the rows of
    [B^-1 b, B^-1] (leaving). So the answer depends on the columns alone, not on the way to it.
    b: (m,), >= 0; `start` is lexicographically feasible, as the identity is, and as every answer is.
    Raises SolverError beyond PIVOTS pivots, or for a singular basis.
    Source: Dantzig, Orden & Wolfe 1955; Buerger, Notarstefano, Bullo & Allgoewer 2012, Automatica 48, 2298-2304.
    """
    return _Pivots(columns, start, b).run()


class _Pivots:
    """The state of the method: which columns are basic, and the inverse of the basis."""

    def __init__(self, columns: Columns, start: Columns, b: Vec) -> None:
        self._columns, self._b = columns, b
        self._small_level = ZERO * (1.0 + float(np.abs(b).max(initial=0.0)))
        where = {tuple(key): p for p, key in enumerate(columns.ids.tolist())}
        self._basic = np.array([where[tuple(key)] for key in start.ids.tolist()], dtype=np.int64)
        self._size = np.abs(columns.entries)
        self._refresh()

    def run(self) -> Basis:
        for n in range(1, PIVOTS):
            entering = self._entering()
            if entering is None:
                return self._answer(None)
            direction = self._inverse @ self._columns.entries[:, entering]
            row = self._leaving(direction)
            if row is None:
                return self._answer(entering)
            self._pivot(row, entering, direction)
            if n % REFRESH == 0:
                self._refresh()
        raise SolverError("lexicographic simplex", f"{PIVOTS} pivots without an end")

    def _refresh(self) -> None:
        try:
            self._inverse = np.asarray(np.linalg.inv(self._columns.entries[:, self._basic]), dtype=np.float64)
        except np.linalg.LinAlgError as error:
            raise SolverError("lexicographic simplex", "a singular basis") from error

    def _pivot(self, row: int, entering: int, direction: Vec) -> None:
        self._inverse[row] /= direction[row]
        rest = direction.copy()
        rest[row] = 0.0
        self._inverse -= np.outer(rest, self._inverse[row])
        self._basic[row] = entering

    def _entering(self) -> int | None:
        """A column with a lexicographically negative reduced cost."""
        columns = self._columns
        open_ = np.ones(len(columns), dtype=bool)
        open_[self._basic] = False
        for cost in columns.cost:
            prices = cost[self._basic] @ self._inverse
            reduced = cost - prices @ columns.entries
            small = ZERO * (1.0 + np.abs(cost) + np.abs(prices) @ self._size)
            worth = np.where(open_ & (reduced < -small), reduced, 0.0)
            best = int(np.argmin(worth))
            if worth[best] < 0.0:
                return best
            open_ &= reduced <= small
        return self._tied(np.flatnonzero(open_))

    def _tied(self, candidates: Ints) -> int | None:
        """Of columns whose reduced costs are zero, one whose first delta is negative."""
        order = np.argsort(self._basic)
        direction = self._inverse[order] @ self._columns.entries[:, candidates]
        matters = np.abs(direction) > ZERO * (1.0 + np.abs(direction).max(axis=0, initial=0.0))
        first = np.argmax(matters, axis=0)
        some = np.arange(len(candidates))
        found = matters.any(axis=0) & (direction[first, some] > 0.0) & (self._basic[order][first] < candidates)
        return int(candidates[np.argmax(found)]) if found.any() else None

    def _leaving(self, direction: Vec) -> int | None:
        """The row with the lexicographically least [B^-1 b, B^-1] / direction, of those with a positive direction."""
        rows = np.flatnonzero(direction > ZERO * (1.0 + np.abs(direction).max()))
        if len(rows) == 0:
            return None
        level = self._inverse[rows] @ self._b
        ratio = np.where(np.abs(level) <= self._small_level, 0.0, level) / direction[rows]
        for k in range(len(self._b) + 1):
            least = ratio.min()
            rows = rows[ratio <= least + ZERO * (1.0 + abs(least))]
            if len(rows) == 1:
                break
            ratio = self._inverse[rows, k % len(self._b)] / direction[rows]
        return int(rows[0])

    def _answer(self, ray: int | None) -> Basis:
        self._basic.sort()
        self._refresh()
        columns = self._columns.take(self._basic)
        level = self._inverse @ self._b
        level[np.abs(level) <= self._small_level] = 0.0
        end = None if ray is None else (int(self._columns.ids[ray, 0]), int(self._columns.ids[ray, 1]))
        return Basis(columns, level, columns.cost @ self._inverse, end)
