"""The nearest acceleration that half spaces allow; if not all can hold, the last ones give way."""

import math

from crazychoir.numerics.kernels import kernel, memory, table, vector
from crazychoir.numerics.math3d import Triple, dot
from crazychoir.types import Vec

PARALLEL = 1e-9
"""Squared sine of the angle between two planes, below which they count as parallel."""
EXACT = 1e-10
"""m/s2 by which a half space may be violated, for rounding."""
SLACK = 1e-6
"""m/s2 by which a half space is relaxed beyond its least violation.

Otherwise the others might leave a single point of it.
"""
FAR = 1e3
"""m/s2: distance of a far point in some direction.

The point of a bounded polytope nearest to it is the polytope's farthest point in that direction.
"""


@kernel()
def _plus(p: Triple, s: float, n: Triple) -> Triple:
    """Return p + s n."""
    return (p[0] + s * n[0], p[1] + s * n[1], p[2] + s * n[2])


@kernel()
def _row(planes: Vec, k: int) -> Triple:
    """Return the normal of row k."""
    return (planes[k, 0], planes[k, 1], planes[k, 2])


@kernel()
def _on_line(q: Triple, along: Triple, planes: Vec, m: int) -> tuple[bool, Triple]:
    """Return the point of a line nearest to q within the first m half spaces.

    q: a point of the line
    along: unit vector of the line
    planes: rows n_k, b_k
    m: number of half spaces
    Returns (False, _) if there is no such point.
    """
    low = -math.inf
    high = math.inf
    for k in range(m):
        n = _row(planes, k)
        rate = dot(n, along)
        lack = planes[k, 3] - dot(n, q)
        if rate * rate < PARALLEL:
            if lack > 1e-7:
                return False, q
        elif rate > 0.0:
            low = max(low, lack / rate)
        else:
            high = min(high, lack / rate)
    if low > high + EXACT:
        return False, q
    return True, _plus(q, min(max(0.0, low), high), along)


@kernel()
def _on_plane(u: Triple, planes: Vec, at: int) -> tuple[bool, Triple]:
    """Return the point of plane `at` nearest to u within the half spaces before it.

    Returns (False, _) if there is no such point.
    """
    n = _row(planes, at)
    start = _plus(u, planes[at, 3] - dot(n, u), n)
    q = start
    for k in range(at):
        other = _row(planes, k)
        lack = planes[k, 3] - dot(other, q)
        if lack <= EXACT:
            continue
        cosine = dot(n, other)
        side = _plus(other, -cosine, n)  # normal of the half space within the plane
        length = dot(side, side)
        if length < PARALLEL:
            if lack > 1e-7:
                return False, q
            continue
        q = _plus(start, (planes[k, 3] - dot(other, start)) / length, side)
        root = math.sqrt(length)
        along = (
            (n[1] * side[2] - n[2] * side[1]) / root,
            (n[2] * side[0] - n[0] * side[2]) / root,
            (n[0] * side[1] - n[1] * side[0]) / root,
        )
        found, q = _on_line(q, along, planes, k)
        if not found:
            return False, q
    return True, q


@kernel()
def _nearest(u: Triple, planes: Vec, m: int) -> tuple[int, Triple]:
    """Return m and the point nearest to u in the first m half spaces.

    If a half space leaves no point, return its row instead; the point is then meaningless.
    """
    q = u
    for k in range(m):
        if dot(_row(planes, k), q) < planes[k, 3] - EXACT:
            found, at = _on_plane(u, planes, k)
            if not found:
                return k, q
            q = at
    return m, q


@kernel()
def nearest(u: Triple, planes: Vec, m: int) -> tuple[int, Triple]:
    """Return the number of relaxed half spaces, and the point of the half spaces nearest to u.

        min |x - u|^2   s.t.   n_k . x >= b_k,   k = 0 ... m - 1

    The rows are added one by one. A half space that holds changes nothing. Otherwise the answer
    lies on its plane, where the same is done in two dimensions, and there in one. A half space that
    leaves no point is moved to b_k = max n_k . x over those before it. This is its least violation
    with all earlier ones unchanged, so the rows are in the order of their importance.

    u: (3,)
    planes: (>= m, 4): rows n_k (3,) of length 1, b_k; the first six are a box; b_k of relaxed ones
        is changed
    m: number of half spaces
    Source: Seidel 1991, Small-dimensional linear programming and convex hulls made easy, for the
        order of the steps.
    """
    relaxed, last, slack, (k, q) = 0, -1, SLACK, _nearest(u, planes, m)
    while k < m:
        # Rounding has left no point, for example of almost parallel planes: double the slack.
        if k == last:
            slack *= 2.0
            planes[k, 3] -= slack
        else:
            found, far = _nearest(
                _plus((0.0, 0.0, 0.0), FAR, _row(planes, k)), planes, k
            )
            if found == k:
                planes[k, 3] = min(planes[k, 3], dot(_row(planes, k), far))
            planes[k, 3] -= SLACK
            relaxed = relaxed + 1
            last = k
            slack = SLACK
        k, q = _nearest(u, planes, m)
    return relaxed, q


@kernel(vector, table, memory)
def project(u: Vec, planes: Vec, out: Vec) -> int:
    """Apply `nearest` to arrays, and return the number of relaxed half spaces.

    u: (3,)
    planes: (m, 4), changed as in `nearest`
    out: (3,): the result
    """
    relaxed, q = nearest((u[0], u[1], u[2]), planes, planes.shape[0])
    for c in range(3):
        out[c] = q[c]
    return relaxed
