"""The lexicographic simplex method: one optimal basis of a linear program.

Every agent that computes it gets the same basis.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt

from crazychoir.errors import SolverError
from crazychoir.optimization.problems.equilibration import (
    scaled_inverse,
    without_rounding,
)
from crazychoir.optimization.problems.tableau import walk
from crazychoir.types import Mat, Vec

Ints = npt.NDArray[np.int64]
PIVOTS = 100_000
"""Largest number of pivots before the method gives up."""
REFRESH = 50
"""Number of pivots after which the tableau is computed anew."""
EPSILON = float(np.finfo(float).eps)
"""Relative rounding error of double precision."""
ARTIFICIAL = -1
"""Owner id of the artificial columns."""


@dataclass(frozen=True, eq=False)
class Columns:
    """n columns of a standard-form program with m rows."""

    ids: Ints
    """(n, 2) owner and number, each pair once, in increasing order."""
    cost: Mat
    """(2, n) the costs a and c. The cost a comes first; it is 1 for an artificial column."""
    entries: Mat
    """(m, n) the columns themselves."""

    def __len__(self) -> int:
        return len(self.ids)

    def id_pairs(self) -> list[tuple[int, int]]:
        """Return the ids as tuples."""
        return [(owner, number) for owner, number in self.ids.tolist()]

    @classmethod
    def own(
        cls, owner: int, c: Vec, entries: Mat, first: Vec | None = None
    ) -> "Columns":
        """Return the columns of one agent.

        owner: id of the agent
        c: (n,) cost c
        entries: (m, n)
        first: (n,) the cost a, which comes before c; zeros if None
        """
        ids = np.column_stack([np.full(len(c), owner), np.arange(len(c))]).astype(
            np.int64
        )
        return cls(
            ids, np.vstack([np.zeros(len(c)) if first is None else first, c]), entries
        )

    @classmethod
    def artificial(cls, m: int) -> "Columns":
        """Return the m artificial columns: an identity matrix."""
        return cls(
            cls.own(ARTIFICIAL, np.zeros(m), np.eye(m)).ids,
            np.vstack([np.ones(m), np.zeros(m)]),
            np.eye(m),
        )

    def take(self, which: Ints) -> "Columns":
        """Return the columns at the positions `which`, in increasing order."""
        return Columns(self.ids[which], self.cost[:, which], self.entries[:, which])

    def free(self) -> "Columns":
        """Return these columns without the cost c: what remains is to find a feasible basis."""
        return Columns(self.ids, self.cost * np.array([[1.0], [0.0]]), self.entries)


def union(parts: list[Columns]) -> Columns:
    """Return the columns of all parts, each once."""
    ids = np.vstack([part.ids for part in parts])
    order = np.lexsort((ids[:, 1], ids[:, 0]))
    different = np.concatenate([[True], (np.diff(ids[order], axis=0) != 0).any(axis=1)])
    which = order[different]
    cost, entries = (
        np.hstack([getattr(part, name) for part in parts])
        for name in ("cost", "entries")
    )
    return Columns(ids[which], cost[:, which], np.ascontiguousarray(entries[:, which]))


@dataclass(frozen=True, eq=False)
class Basis:
    """An optimal basis B of the given columns, or the end of a ray.

    All numbers depend on B and b alone, bit by bit. Agents with the same basis therefore have the
    same numbers.
    """

    columns: Columns
    """The m columns of B, in increasing order of id."""
    b: Vec
    """(m,) right-hand side."""
    inverse: Mat
    """(m, m) B^-1."""
    level: Vec
    """(m,) values x_B of the basic variables."""
    ray: tuple[int, int] | None = None
    """Id of a column that may grow for ever while c'x falls, or None."""

    @classmethod
    def of(cls, columns: Columns, b: Vec) -> "Basis":
        """Return the basis of m columns in increasing order of id.

        Raises SolverError if the columns are dependent.
        """
        inverse = scaled_inverse(columns.entries)
        return cls(
            columns,
            b,
            inverse,
            without_rounding(inverse @ b, np.abs(inverse) @ np.abs(b)),
        )

    @cached_property
    def prices(self) -> Mat:
        """(2, m) prices of the rows, at the two levels of cost."""
        cost = self.columns.cost
        return without_rounding(
            cost @ self.inverse, np.abs(cost) @ np.abs(self.inverse)
        )

    @cached_property
    def terms(self) -> Vec:
        """(m,) added sizes of the terms of each level: |B^-1| |b|."""
        return np.asarray(np.abs(self.inverse) @ np.abs(self.b))

    @cached_property
    def uncertainty(self) -> Vec:
        """(m,) bound of the rounding error of the levels: epsilon |B^-1| (|B| |x_B| + |b|)."""
        size = np.abs(self.columns.entries) @ np.abs(self.level) + np.abs(self.b)
        return np.asarray(EPSILON * (np.abs(self.inverse) @ size))

    def price_out(self, columns: Columns) -> Mat:
        """Return the reduced costs (2, n) of `columns`, at the two levels of cost."""
        terms = np.abs(columns.cost) + np.abs(self.prices) @ np.abs(columns.entries)
        return without_rounding(columns.cost - self.prices @ columns.entries, terms)

    def expressed(self, entries: Mat) -> Mat:
        """Return B^-1 entries (m, n): the columns of `entries` as sums of the basic columns.

        entries: (m, n)
        """
        return without_rounding(
            self.inverse @ entries, np.abs(self.inverse) @ np.abs(entries)
        )


def optimal_basis(columns: Columns, start: "Columns | Basis", b: Vec) -> Basis:
    """Return the lexicographically optimal basis among `columns`, by pivots from `start`.

        min (z_1, ..., z_m, a'x, c'x, delta'x)   s.t.  A x = b + (e, e^2, ..., e^m),  x >= 0,
        z_i the artificial column of row i,   delta_j = d^{rank of id j}

    The costs count in this order:

    - z_i: an artificial column has a cost above all others (a big M without a number), in the order
      of rows. Rows in different units are therefore never added up.
    - a, then c.
    - delta, with d -> 0: it makes the optimum unique.

    e -> 0 makes the basis of a vertex unique. Neither d nor e ever becomes a number. A sign is the
    sign of the first term that is not zero: in the reduced costs for the entering column, and in
    the rows of [B^-1 b, B^-1] for the leaving column. So the answer depends on the columns alone,
    and not on the sequence of pivots.
    Whether a number is zero is judged by the terms that were added up (_pivot, without_rounding),
    never by other rows or columns. So the answer is the same basis when rows and columns have other
    units.

    columns: all columns
    start: columns of a lexicographically feasible basis, which are part of `columns`. The identity
        is one, and so is every answer of this function.
    b: (m,) >= 0
    Raises SolverError after PIVOTS pivots, or for a singular basis.
    Source: Dantzig, Orden & Wolfe 1955; Buerger, Notarstefano, Bullo & Allgoewer 2012,
    Automatica 48, 2298-2304.
    """
    basis = start if isinstance(start, Basis) else Basis.of(start, b)
    artificial = int(np.searchsorted(columns.ids[:, 0], 0))
    where = {key: p for p, key in enumerate(columns.id_pairs())}
    basic = np.array([where[key] for key in basis.columns.id_pairs()], dtype=np.int64)
    for _ in range(PIVOTS // REFRESH):
        pivots, end = walk(_tableau(columns, basis, basic), basic, artificial, REFRESH)
        if not pivots:
            owner, number = columns.ids[end].tolist()
            ray = (owner, number) if end >= 0 else None
            return Basis(columns.take(basic), basis.b, basis.inverse, basis.level, ray)
        basic.sort()
        basis = Basis.of(columns.take(basic), b)
    found = f"{PIVOTS} pivots without an end: double precision cannot tell which basis is the best"
    raise SolverError("lexicographic simplex", found)


def _tableau(columns: Columns, basis: Basis, basic: Ints) -> Mat:
    """Return the tableau (m + 2, n + m + 1): B^-1 [A, I, b], and the reduced costs at two levels.

    basic: (m,) positions of the columns of the basis
    """
    m = len(basic)
    n = len(columns)
    tableau = np.zeros((m + 2, n + m + 1))
    tableau[:m, :n] = basis.expressed(columns.entries)
    tableau[:m, basic] = np.eye(m)
    tableau[:m, n : n + m] = basis.inverse
    tableau[:m, -1] = np.maximum(basis.level, 0.0)
    cost = columns.cost[:, basic]
    terms = np.abs(columns.cost) + np.abs(cost) @ np.abs(tableau[:m, :n])
    tableau[m:, :n] = without_rounding(columns.cost - cost @ tableau[:m, :n], terms)
    tableau[m:, basic] = 0.0
    return tableau
