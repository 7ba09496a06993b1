"""The lexicographic simplex method: one optimal basis of a linear program.

Every agent that computes it gets the same basis.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt

from crazychoir.errors import SolverError
from crazychoir.optimization.problems.equilibration import (
    CANNOT_TELL,
    scaled_inverse,
    without_rounding,
)
from crazychoir.optimization.problems.tableau import (
    SAME,
    drop_negligible,
    walk,
)
from crazychoir.types import Mat, Vec

Ints = npt.NDArray[np.int64]
PIVOTS = 100_000
"""Largest number of pivots before the method gives up."""
REFRESH = 50
"""Number of pivots after which the tableau is computed anew."""
EPSILON = float(np.finfo(float).eps)
FEASIBLE = 1e-7
"""Relative error of right-hand sides up to which what remains of a row is explained by it."""
DISTINCT = 10.0 * FEASIBLE
"""What a basic column must differ by from any sum of the others, relative to the sizes of its terms added up.

Below this, what may remain of a row changes the levels by a tenth and more.
"""
UNCERTAIN = 1e-3
"""Rounding error of a level, relative to the level, from which on the level says nothing."""
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
        return Columns(
            self.ids[which],
            np.ascontiguousarray(self.cost[:, which]),
            np.ascontiguousarray(self.entries[:, which]),
        )

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

    columns: (m of them), B, in increasing order of id;  b: (m,);  inverse: (m, m), B^-1;  level: (m,) their values
    x_B, zero where no row can tell;  ray: id of a column that may grow for ever while c'x falls, or None.
    All depend on B and b alone, bit by bit, so that agents with the same basis have the same numbers.
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
        # Sums in another layout of the memory would end with other bits.
        columns = columns.take(np.arange(len(columns)))
        inverse = scaled_inverse(columns.entries)
        level = without_rounding(inverse @ b, np.abs(inverse) @ np.abs(b))
        share = _shares(columns.entries, level, b)
        level[(share <= SAME) | ((level < 0.0) & (share <= FEASIBLE))] = 0.0
        return cls(columns, b, inverse, level)

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
    def residual(self) -> Vec:
        """(m,) |B x_B - b| of the rows, relative to the sizes of their terms added up."""
        rest = np.abs(self.columns.entries @ self.level - self.b)
        size = np.abs(self.columns.entries) @ np.abs(self.level) + np.abs(self.b)
        return np.asarray(rest / np.where(size > 0.0, size, 1.0))

    @cached_property
    def distinctness(self) -> Vec:
        """(m,) by how much of its terms each basic column differs from a sum of the others: 1 / (|B^-1| |B|)_pp."""
        terms = np.abs(self.inverse) * np.abs(self.columns.entries.T)
        return np.asarray(1.0 / terms.sum(axis=1))

    @cached_property
    def doubt(self) -> str | None:
        """Why double precision cannot tell what this basis is worth; None if it can."""
        level = self.level
        negative = level < 0.0
        vague = (level != 0.0) & (self.uncertainty > UNCERTAIN * np.abs(level))
        if self.distinctness.min() < DISTINCT:
            p = int(np.argmin(self.distinctness))
            share = self.distinctness[p]
            found = f"{self._name(p)} differs from a sum of others by {share:.1g} of its terms"
        elif negative.any():
            p = int(np.argmax(negative))
            found = f"{self._name(p)} is {level[p]:.3g}"
        elif self.residual.max() > FEASIBLE:
            row = int(np.argmax(self.residual))
            found = f"row {row} is met up to {self.residual[row]:.1g} of its terms only"
        elif vague.any():
            p = int(np.argmax(vague))
            error = self.uncertainty[p]
            found = f"{self._name(p)} is {level[p]:.3g}, with a rounding error of up to {error:.3g}"
        else:
            return None
        return f"{found}: {CANNOT_TELL}"

    def _name(self, p: int) -> str:
        owner, number = self.columns.ids[p].tolist()
        if owner < 0:
            return f"what remains of row {number}"
        return f"column {number} of agent {owner}"

    @cached_property
    def uncertainty(self) -> Vec:
        """(m,) bound of the rounding error of the levels: epsilon |B^-1| (|B| |x_B| + |b|)."""
        size = np.abs(self.columns.entries) @ np.abs(self.level) + np.abs(self.b)
        return np.asarray(EPSILON * (np.abs(self.inverse) @ size))

    def price_out(self, columns: Columns) -> Mat:
        """Return the reduced costs (2, n) of `columns`, at the two levels of cost."""
        return reduced_costs(
            columns.cost, self.columns.cost, self.expressed(columns.entries)
        )

    def expressed(self, entries: Mat) -> Mat:
        """Return B^-1 entries (m, n): the columns `entries` (m, n) as sums of the basic ones.

        A share that no row needs to SAME of its terms is zero. So a row that is the same as a sum of other rows, but
        for the digits to which the data were rounded, keeps its artificial column.
        """
        value = self.inverse @ entries
        terms = np.abs(self.inverse) @ np.abs(entries)
        value = np.ascontiguousarray(without_rounding(value, terms))
        B = self.columns.entries
        size = np.abs(entries) + np.abs(B) @ np.abs(value)
        drop_negligible(value, B, np.ascontiguousarray(size), SAME)
        return value


def _shares(B: Mat, level: Vec, b: Vec) -> Vec:
    """Return (m,) max over k of |B_ki x_i| / (|B| |x| + |b|)_k."""
    terms = np.abs(B) * np.abs(level)
    size = terms.sum(axis=1) + np.abs(b)
    return np.asarray((terms / np.where(size > 0.0, size, 1.0)[:, None]).max(axis=0))


def reduced_costs(cost: Mat, basic: Mat, expressed: Mat) -> Mat:
    """Return (2, n) cost - basic B^-1 A.

    cost: (2, n);  basic: (2, m) the costs of the basic columns;  expressed: (m, n) B^-1 A.
    """
    terms = np.abs(cost) + np.abs(basic) @ np.abs(expressed)
    return without_rounding(cost - basic @ expressed, terms, SAME)


def optimal_basis(columns: Columns, start: "Columns | Basis", b: Vec) -> Basis:
    """Return the lexicographically optimal basis among `columns`, by pivots from `start`.

        min (z_1, ..., z_m, a'x, c'x, delta'x)   s.t.  A x = b + (e, e^2, ..., e^m),  x >= 0,
        z_i the artificial column of row i,   delta_j = d^{rank of id j}

    The costs come in this order. An artificial column is a big M without a number, in the order of rows, so that rows
    in different units are never added up. a comes before c, and delta, d -> 0, makes the optimum unique. e -> 0 makes
    the basis of a vertex unique. Neither d nor e is ever a number: signs are those of the first term that is not zero,
    in the reduced costs (entering) and in the rows of [B^-1 b, B^-1] (leaving). So the answer depends on the columns
    alone, not on the way to it.
    What is zero is judged by the terms that were added up (pivot, expressed), never by other rows or columns:
    with rows and columns in other units the answer is the same basis.
    b: (m,), >= 0; `start` is lexicographically feasible, as the identity is, and as every answer is.
    Raises SolverError beyond PIVOTS pivots, for a basis that comes back, and for a singular basis.
    Source: Dantzig, Orden & Wolfe 1955; Buerger, Notarstefano, Bullo & Allgoewer 2012, Automatica 48, 2298-2304.
    """
    basis = start if isinstance(start, Basis) else Basis.of(start, b)
    artificial = int(np.searchsorted(columns.ids[:, 0], 0))
    where = {key: p for p, key in enumerate(columns.id_pairs())}
    basic = np.array([where[key] for key in basis.columns.id_pairs()], dtype=np.int64)
    seen = {basic.tobytes()}
    most = REFRESH
    for _ in range(PIVOTS // REFRESH):
        after = basic.copy()
        pivots, end = walk(_tableau(columns, basis, basic), after, artificial, most)
        if not pivots:
            owner, number = columns.ids[end].tolist()
            ray = (owner, number) if end >= 0 else None
            return Basis(columns.take(basic), basis.b, basis.inverse, basis.level, ray)
        after.sort()
        following = _basis_if_distinct(columns.take(after), b) if most > 1 else None
        if most > 1 and following is None:
            # Rounding has become a pivot. Single pivots see each difference beside its terms.
            most = 1
            continue
        basic = after
        if basic.tobytes() in seen:
            break
        seen.add(basic.tobytes())
        basis = following or Basis.of(columns.take(basic), b)
    found = f"pivots without an end: {CANNOT_TELL}"
    raise SolverError("lexicographic simplex", found)


def _basis_if_distinct(columns: Columns, b: Vec) -> Basis | None:
    """Return the basis, or None where its columns are nearly dependent."""
    try:
        basis = Basis.of(columns, b)
    except SolverError:
        return None
    return basis if basis.distinctness.min() >= DISTINCT else None


def _tableau(columns: Columns, basis: Basis, basic: Ints) -> Mat:
    """Return the tableau (m + 2, n + m + 1): B^-1 [A, I, b], and the reduced costs at two levels.

    basic: (m,) positions of the columns of the basis
    """
    m = len(basic)
    n = len(columns)
    tableau = np.zeros((m + 2, n + m + 1))
    tableau[:m, :-1] = basis.expressed(np.hstack([columns.entries, np.eye(m)]))
    tableau[:m, basic] = np.eye(m)
    # A basis with a level that is negative is doubtful, and if it is the last one it is refused.
    tableau[:m, -1] = np.maximum(basis.level, 0.0)
    cost = columns.cost[:, basic]
    tableau[m:, :n] = reduced_costs(columns.cost, cost, tableau[:m, :n])
    tableau[m:, basic] = 0.0
    return tableau
