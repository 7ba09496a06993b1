"""The lexicographic simplex method: one optimal basis of a linear program.

Every agent that computes it gets the same basis.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt

from crazychoir.errors import SolverError
from crazychoir.optimization.problems.equilibration import (
    ROUNDING_DECIDES_TEXT,
    invert_scaled,
    remove_rounding,
)
from crazychoir.optimization.problems.tableau import (
    SAME_NUMBER_TOLERANCE,
    drop_negligible,
    pivot_to_optimum,
)
from crazychoir.types import Mat, Vec

Ints = npt.NDArray[np.int64]
MOST_PIVOTS = 100_000
"""Largest number of pivots before the method gives up."""
PIVOTS_PER_REFRESH = 50
"""Number of pivots after which the tableau is computed anew."""
MACHINE_EPSILON = float(np.finfo(float).eps)
FEASIBILITY_TOLERANCE = 1e-7
"""Relative error of right-hand sides up to which what remains of a row is explained by it."""
LEAST_DISTINCTNESS = 10.0 * FEASIBILITY_TOLERANCE
"""What a basic column must differ by from any sum of the others, relative to the sizes of its terms added up.

Below this, what may remain of a row changes the levels by a tenth and more.
"""
LARGEST_UNCERTAINTY = 1e-3
"""Rounding error of a level, relative to the level, from which on the level says nothing."""
ARTIFICIAL_OWNER = -1
"""Owner id of the artificial columns."""


@dataclass(frozen=True, eq=False)
class ProgramColumns:
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
    ) -> "ProgramColumns":
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
    def artificial(cls, m: int) -> "ProgramColumns":
        """Return the m artificial columns: an identity matrix."""
        return cls(
            cls.own(ARTIFICIAL_OWNER, np.zeros(m), np.eye(m)).ids,
            np.vstack([np.ones(m), np.zeros(m)]),
            np.eye(m),
        )

    def take(self, which: Ints) -> "ProgramColumns":
        """Return the columns at the positions `which`, in increasing order."""
        return ProgramColumns(
            self.ids[which],
            np.ascontiguousarray(self.cost[:, which]),
            np.ascontiguousarray(self.entries[:, which]),
        )

    def free(self) -> "ProgramColumns":
        """Return these columns without the cost c: what remains is to find a feasible basis."""
        return ProgramColumns(
            self.ids, self.cost * np.array([[1.0], [0.0]]), self.entries
        )


def unite_columns(parts: list[ProgramColumns]) -> ProgramColumns:
    """Return the columns of all parts, each once."""
    ids = np.vstack([part.ids for part in parts])
    order = np.lexsort((ids[:, 1], ids[:, 0]))
    different = np.concatenate([[True], (np.diff(ids[order], axis=0) != 0).any(axis=1)])
    which = order[different]
    cost, entries = (
        np.hstack([getattr(part, name) for part in parts])
        for name in ("cost", "entries")
    )
    return ProgramColumns(
        ids[which], cost[:, which], np.ascontiguousarray(entries[:, which])
    )


@dataclass(frozen=True, eq=False)
class OptimalBasis:
    """An optimal basis B of the given columns, or the basis at which a ray without end was found.

    All fields depend on B and b alone, bit by bit, so that agents with the same basis have the same
    numbers.
    """

    columns: ProgramColumns
    """The m columns of B, in increasing order of id."""
    b: Vec
    """(m,) right-hand side."""
    inverse: Mat
    """(m, m) B^-1."""
    level: Vec
    """(m,) values x_B of the basic variables; zero where it may be a rounding error."""
    ray: tuple[int, int] | None = None
    """Id of a column that may grow for ever while c'x falls, or None."""

    @classmethod
    def of(cls, columns: ProgramColumns, b: Vec) -> "OptimalBasis":
        """Return the basis of m columns in increasing order of id.

        Raises SolverError if the columns are dependent.
        """
        # Sums in another layout of the memory would end with other bits.
        columns = columns.take(np.arange(len(columns)))
        inverse = invert_scaled(columns.entries)
        level = remove_rounding(inverse @ b, np.abs(inverse) @ np.abs(b))
        share = _compute_shares(columns.entries, level, b)
        level[
            (share <= SAME_NUMBER_TOLERANCE)
            | ((level < 0.0) & (share <= FEASIBILITY_TOLERANCE))
        ] = 0.0
        return cls(columns, b, inverse, level)

    @cached_property
    def prices(self) -> Mat:
        """(2, m) prices of the rows, at the two levels of cost."""
        cost = self.columns.cost
        return remove_rounding(cost @ self.inverse, np.abs(cost) @ np.abs(self.inverse))

    @cached_property
    def terms(self) -> Vec:
        """(m,) added sizes of the terms of each level: |B^-1| |b|."""
        return np.asarray(np.abs(self.inverse) @ np.abs(self.b))

    @cached_property
    def unmet(self) -> list[int]:
        """Rows with a residual too large for errors of FEASIBILITY_TOLERANCE in right-hand sides."""
        remains = (self.columns.ids[:, 0] < 0) & (
            self.level > FEASIBILITY_TOLERANCE * self.terms
        )
        return [int(row) for row in self.columns.ids[remains, 1]]

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
        vague = (level != 0.0) & (
            self.uncertainty > LARGEST_UNCERTAINTY * np.abs(level)
        )
        if self.distinctness.min() < LEAST_DISTINCTNESS:
            p = int(np.argmin(self.distinctness))
            share = self.distinctness[p]
            found = f"{self._name(p)} differs from a sum of others by {share:.1g} of its terms"
        elif negative.any():
            p = int(np.argmax(negative))
            found = f"{self._name(p)} is {level[p]:.3g}"
        elif self.residual.max() > FEASIBILITY_TOLERANCE:
            row = int(np.argmax(self.residual))
            found = f"row {row} is met up to {self.residual[row]:.1g} of its terms only"
        elif vague.any():
            p = int(np.argmax(vague))
            error = self.uncertainty[p]
            found = f"{self._name(p)} is {level[p]:.3g}, with a rounding error of up to {error:.3g}"
        else:
            return None
        return f"{found}: {ROUNDING_DECIDES_TEXT}"

    def _name(self, p: int) -> str:
        owner, number = self.columns.ids[p].tolist()
        if owner < 0:
            return f"what remains of row {number}"
        return f"column {number} of agent {owner}"

    @cached_property
    def uncertainty(self) -> Vec:
        """(m,) bound of the rounding error of the levels: epsilon |B^-1| (|B| |x_B| + |b|)."""
        size = np.abs(self.columns.entries) @ np.abs(self.level) + np.abs(self.b)
        return np.asarray(MACHINE_EPSILON * (np.abs(self.inverse) @ size))

    def price_out(self, columns: ProgramColumns) -> Mat:
        """Return the reduced costs (2, n) of `columns`, at the two levels of cost."""
        return price_columns(
            columns.cost, self.columns.cost, self.expressed(columns.entries)
        )

    def expressed(self, entries: Mat) -> Mat:
        """Return B^-1 entries (m, n): the columns `entries` (m, n) as sums of the basic ones.

        A share that no row needs to SAME_NUMBER_TOLERANCE of its terms is zero. So a row that equals a sum of other
        rows, but for the digits to which the data were rounded, keeps its artificial column.
        """
        value = self.inverse @ entries
        terms = np.abs(self.inverse) @ np.abs(entries)
        value = np.ascontiguousarray(remove_rounding(value, terms))
        B = self.columns.entries
        size = np.abs(entries) + np.abs(B) @ np.abs(value)
        drop_negligible(value, B, np.ascontiguousarray(size), SAME_NUMBER_TOLERANCE)
        return value


def _compute_shares(B: Mat, level: Vec, b: Vec) -> Vec:
    """Return (m,) max over k of |B_ki x_i| / (|B| |x| + |b|)_k."""
    terms = np.abs(B) * np.abs(level)
    size = terms.sum(axis=1) + np.abs(b)
    return np.asarray((terms / np.where(size > 0.0, size, 1.0)[:, None]).max(axis=0))


def price_columns(cost: Mat, basic: Mat, expressed: Mat) -> Mat:
    """Return the reduced costs (2, n), cost - basic B^-1 A.

    cost: (2, n)
    basic: (2, m), costs of the basic columns
    expressed: (m, n), B^-1 A
    """
    terms = np.abs(cost) + np.abs(basic) @ np.abs(expressed)
    return remove_rounding(cost - basic @ expressed, terms, SAME_NUMBER_TOLERANCE)


def find_optimal_basis(
    columns: ProgramColumns, start: "ProgramColumns | OptimalBasis", b: Vec
) -> OptimalBasis:
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
    Raises SolverError beyond MOST_PIVOTS pivots, for a basis that comes back, and for a singular basis.
    Source: Dantzig, Orden & Wolfe 1955; Buerger, Notarstefano, Bullo & Allgoewer 2012, Automatica 48, 2298-2304.
    """
    basis = start if isinstance(start, OptimalBasis) else OptimalBasis.of(start, b)
    artificial = int(np.searchsorted(columns.ids[:, 0], 0))
    where = {key: p for p, key in enumerate(columns.id_pairs())}
    basic = np.array([where[key] for key in basis.columns.id_pairs()], dtype=np.int64)
    seen = {basic.tobytes()}
    most = PIVOTS_PER_REFRESH
    for _ in range(MOST_PIVOTS // PIVOTS_PER_REFRESH):
        after = basic.copy()
        pivots, end = pivot_to_optimum(
            _build_tableau(columns, basis, basic), after, artificial, most
        )
        if not pivots:
            owner, number = columns.ids[end].tolist()
            ray = (owner, number) if end >= 0 else None
            return OptimalBasis(
                columns.take(basic), basis.b, basis.inverse, basis.level, ray
            )
        after.sort()
        following = _build_distinct_basis(columns.take(after), b) if most > 1 else None
        if most > 1 and following is None:
            # Rounding has become a pivot. Single pivots see each difference beside its terms.
            most = 1
            continue
        basic = after
        if basic.tobytes() in seen:
            break
        seen.add(basic.tobytes())
        basis = following or OptimalBasis.of(columns.take(basic), b)
    found = f"pivots without an end: {ROUNDING_DECIDES_TEXT}"
    raise SolverError("lexicographic simplex", found)


def _build_distinct_basis(columns: ProgramColumns, b: Vec) -> OptimalBasis | None:
    """Return the basis, or None where its columns are nearly dependent."""
    try:
        basis = OptimalBasis.of(columns, b)
    except SolverError:
        return None
    return basis if basis.distinctness.min() >= LEAST_DISTINCTNESS else None


def _build_tableau(columns: ProgramColumns, basis: OptimalBasis, basic: Ints) -> Mat:
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
    tableau[m:, :n] = price_columns(columns.cost, cost, tableau[:m, :n])
    tableau[m:, basic] = 0.0
    return tableau
