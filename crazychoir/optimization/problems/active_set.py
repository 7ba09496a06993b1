"""Compiled kernel for small quadratic programs: a dual active-set method."""

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from crazychoir.numerics.kernels import kernel, matrix, memory, vector
from crazychoir.types import Mat, Vec

Rows = npt.NDArray[np.int64]


class ActiveSetStatus(NamedTuple):
    """Statuses of `minimise` that are no number of steps."""

    infeasible: int = -1
    """The rows exclude each other."""
    step_limit: int = -2
    """The method reached its limit of steps."""
    not_finite: int = -3
    """The cost has entries that are not finite."""


ACTIVE_SET_STATUS = ActiveSetStatus()


class ActiveSetTolerances(NamedTuple):
    """Tolerances of the dual active-set method."""

    rounding: float = 1e-13
    """A slack below this is zero, relative to the terms that it is the sum of."""
    doubtful_slack: float = 1e-9
    """A slack below this proves no infeasibility, relative to the terms that it is the sum of.
    """
    dependent_curvature: float = 1e-11
    """A row depends on the active rows if less than this part of its own curvature is left."""
    cancelled_coefficient: float = 1e-9
    """Coefficient of an active row in a dependent row below which it is a rounded zero.

    It is relative to the lengths of both rows.
    """
    negligible_miss: float = 1e-12
    """In the units of x: a row that is missed by less counts as met, whatever its terms are."""
    row_miss: float = 1e-11
    """Tolerance by which a solution may miss a row, relative to the row's own terms."""


ACTIVE_SET_TOLERANCES = ActiveSetTolerances()


@kernel()
def _factorise_rows(gram: Mat, rows: Rows, count: int, factor: Mat) -> bool:
    """Compute L with L L' = gram over the active rows; return True if these rows are independent.

    factor: L in its lower triangle, in place
    """
    for i in range(count):
        for j in range(i + 1):
            total = gram[rows[i], rows[j]]
            for k in range(j):
                total -= factor[i, k] * factor[j, k]
            if j < i:
                factor[i, j] = total / factor[j, j]
            elif (
                total
                <= ACTIVE_SET_TOLERANCES.dependent_curvature * gram[rows[i], rows[i]]
            ):
                return False
            else:
                factor[i, i] = np.sqrt(total)
    return True


@kernel()
def _solve_factorised(factor: Mat, s: Vec, count: int) -> None:
    """Solve in place: s <- (L L')^-1 s."""
    for i in range(count):
        for k in range(i):
            s[i] -= factor[i, k] * s[k]
        s[i] /= factor[i, i]
    for i in range(count - 1, -1, -1):
        for k in range(i + 1, count):
            s[i] -= factor[k, i] * s[k]
        s[i] /= factor[i, i]


@kernel()
def _resume_active_rows(
    gram: Mat, free: Vec, u: Vec, rows: Rows, factor: Mat, s: Vec
) -> int:
    """Start from the rows that were active in the last solve; return their number.

    Starts from no rows, and returns 0, if these rows are dependent or one of their
    multipliers is not positive now.
    """
    count = 0
    for p in range(len(u)):
        if u[p] > 0.0:
            if count == len(s):
                count = 0
                break
            rows[count] = p
            count += 1
    good = _factorise_rows(gram, rows, count, factor)
    if good:
        for i in range(count):
            s[i] = -free[rows[i]]
        _solve_factorised(factor, s, count)
        for i in range(count):
            good = good and s[i] > 0.0
    u[:] = 0.0
    if not good:
        return 0
    for i in range(count):
        u[rows[i]] = s[i]
    return count


@kernel()
def _compute_slack(
    gram: Mat, free: Vec, u: Vec, rows: Rows, count: int, p: int
) -> float:
    total: float = free[p]
    for i in range(count):
        total += gram[p, rows[i]] * u[rows[i]]
    return total


@kernel()
def _sum_slack_terms(
    gram: Mat, size: Vec, u: Vec, rows: Rows, count: int, p: int
) -> float:
    """Return the sum of the absolute terms of the slack of row p."""
    total: float = size[p]
    for i in range(count):
        total += abs(gram[p, rows[i]] * u[rows[i]])
    return total


@kernel()
def _find_worst_row(
    gram: Mat, free: Vec, size: Vec, u: Vec, rows: Rows, count: int
) -> int:
    """Return the row with the most negative slack, or -1 if no row is violated.

    A slack counts as negative only if the rounding of its own terms does not explain it.
    """
    worst = -1
    least = 0.0
    for p in range(len(free)):
        if u[p] == 0.0:
            slack = _compute_slack(gram, free, u, rows, count, p)
            if (
                slack < least
                and slack
                < -ACTIVE_SET_TOLERANCES.rounding
                * _sum_slack_terms(gram, size, u, rows, count, p)
            ):
                worst = p
                least = slack
    return worst


@kernel()
def _prove_exclusion(u: Vec, rows: Rows, s: Vec, count: int, p: int) -> None:
    """Set u (m,) to the proof that row p and the active rows exclude each other.

    The proof is:

        K A'u = 0,   slack'u < 0
    """
    u[:] = 0.0
    for i in range(count):
        u[rows[i]] = abs(s[i])
    u[p] = 1.0


@kernel()
def _find_blocking_row(
    gram: Mat, u: Vec, rows: Rows, s: Vec, count: int, p: int, least: float
) -> tuple[float, int]:
    """Return how far u_p can grow before an active multiplier is zero, and its place.

    The active multipliers fall by s when u_p grows by 1. Returns infinity and -1 if none falls.

    least: a smaller s is a rounded zero, relative to the lengths of both rows
    """
    blocked = np.inf
    place = -1
    for i in range(count):
        if (
            s[i] > least * np.sqrt(gram[p, p] / gram[rows[i], rows[i]])
            and u[rows[i]] < blocked * s[i]
        ):
            blocked = u[rows[i]] / s[i]
            place = i
    return blocked, place


@kernel()
def _compute_multipliers(gram: Mat, free: Vec, size: Vec, u: Vec, most: int) -> int:
    """Compute the multipliers u (m,) of `minimise`.

    Returns the number of steps, or a negative status if there is no solution.
    """
    m = len(free)
    width = min(m, most)
    rows = np.empty(m, np.int64)
    factor = np.empty((width, width))
    s = np.empty(width)
    count = _resume_active_rows(gram, free, u, rows, factor, s)
    steps = 0
    p = _find_worst_row(gram, free, size, u, rows, count)
    while p >= 0:
        steps += 1
        if steps > 50 + 10 * m:
            return ACTIVE_SET_STATUS.step_limit
        # Raise u_p by t. The active slacks stay zero if their multipliers fall by t s.
        _factorise_rows(gram, rows, count, factor)
        for i in range(count):
            s[i] = gram[rows[i], p]
        _solve_factorised(factor, s, count)
        curvature = gram[p, p]
        for i in range(count):
            curvature -= gram[rows[i], p] * s[i]
        full = np.inf
        slack = _compute_slack(gram, free, u, rows, count, p) + gram[p, p] * u[p]
        least = ACTIVE_SET_TOLERANCES.cancelled_coefficient
        if (
            curvature > ACTIVE_SET_TOLERANCES.dependent_curvature * gram[p, p]
            and count < width
        ):
            full = max(0.0, -slack / curvature)
            least = 0.0
        blocked, place = _find_blocking_row(gram, u, rows, s, count, p, least)
        t = min(full, blocked)
        if t == np.inf:
            if (
                -slack
                >= ACTIVE_SET_TOLERANCES.doubtful_slack
                * _sum_slack_terms(gram, size, u, rows, count, p)
                + ACTIVE_SET_TOLERANCES.negligible_miss
            ):
                _prove_exclusion(u, rows, s, count, p)
                return ACTIVE_SET_STATUS.infeasible
            if u[p] > 0.0:
                return steps
            free[p] -= slack  # the row is met, but for its rounding
            p = _find_worst_row(gram, free, size, u, rows, count)
            continue
        for i in range(count):
            u[rows[i]] -= t * s[i]
        u[p] += t
        if full <= blocked:
            rows[count] = p
            count += 1
            p = _find_worst_row(gram, free, size, u, rows, count)
        else:
            u[rows[place]] = 0.0
            for i in range(place, count - 1):
                rows[i] = rows[i + 1]
            count -= 1
    return steps


@kernel(matrix, vector, matrix, vector, matrix, vector, memory, memory)
def minimise(
    inverse: Mat, origin: Vec, image: Mat, slack: Vec, gram: Mat, q: Vec, u: Vec, x: Vec
) -> int:
    """Solve a quadratic program by the dual active-set method.

        x = argmin 1/2 x'Px + q'x  s.t.  A x <= b,  E x = e

        x = K (q + A'u) + k,   w = b - A x = (b - A k) - A K q + D u >= 0
        u >= 0,   u'w = 0,   D = -A K A'

    inverse: K (n, n), of the problem with the equalities alone (quadratic.py)
    origin: k (n,)
    image: A K (m, n)
    slack: b - A k (m,)
    gram: D (m, m)
    q: (n,)
    u: (m,) multipliers, in place; the method starts from the rows with u > 0
    x: (n,) receives the solution
    Returns the number of steps, or a value of ACTIVE_SET_STATUS: infeasible, step_limit, or not_finite if q is not
    finite. If it is infeasible, u holds the multipliers of the rows that exclude each other:
    K A'u = 0, slack'u < 0.
    Source: Goldfarb & Idnani 1983, Mathematical Programming 27, "A numerically stable dual method
    for solving strictly convex quadratic programs". Here a Cholesky factor of the active part of D
    is computed anew in each step.
    """
    n = len(q)
    m = len(slack)
    for i in range(n):
        if not np.isfinite(q[i]):
            return ACTIVE_SET_STATUS.not_finite
    free = np.empty(m)
    size = np.empty(m)
    for p in range(m):
        free[p] = slack[p]
        size[p] = abs(slack[p])
        for i in range(n):
            free[p] -= image[p, i] * q[i]
            size[p] += abs(image[p, i] * q[i])
    steps = _compute_multipliers(gram, free, size, u, n)
    if steps < 0:
        return steps
    for i in range(n):
        x[i] = origin[i]
        for j in range(n):
            x[i] += inverse[i, j] * q[j]
        for p in range(m):
            if u[p] > 0.0:
                x[i] += image[p, i] * u[p]
    return steps


@kernel()
def _is_missed(row: Vec, bound: float, x: Vec, largest: float, is_equal: bool) -> bool:
    """Return True if x misses row'x <= bound, or row'x = bound if is_equal.

    A row is missed if it is violated by more than the rounding of its terms.
    """
    beyond = -bound
    size = abs(bound)
    for i in range(len(x)):
        beyond += row[i] * x[i]
        size += abs(row[i] * x[i])
    if is_equal:
        beyond = abs(beyond)
    # Written as `not <=` so that a value that is not a number counts as missed.
    return (
        not beyond
        <= ACTIVE_SET_TOLERANCES.row_miss * size
        + ACTIVE_SET_TOLERANCES.rounding * largest
        + ACTIVE_SET_TOLERANCES.negligible_miss
    )


@kernel(matrix, vector, matrix, vector, vector)
def is_met(A: Mat, b: Vec, E: Mat, e: Vec, x: Vec) -> bool:
    """Return True if A x <= b and E x = e, each row up to the rounding of its own terms."""
    largest = 0.0
    for i in range(len(x)):
        largest = max(largest, abs(x[i]))
    good = True
    for p in range(len(b)):
        good = good and not _is_missed(A[p], b[p], x, largest, False)
    for p in range(len(e)):
        good = good and not _is_missed(E[p], e[p], x, largest, True)
    return good
