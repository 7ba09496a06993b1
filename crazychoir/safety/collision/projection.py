"""The nearest acceleration that half spaces allow; if not all can hold, the last ones give way."""

import math
from typing import NamedTuple

from crazychoir.numerics.kernels import kernel, memory, table, vector
from crazychoir.numerics.math3d import Triple, dot
from crazychoir.types import Vec


class ProjectionTolerances(NamedTuple):
    """Tolerances of the projection onto half spaces."""

    parallel: float = 1e-9
    """Squared sine of the angle between two planes, below which they count as parallel."""
    violation: float = 1e-10
    """m/s2 by which a half space may be violated, for rounding."""
    slack: float = 1e-6
    """m/s2 by which a half space is relaxed beyond its least violation.

    Otherwise the others might leave a single point of it.
    """
    far_distance: float = 1e3
    """m/s2: distance of a far point in some direction.

    The point of a bounded polytope nearest to it is the polytope's farthest point in that direction.
    """


PROJECTION_TOLERANCES = ProjectionTolerances()


@kernel()
def _add_scaled(p: Triple, s: float, n: Triple) -> Triple:
    """Return p + s n."""
    return (p[0] + s * n[0], p[1] + s * n[1], p[2] + s * n[2])


@kernel()
def _get_normal(planes: Vec, k: int) -> Triple:
    """Return the normal of row k."""
    return (planes[k, 0], planes[k, 1], planes[k, 2])


@kernel()
def _project_on_line(
    q: Triple, along: Triple, planes: Vec, m: int
) -> tuple[bool, Triple]:
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
        n = _get_normal(planes, k)
        rate = dot(n, along)
        lack = planes[k, 3] - dot(n, q)
        if rate * rate < PROJECTION_TOLERANCES.parallel:
            if lack > 1e-7:
                return False, q
        elif rate > 0.0:
            low = max(low, lack / rate)
        else:
            high = min(high, lack / rate)
    if low > high + PROJECTION_TOLERANCES.violation:
        return False, q
    return True, _add_scaled(q, min(max(0.0, low), high), along)


@kernel()
def _project_on_plane(u: Triple, planes: Vec, at: int) -> tuple[bool, Triple]:
    """Return the point of plane `at` nearest to u within the half spaces before it.

    Returns (False, _) if there is no such point.
    """
    n = _get_normal(planes, at)
    start = _add_scaled(u, planes[at, 3] - dot(n, u), n)
    q = start
    for k in range(at):
        other = _get_normal(planes, k)
        lack = planes[k, 3] - dot(other, q)
        if lack <= PROJECTION_TOLERANCES.violation:
            continue
        cosine = dot(n, other)
        side = _add_scaled(
            other, -cosine, n
        )  # normal of the half space within the plane
        length = dot(side, side)
        if length < PROJECTION_TOLERANCES.parallel:
            if lack > 1e-7:
                return False, q
            continue
        q = _add_scaled(start, (planes[k, 3] - dot(other, start)) / length, side)
        root = math.sqrt(length)
        along = (
            (n[1] * side[2] - n[2] * side[1]) / root,
            (n[2] * side[0] - n[0] * side[2]) / root,
            (n[0] * side[1] - n[1] * side[0]) / root,
        )
        found, q = _project_on_line(q, along, planes, k)
        if not found:
            return False, q
    return True, q


@kernel()
def _find_nearest_within(u: Triple, planes: Vec, m: int) -> tuple[int, Triple]:
    """Return m and the point nearest to u in the first m half spaces.

    If a half space leaves no point, return its row instead; the point is then meaningless.
    """
    q = u
    for k in range(m):
        if (
            dot(_get_normal(planes, k), q)
            < planes[k, 3] - PROJECTION_TOLERANCES.violation
        ):
            found, at = _project_on_plane(u, planes, k)
            if not found:
                return k, q
            q = at
    return m, q


@kernel()
def find_nearest_point(u: Triple, planes: Vec, m: int) -> tuple[int, Triple]:
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
    relaxed = 0
    last = -1
    slack = PROJECTION_TOLERANCES.slack
    k, q = _find_nearest_within(u, planes, m)
    while k < m:
        # Rounding has left no point, for example of almost parallel planes: double the slack.
        if k == last:
            slack *= 2.0
            planes[k, 3] -= slack
        else:
            found, far = _find_nearest_within(
                _add_scaled(
                    (0.0, 0.0, 0.0),
                    PROJECTION_TOLERANCES.far_distance,
                    _get_normal(planes, k),
                ),
                planes,
                k,
            )
            if found == k:
                planes[k, 3] = min(planes[k, 3], dot(_get_normal(planes, k), far))
            planes[k, 3] -= PROJECTION_TOLERANCES.slack
            relaxed = relaxed + 1
            last = k
            slack = PROJECTION_TOLERANCES.slack
        k, q = _find_nearest_within(u, planes, m)
    return relaxed, q


@kernel(vector, table, memory)
def project(u: Vec, planes: Vec, out: Vec) -> int:
    """Apply `find_nearest_point` to arrays, and return the number of relaxed half spaces.

    u: (3,)
    planes: (m, 4), changed as in `find_nearest_point`
    out: (3,): the result
    """
    relaxed, q = find_nearest_point((u[0], u[1], u[2]), planes, planes.shape[0])
    for c in range(3):
        out[c] = q[c]
    return relaxed
