"""Dual prices of a basis of a linear program, with penalties for rows that other rows imply."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from crazychoir.errors import SolverError
from crazychoir.optimization.problems.equilibration import ROUNDING_DECIDES_TEXT
from crazychoir.optimization.problems.lexicographic import (
    LEAST_DISTINCTNESS,
    OptimalBasis,
    ProgramColumns,
)
from crazychoir.types import Vec


@dataclass(frozen=True, eq=False)
class BasisPricing:
    """Prices of the rows at a basis, and how the columns of one agent judge them.

    K artificial columns are left over in the basis. Each belongs to a row that other rows imply.
    """

    basis: OptimalBasis
    """The basis that gives the prices."""
    own: ProgramColumns
    """Columns of the agent."""
    sign: Vec
    """(m,) 1, or -1 for a row that was multiplied by -1 to make its right-hand side positive."""
    is_cost_counted: bool
    """False if c counts as 0, because c'x has no lower bound."""

    def penalties(self, given: Vec | None = None) -> Vec:
        """Return the least M for which the prices are dual feasible for the own columns.

            c_j - (y + sum_k M_k y_k)'A_j >= 0
            y_k the row of B^-1 of the k-th artificial column in the basis

        M_k may depend on the entries of later rows. After K agreements on the greatest value it is
        large enough for all columns of all agents.

        given: (K,) M so far; zeros if None
        """
        M = np.zeros(self.left_over) if given is None else given.copy()
        change = self.basis.expressed(self.own.entries)[self._artificial]
        reduced = self.basis.price_out(self.own)[1]
        for k in reversed(range(len(M))):
            short = (
                (change[k] < 0.0)
                & (change[:k] == 0.0).all(axis=0)
                & (reduced < M @ change)
            )
            rest = reduced - M @ change + M[k] * change[k]
            M[k] = (rest[short] / change[k, short]).max(initial=M[k])
        return M

    def doubts(self) -> Vec:
        """Return (K,) by how much, relative to its terms, the k-th row left over differs at an own column.

        0 where it is the same, where it differs for certain, and where this keeps no column from the basis: that asks
        for no penalty, and may not help to meet another row.
        """
        basis = self.basis
        change = basis.expressed(self.own.entries)
        size = np.abs(self.own.entries)
        size = size + np.abs(basis.columns.entries) @ np.abs(change)
        rows = basis.columns.ids[self._artificial, 1]
        change = change[self._artificial]
        share = np.abs(change) / np.where(size[rows] > 0.0, size[rows], 1.0)
        is_barred = basis.price_out(self.own)[1] < 0.0
        if self.basis.unmet:
            is_barred[:] = True
        matters = (change < 0.0) & is_barred
        share[~matters | (share > LEAST_DISTINCTNESS)] = 0.0
        return np.asarray(share.max(axis=1, initial=0.0))

    def require_distinct(self, doubts: Vec, where: str) -> None:
        """Raise SolverError for a remaining row if it is unclear whether other rows imply it.

        doubts: (K,) the greatest of all agents
        """
        if doubts.any():
            k = int(np.argmax(doubts))
            row = int(self.basis.columns.ids[self._artificial[k], 1])
            found = f"row {row} differs from a sum of other rows by {doubts[k]:.1g} of its terms"
            raise SolverError(where, f"{found}: {ROUNDING_DECIDES_TEXT}")

    def excess(self) -> float:
        """Return by how much an own column would lower the cost of the basis, relative to the terms of its cost."""
        change = self.basis.expressed(self.own.entries)
        left_over = change[self._artificial]
        reduced = self.basis.price_out(self.own)
        own = np.arange(len(self.own))
        first = np.zeros(len(self.own))
        if len(left_over):
            first = left_over[np.argmax(left_over != 0.0, axis=0), own]
        cost = self.basis.columns.cost
        terms = np.abs(self.own.cost) + np.abs(cost) @ np.abs(change)
        gain = -reduced / np.where(terms > 0.0, terms, 1.0)
        best = np.where(gain[0] != 0.0, gain[0], gain[1] * self.is_cost_counted)
        best[first < 0.0] = 0.0
        return float(best.max(initial=0.0))

    def prices(self, penalties: Vec | None = None) -> Vec:
        """Return the prices (m,): y + sum_k M_k y_k.

        penalties: (K,) M; zeros if None
        """
        y = self.basis.prices[1]
        if penalties is not None:
            y = y + penalties @ self.basis.inverse[self._artificial]
        return np.asarray(y * self.sign)

    def own_prices(self) -> Vec:
        """Return prices (m,) that are dual feasible for the own columns, as far as there are any."""
        M = np.zeros(self.left_over)
        for _ in range(self.left_over):
            M = self.penalties(M)
        return self.prices(M)

    @property
    def left_over(self) -> int:
        """K, the number of artificial columns in the basis."""
        return len(self._artificial)

    @property
    def _artificial(self) -> npt.NDArray[np.int64]:
        """(K,) places of the artificial columns in the basis."""
        return np.flatnonzero(self.basis.columns.ids[:, 0] < 0)
