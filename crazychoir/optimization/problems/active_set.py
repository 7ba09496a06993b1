"""The compiled kernel of small quadratic programs: a dual active-set method."""

from typing import Final

import numpy as np
import numpy.typing as npt

from crazychoir.numerics.kernels import kernel, matrix, memory, vector
from crazychoir.types import Mat, Vec

Rows = npt.NDArray[np.int64]

INFEASIBLE: Final = -1
CAPPED: Final = -2
NOT_FINITE: Final = -3
ROUNDING, DOUBT = 1e-13, 1e-9
"""Of a slack, relative to the terms that it is the sum of: below, it is none; below, no proof of infeasibility."""
DEPENDENT = 1e-11
"""Of the curvature that is left to a row when the active ones are held, relative to the row's own."""
CANCELLED = 1e-9
"""Of what an active row takes of a row that is dependent on them, relative to both: below, it is zero, rounded."""
NEGLIGIBLE = 1e-12
"""In the units of x: a row that is missed by less is met, whatever its own terms are."""
MET: Final = 1e-11
"""What a solution may miss a row by, relative to the row's own terms."""


@kernel()
def _factorise(gram: Mat, rows: Rows, count: int, factor: Mat) -> bool:
    """L L' = gram over the active rows, L in the lower triangle; whether they are independent."""
    for i in range(count):
        for j in range(i + 1):
            total = gram[rows[i], rows[j]]
            for k in range(j):
                total -= factor[i, k] * factor[j, k]
            if j < i:
                factor[i, j] = total / factor[j, j]
            elif total <= DEPENDENT * gram[rows[i], rows[i]]:
                return False
            else:
                factor[i, i] = np.sqrt(total)
    return True


@kernel()
def _divide(factor: Mat, s: Vec, count: int) -> None:
    """s <- (L L')^-1 s."""
    for i in range(count):
        for k in range(i):
            s[i] -= factor[i, k] * s[k]
        s[i] /= factor[i, i]
    for i in range(count - 1, -1, -1):
        for k in range(i + 1, count):
            s[i] -= factor[k, i] * s[k]
        s[i] /= factor[i, i]


@kernel()
def _resume(gram: Mat, free: Vec, u: Vec, rows: Rows, factor: Mat, s: Vec) -> int:
    """Start from the rows that were active before, if their multipliers are positive now; returns how many."""
    count = 0
    for p in range(len(u)):
        if u[p] > 0.0:
            if count == len(s):
                count = 0
                break
            rows[count] = p
            count += 1
    good = _factorise(gram, rows, count, factor)
    if good:
        for i in range(count):
            s[i] = -free[rows[i]]
        _divide(factor, s, count)
        for i in range(count):
            good = good and s[i] > 0.0
    u[:] = 0.0
    if not good:
        return 0
    for i in range(count):
        u[rows[i]] = s[i]
    return count


@kernel()
def _slack(gram: Mat, free: Vec, u: Vec, rows: Rows, count: int, p: int) -> float:
    total: float = free[p]
    for i in range(count):
        total += gram[p, rows[i]] * u[rows[i]]
    return total


@kernel()
def _terms(gram: Mat, size: Vec, u: Vec, rows: Rows, count: int, p: int) -> float:
    """Return the size of what the slack of row p is the sum of."""
    total: float = size[p]
    for i in range(count):
        total += abs(gram[p, rows[i]] * u[rows[i]])
    return total


@kernel()
def _worst(gram: Mat, free: Vec, size: Vec, u: Vec, rows: Rows, count: int) -> int:
    """The row whose slack is the most negative, -1 if none is: beyond what the rounding of its own terms explains."""
    worst = -1
    least = 0.0
    for p in range(len(free)):
        if u[p] == 0.0:
            slack = _slack(gram, free, u, rows, count, p)
            if slack < least and slack < -ROUNDING * _terms(
                gram, size, u, rows, count, p
            ):
                worst = p
                least = slack
    return worst


@kernel()
def _exclude(u: Vec, rows: Rows, s: Vec, count: int, p: int) -> None:
    """Let u (m,) be the multipliers by which row p and the active rows exclude each other: K A'u = 0, slack'u < 0."""
    u[:] = 0.0
    for i in range(count):
        u[rows[i]] = abs(s[i])
    u[p] = 1.0


@kernel()
def _multipliers(gram: Mat, free: Vec, size: Vec, u: Vec, most: int) -> int:
    """The multipliers u (m,) of `minimise`; returns the number of steps, or why there are none."""
    m = len(free)
    width = min(m, most)
    rows = np.empty(m, np.int64)
    factor = np.empty((width, width))
    s = np.empty(width)
    count = _resume(gram, free, u, rows, factor, s)
    steps = 0
    p = _worst(gram, free, size, u, rows, count)
    while p >= 0:
        steps += 1
        if steps > 50 + 10 * m:
            return CAPPED
        # Raise u_p by t: the slacks of the active rows stay zero if their multipliers fall by t s.
        _factorise(gram, rows, count, factor)
        for i in range(count):
            s[i] = gram[rows[i], p]
        _divide(factor, s, count)
        curvature = gram[p, p]
        blocked = np.inf
        place = -1
        for i in range(count):
            curvature -= gram[rows[i], p] * s[i]
        full = np.inf
        slack = _slack(gram, free, u, rows, count, p) + gram[p, p] * u[p]
        least = CANCELLED
        if curvature > DEPENDENT * gram[p, p] and count < width:
            full = max(0.0, -slack / curvature)
            least = 0.0
        for i in range(count):
            if (
                s[i] > least * np.sqrt(gram[p, p] / gram[rows[i], rows[i]])
                and u[rows[i]] < blocked * s[i]
            ):
                blocked = u[rows[i]] / s[i]
                place = i
        t = min(full, blocked)
        if t == np.inf:
            if -slack >= DOUBT * _terms(gram, size, u, rows, count, p) + NEGLIGIBLE:
                _exclude(u, rows, s, count, p)
                return INFEASIBLE
            if u[p] > 0.0:
                return steps
            free[p] -= slack  # the row is met, but for its rounding
            p = _worst(gram, free, size, u, rows, count)
            continue
        for i in range(count):
            u[rows[i]] -= t * s[i]
        u[p] += t
        if full <= blocked:
            rows[count] = p
            count += 1
            p = _worst(gram, free, size, u, rows, count)
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
    """x = argmin 1/2 x'Px + q'x  s.t.  A x <= b,  E x = e, by the dual active-set method.

        x = K (q + A'u) + k,   w = b - A x = (b - A k) - A K q + D u >= 0,   u >= 0,   u'w = 0,   D = -A K A'

    inverse: K (n, n), of the problem with the equalities alone (quadratic.py);  origin: k (n,);
    image: A K;  slack: b - A k;  gram: D;  u: (m,) the multipliers, which also say where to start.
    Returns the number of steps; INFEASIBLE, CAPPED, or NOT_FINITE if q is not. Where it is INFEASIBLE, u are the
    multipliers of the rows that exclude each other: K A'u = 0, slack'u < 0.
    Source: Goldfarb & Idnani 1983, Mathematical Programming 27, "A numerically stable dual method for solving strictly
    convex quadratic programs"; here with a Cholesky factor of the active part of D, made anew in each step.
    """
    n = len(q)
    m = len(slack)
    for i in range(n):
        if not np.isfinite(q[i]):
            return NOT_FINITE
    free = np.empty(m)
    size = np.empty(m)
    for p in range(m):
        free[p] = slack[p]
        size[p] = abs(slack[p])
        for i in range(n):
            free[p] -= image[p, i] * q[i]
            size[p] += abs(image[p, i] * q[i])
    steps = _multipliers(gram, free, size, u, n)
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
def _misses(row: Vec, bound: float, x: Vec, largest: float, is_equal: bool) -> bool:
    """Whether x is beyond row'x <= bound, or beside row'x = bound, by more than the rounding of the terms."""
    beyond = -bound
    size = abs(bound)
    for i in range(len(x)):
        beyond += row[i] * x[i]
        size += abs(row[i] * x[i])
    if is_equal:
        beyond = abs(beyond)
    # Not `>`: what is not a number is missed.
    return not beyond <= MET * size + ROUNDING * largest + NEGLIGIBLE


@kernel(matrix, vector, matrix, vector, vector)
def is_met(A: Mat, b: Vec, E: Mat, e: Vec, x: Vec) -> bool:
    """Whether A x <= b and E x = e, each row relative to its own terms."""
    largest = 0.0
    for i in range(len(x)):
        largest = max(largest, abs(x[i]))
    good = True
    for p in range(len(b)):
        good = good and not _misses(A[p], b[p], x, largest, False)
    for p in range(len(e)):
        good = good and not _misses(E[p], e[p], x, largest, True)
    return good
