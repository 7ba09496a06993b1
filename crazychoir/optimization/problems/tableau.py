"""Compiled steps of the lexicographic simplex method: pivots, and the inverse of a basis.

A tableau has the rows B^-1 [A, I, b], and below them the reduced costs at two levels. Whether a
difference is zero is judged by its own terms. Only numbers in the same unit are compared with
each other. So the steps are the same whatever the units of rows and columns are.
"""

from typing import Final

import numba
import numpy as np
import numpy.typing as npt

from crazychoir.numerics.kernels import kernel, table
from crazychoir.types import Mat

Ints = npt.NDArray[np.int64]
Mask = npt.NDArray[np.bool_]

SAME_NUMBER_TOLERANCE: Final = 1e-9
"""Two numbers that differ by less than this, relative to the larger one, are the same: users round their data."""
SUM_ROUNDING: Final = 1e-13
"""A sum smaller than this, relative to the sizes of its terms added up, is a rounding error: zero."""
NO_ENTERING_COLUMN: Final = -1
"""Status: no column enters."""
PIVOTS_USED_UP: Final = -2
"""Status: the pivots are used up."""


@kernel()
def _pivot_once(tableau: Mat, row: int, column: int, cancelled: float) -> None:
    """Make `column` a unit vector with its 1 in `row`, in place.

        T_rj <- T_rj / T_rc,     T_ij <- T_ij - T_ic T_rj   for i != r

    A difference becomes an exact zero if it is below `cancelled`, relative to its larger term.
    """
    divisor = tableau[row, column]
    for j in range(tableau.shape[1]):
        tableau[row, j] /= divisor
    tableau[row, column] = 1.0
    for i in range(tableau.shape[0]):
        factor = tableau[i, column]
        if i == row or factor == 0.0:
            continue
        for j in range(tableau.shape[1]):
            if tableau[row, j] == 0.0:
                continue
            before = tableau[i, j]
            product = factor * tableau[row, j]
            difference = before - product
            if abs(difference) <= cancelled * max(abs(before), abs(product)):
                difference = 0.0
            tableau[i, j] = difference
        tableau[i, column] = 0.0


@kernel()
def _find_feasibility_column(
    tableau: Mat, order: Ints, basic: Ints, artificial: int, is_open: Mask
) -> int:
    """Return a column that lowers the first artificial variable that it changes, or NO_ENTERING_COLUMN.

    Closes the columns that raise an artificial variable.

    order: the rows in the order of their basic columns, so that rows with artificial columns come
        first
    is_open: (n,) columns that may enter, changed in place
    """
    entering = NO_ENTERING_COLUMN
    best_level = len(order)
    best_change = 0.0
    for j in range(len(is_open)):
        if not is_open[j]:
            continue
        change = 0.0
        level = 0
        while level < len(order):
            row = order[level]
            # An artificial column that enters again raises its own variable, before those of
            # later rows change.
            if basic[row] >= artificial or (j < artificial and basic[row] > j):
                break
            change = tableau[row, j]
            if change != 0.0:
                break
            level += 1
        if change < 0.0 or (change == 0.0 and j < artificial):
            is_open[j] = False
        elif change > 0.0 and (
            level < best_level or (level == best_level and change > best_change)
        ):
            entering = j
            best_level = level
            best_change = change
    return entering


@kernel()
def _find_entering_column(tableau: Mat, basic: Ints, artificial: int, n: int) -> int:
    """Return a column with lexicographically negative reduced costs, or NO_ENTERING_COLUMN."""
    m = len(basic)
    order = np.argsort(basic)
    is_open = np.ones(n, np.bool_)
    is_open[basic] = False
    entering = _find_feasibility_column(tableau, order, basic, artificial, is_open)
    if entering >= 0:
        return entering
    for cost in (m, m + 1):
        least = 0.0
        for j in range(n):
            reduced = tableau[cost, j]
            if is_open[j] and reduced < least:
                least = reduced
                entering = j
            if reduced > 0.0:
                is_open[j] = False
        if entering >= 0:
            return entering
    # Among columns of equal cost, take the first with a negative leading delta.
    for j in range(n):
        if is_open[j]:
            for row in order:
                if tableau[row, j] != 0.0:
                    if tableau[row, j] > 0.0 and basic[row] < j:
                        return j
                    break
    return NO_ENTERING_COLUMN


@kernel()
def _find_leaving_row(tableau: Mat, m: int, n: int, entering: int) -> int:
    """Return the row with the lexicographically least [B^-1 b, B^-1] / direction, or -1.

    The direction is the entering column. Only rows with a positive direction count.
    """
    rows = np.flatnonzero(tableau[:m, entering] > 0.0)
    if len(rows) == 0:
        return -1
    count = len(rows)
    for place in range(m + 1):
        if count == 1:
            break
        column = n + m if place == 0 else n + place - 1
        least = np.inf
        for k in range(count):
            least = min(least, tableau[rows[k], column] / tableau[rows[k], entering])
        most = least + SAME_NUMBER_TOLERANCE * abs(least)
        kept = 0
        for k in range(count):
            if tableau[rows[k], column] / tableau[rows[k], entering] <= most:
                rows[kept] = rows[k]
                kept += 1
        count = kept
    return int(rows[0])


@kernel(table, numba.int64[::1], numba.int64, numba.int64)
def pivot_to_optimum(
    tableau: Mat, basic: Ints, artificial: int, most: int
) -> tuple[int, int]:
    """Pivot in place until no column enters.

    tableau: (m + 2, n + m + 1)
    basic: (m,) the column that is basic in each row, changed in place
    artificial: columns before this one are artificial, in the order of their rows
    most: largest number of pivots
    Returns the number of pivots, and NO_ENTERING_COLUMN, PIVOTS_USED_UP, or the column that may grow for ever.
    """
    m = len(basic)
    n = tableau.shape[1] - m - 1
    for pivots in range(most):
        entering = _find_entering_column(tableau, basic, artificial, n)
        if entering < 0:
            return pivots, NO_ENTERING_COLUMN
        row = _find_leaving_row(tableau, m, n, entering)
        if row < 0:
            return pivots, entering
        _pivot_once(tableau, row, entering, SAME_NUMBER_TOLERANCE)
        basic[row] = entering
    return most, PIVOTS_USED_UP


@kernel(table, table, table, numba.float64)
def drop_negligible(value: Mat, factor: Mat, size: Mat, share: float) -> None:
    """Set the entries of `value` to zero that no sum of factor @ value needs, in place.

        x_ij <- 0   where |B_ki x_ij| <= share S_kj for all k

    value: (m, n), x
    factor: (m, m), B
    size: (m, n), S, the sums of the absolute values of the terms
    share: share of S up to which a term is negligible
    """
    m, n = value.shape
    for i in range(m):
        for j in range(n):
            if value[i, j] == 0.0:
                continue
            is_negligible = True
            for k in range(m):
                if abs(factor[k, i] * value[i, j]) > share * size[k, j]:
                    is_negligible = False
                    break
            if is_negligible:
                value[i, j] = 0.0


@kernel(table)
def solve_identity(work: Mat) -> bool:
    """Turn [B, I] into [I, B^-1] in place; return True if B is regular.

    The method is Gauss-Jordan elimination with row exchanges. Where the zeros of B make an entry of
    B^-1 zero, the entry is an exact zero. The entries of B must be of about the same size, because
    the pivot is the largest entry of its column.
    work: (m, 2 m)
    """
    m = work.shape[0]
    for c in range(m):
        best = c
        for i in range(c + 1, m):
            if abs(work[i, c]) > abs(work[best, c]):
                best = i
        if work[best, c] == 0.0:
            return False
        if best != c:
            for j in range(2 * m):
                work[best, j], work[c, j] = work[c, j], work[best, j]
        _pivot_once(work, c, c, SUM_ROUNDING)
    return True
