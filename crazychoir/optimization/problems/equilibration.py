"""Invert a matrix with rows and columns in any units."""

import numpy as np

from crazychoir.errors import SolverError
from crazychoir.optimization.problems.tableau import SUM_ROUNDING, solve_identity
from crazychoir.types import Mat, Vec

SCALING_PASSES = 8
"""Sweeps over rows and columns of the scaling."""
ROUNDING_DECIDES_TEXT = (
    "double precision cannot tell which basis is the best; "
    "remove rows or columns that are nearly the same as sums of others"
)
"""What the errors say that follow from rounding."""
EVEN_DIGIT_RANGE = 12.0
"""Range of entries that needs no scaling: binary digits between the largest and the smallest."""


def remove_rounding(value: Mat, terms: Mat, share: float = SUM_ROUNDING) -> Mat:
    """Return `value` with zeros where it is a rounding error.

    value: sums of terms
    terms: sums of the absolute values of the same terms, of the same shape
    share: a sum of at most this share of `terms` counts as zero
    """
    return np.where(np.abs(value) <= share * terms, 0.0, value)


def invert_scaled(B: Mat) -> Mat:
    """Return the inverse of B, with exact zeros where its entries are rounding errors.

        B^-1 = S (R B S)^-1 R

    R and S are diagonal matrices of powers of two, so that scaling is exact. The result depends on
    B alone. If rows or columns of B change their units, the result changes by these units only.
    B: (m, m)
    Raises SolverError if B is singular.
    """
    m = len(B)
    rows, columns = find_scaling_exponents(B)
    work = np.hstack([np.ldexp(B, rows[:, None] + columns), np.eye(m)])
    if not solve_identity(work):
        raise SolverError(
            "lexicographic simplex", f"a singular basis: {ROUNDING_DECIDES_TEXT}"
        )
    return np.asarray(np.ldexp(work[:, m:], columns[:, None] + rows))


def find_scaling_exponents(B: Mat) -> tuple[Vec, Vec]:
    """Return the exponents of R and S that bring the entries of R B S as close to 1 as possible.

        min over r, s of  sum over B_ij != 0 of (log2 |B_ij| + r_i + s_j)^2

    The sum is minimised over r and over s in turns.
    B: (m, n)
    Returns integers of shapes (m,) and (n,).
    Source: Curtis & Reid 1972, IMA Journal of Applied Mathematics 10(1), 118-124.
    """
    m, n = B.shape
    used = B != 0.0
    digits = np.log2(np.abs(B), where=used, out=np.zeros_like(B))
    r = np.zeros(m)
    s = np.zeros(n)
    if digits.max(initial=0.0) - digits.min(initial=0.0) > EVEN_DIGIT_RANGE:
        in_row = np.maximum(used.sum(axis=1), 1)
        in_column = np.maximum(used.sum(axis=0), 1)
        for _ in range(SCALING_PASSES):
            r = -(digits.sum(axis=1) + used @ s) / in_row
            s = -(digits.sum(axis=0) + r @ used) / in_column
    return np.rint(r).astype(np.int64), np.rint(s).astype(np.int64)
