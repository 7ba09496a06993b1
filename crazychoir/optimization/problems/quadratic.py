"""Strictly convex quadratic programs over a polyhedron: factorised once, solved often."""

from dataclasses import dataclass
from math import isfinite
from typing import Final

import numpy as np
from scipy.linalg import qr, solve_triangular

from crazychoir.optimization.problems import active_set
from crazychoir.optimization.problems.active_set import (
    ACTIVE_SET_STATUS,
    ACTIVE_SET_TOLERANCES,
    Rows,
)
from crazychoir.optimization.problems.linear import Mask
from crazychoir.types import Mat, Vec


@dataclass(frozen=True, slots=True)
class QuadraticTolerances:
    """Relative tolerances of quadratic programs."""

    flat_eigenvalue: float = 1e-7
    """A Hessian has no unique minimum if an eigenvalue is below this, relative to the largest.
    """
    dependent_rows: float = 1e-10
    """Equalities are dependent if a singular value is below this.

    The singular values are those of the unit rows, relative to the largest.
    """
    rounded_zero: float = 1e-14
    """A singular value of the unit rows below this is a rounded zero, relative to the largest.
    """
    consistent_row: float = 1e-9
    """Tolerance of a row that no x changes, relative to the row's own terms.

    It covers the rounding of the data.
    """


QUADRATIC_TOLERANCES = QuadraticTolerances()


DOUBTFUL_STATUS = "rows so nearly dependent that rounding decides"
INACCURATE_STATUS = "inaccurate: double precision cannot tell whether all rows hold; scale the rows and variables alike"
QUADRATIC_STATUS_TEXTS = {
    ACTIVE_SET_STATUS.infeasible: "infeasible",
    ACTIVE_SET_STATUS.step_limit: "too many steps",
    ACTIVE_SET_STATUS.not_finite: "not finite",
}
UNDECIDED_STATUSES: Final = (
    DOUBTFUL_STATUS,
    INACCURATE_STATUS,
    QUADRATIC_STATUS_TEXTS[ACTIVE_SET_STATUS.step_limit],
)
"""Statuses that leave open whether there is a solution: another method may find it."""


@dataclass(frozen=True)
class Polyhedron:
    """The set {x in R^n : A x <= b, E x = e}, with rows scaled to length one."""

    A: Mat
    """(m, n) rows of the inequalities."""
    b: Vec
    """(m,) bounds of the inequalities."""
    E: Mat
    """(l, n) rows of the equalities."""
    e: Vec
    """(l,) right-hand sides of the equalities."""

    @classmethod
    def of(cls, A: Mat, b: Vec, E: Mat, e: Vec) -> "Polyhedron":
        """Build the set from rows of any length. Rows of zeros that always hold are left out."""
        upper, equal = (np.asarray(bounds, float) for bounds in (b, e))
        return cls(
            *scale_rows(A, upper, upper < -ACTIVE_SET_TOLERANCES.negligible_miss)[:2],
            *scale_rows(
                E, equal, np.abs(equal) > ACTIVE_SET_TOLERANCES.negligible_miss
            )[:2],
        )

    @property
    def n(self) -> int:
        """Dimension of x."""
        return int(self.A.shape[1])


class AffineHull:
    """The affine set {x in R^n : E x = e}, for many right-hand sides e.

    It provides the directions of the set, a point in it, and the verdict whether it is empty.
    Some independent rows are the basis. Every other row r is a combination of rows i of the basis,
    so the set is empty unless e is the same combination:

        E_r = sum_i c_ri E_i,   e_r = sum_i c_ri e_i

    E: (l, n), rows of length one or zero
    least: singular values below this count as zero, relative to the largest
    null: N (n, n - rank), E N = 0, N'N = I
    lift: (n, l), maps e to the shortest x that meets the rows of the basis
    basis: (rank,) indices of the rows of the basis
    others: (l - rank,) indices of the other rows
    shares: c (l - rank, rank)
    """

    def __init__(
        self, E: Mat, least: float = QUADRATIC_TOLERANCES.dependent_rows
    ) -> None:
        directions, factor, order = (
            qr(E.T, pivoting=True)
            if E.size
            else (np.eye(E.shape[1]), E.T, np.arange(len(E)))
        )
        sizes = np.abs(np.diag(factor))
        rank = int(np.sum(sizes > least * sizes.max(initial=0.0)))
        span = directions[:, :rank]
        triangle = factor[:rank, :rank]
        self.E = E
        self.basis = order[:rank]
        self.others = order[rank:]
        self.null = np.ascontiguousarray(directions[:, rank:])
        self.lift = np.zeros(E.T.shape)
        self.shares = np.zeros((len(E) - rank, rank))
        if rank:
            self.lift[:, self.basis] = solve_triangular(triangle, span.T).T
            self.shares = solve_triangular(triangle, factor[:rank, rank:]).T
        is_rounded = sizes[rank:].max(
            initial=0.0
        ) <= QUADRATIC_TOLERANCES.rounded_zero * sizes.max(initial=0.0)
        self._finer = (
            None if is_rounded else AffineHull(E, QUADRATIC_TOLERANCES.rounded_zero)
        )

    def point(self, e: Vec) -> Vec:
        """Return the shortest x (n,) that meets the rows of the basis, up to rounding."""
        x = self.lift @ e
        refined: Vec = x + self.lift @ (e - self.E @ x)
        return refined

    def sizes(self, x: Vec, e: Vec) -> Vec:
        """Return |E| |x| + |e| (l,): how large the terms of each row are at x (n,).

        Rounding errors of E x - e are judged relative to it.
        """
        found: Vec = np.abs(self.E) @ np.abs(x) + np.abs(e)
        return found

    def gaps(self, x: Vec, e: Vec) -> Vec:
        """Return e_r - sum_i c_ri e_i (l - rank,) for the rows outside the basis.

        An entry is 0 if it is not larger than the rounding of the terms of these rows at x (n,).
        """
        gap = e[self.others] - self.shares @ e[self.basis]
        size = self.sizes(x, e)
        allowed = (
            QUADRATIC_TOLERANCES.consistent_row
            * (size[self.others] + np.abs(self.shares) @ size[self.basis])
            + ACTIVE_SET_TOLERANCES.negligible_miss
        )
        found: Vec = np.where(np.abs(gap) <= allowed, 0.0, gap)
        return found

    def verdict(self, x: Vec, e: Vec) -> str:
        """Return "" if the set has a point, else the reason why it has none.

        x: (n,), a point that meets the rows of the basis

        The reason is "infeasible", or DOUBTFUL_STATUS if the rows are nearly dependent, and only a
        point very far away meets all of them.
        """
        if not len(self.others) or not self.gaps(x, e).any():
            return ""
        if self._finer is None or self._finer.verdict(self._finer.point(e), e):
            return QUADRATIC_STATUS_TEXTS[ACTIVE_SET_STATUS.infeasible]
        return DOUBTFUL_STATUS


@dataclass(frozen=True, slots=True)
class InequalityRows:
    """How the rows of A x <= b vary within an affine set, for many bounds b.

    The columns of N are the directions of the set.
    """

    free: Mat
    """A N (m, n - rank), the rows along the directions of the set."""
    is_fixed: Mask
    """(m,) True for a row that has the same value everywhere in the set."""
    sizes: Mat
    """|A| (m, n)."""
    shares: Mat
    """(m, l) shares of the equalities in each row, as absolute values."""

    @classmethod
    def of(cls, A: Mat, hull: AffineHull) -> "InequalityRows":
        """Return the rows A (m, n), of length one, within an affine set."""
        free = A @ hull.null
        return cls(
            free=free,
            is_fixed=np.linalg.norm(free, axis=1)
            <= QUADRATIC_TOLERANCES.dependent_rows,
            sizes=np.abs(A),
            shares=np.abs(A @ hull.lift),
        )

    def misses_fixed_row(self, slack: Vec, size: Vec, equal_sizes: Vec) -> bool:
        """Return True if a fixed row is violated by more than the rounding of the data.

        slack: (m,) b - A x at a point x of the set
        size: (m,) of the terms of each row at x
        equal_sizes: (l,) of the terms of each equality at x
        """
        known = size + self.shares @ equal_sizes
        is_missed = (
            slack
            < -QUADRATIC_TOLERANCES.consistent_row * known
            - ACTIVE_SET_TOLERANCES.negligible_miss
        )
        return bool(is_missed[self.is_fixed].any())

    def exclude_each_other(self, rows: Rows, slack: Vec, size: Vec) -> bool:
        """Return True if it is certain that no x of the set meets all of these rows.

        The singular vector of the smallest singular value is the proof, if that value is zero
        within QUADRATIC_TOLERANCES.dependent_rows and not just small.

        rows: (k,) indices of the rows
        slack: (k,) b - A x of these rows at a point x of the set
        size: (k,) of the terms of these rows at x
        """
        lengths = np.linalg.norm(self.free[rows], axis=1)
        left, sizes, _ = np.linalg.svd(self.free[rows] / lengths[:, None])
        weights = left[:, -1] if left[:, -1].sum() > 0.0 else -left[:, -1]
        least = 0.0 if len(rows) > len(sizes) else sizes[-1]
        gap = -float((slack / lengths) @ weights)
        is_seen = (
            gap
            > QUADRATIC_TOLERANCES.consistent_row
            * float((size / lengths) @ np.abs(weights))
            + ACTIVE_SET_TOLERANCES.negligible_miss
        )
        return bool(
            least <= QUADRATIC_TOLERANCES.dependent_rows
            and is_seen
            and weights.min() >= -QUADRATIC_TOLERANCES.consistent_row
        )


@dataclass
class QuadraticProgram:
    """A strictly convex quadratic program, solved for many linear costs p.

        min 1/2 x'Px + q'x + p'x  s.t.  A x <= b, E x = e

        K = -N (N'PN)^-1 N',   k = x_0 + K P x_0,   E x_0 = e

    The columns of N span the null space of E.

    Without inequalities, x = K (q + p) + k is the solution in closed form. With inequalities,
    `active_set.minimise` solves the program and starts from the multipliers u of the last solution.
    A row of A in the span of E has the same value for all x. Such a row is checked here, and the
    active-set method ignores it.

    u: (m,) >= 0, the multipliers of A x <= b
    verdict: the reason why no p has a solution, or ""

    Raises np.linalg.LinAlgError if N'PN is not positive definite.
    """

    P: Mat
    """(n, n), symmetric: the Hessian."""
    q: Vec
    """(n,) the linear cost."""
    over: Polyhedron
    """The set of feasible x."""

    def __post_init__(self) -> None:
        over = self.over
        self.hull = AffineHull(self.over.E)
        null = self.hull.null
        self.inverse = np.ascontiguousarray(
            -null
            @ np.linalg.solve(require_positive_definite(null.T @ self.P @ null), null.T)
        )
        self._rows = InequalityRows.of(over.A, self.hull)
        self._A = np.ascontiguousarray(over.A)
        self._E = np.ascontiguousarray(over.E[self.hull.basis])
        self.image = np.ascontiguousarray(over.A @ self.inverse)
        self.gram = np.ascontiguousarray(-self.image @ over.A.T)
        self.image[self._rows.is_fixed] = 0.0
        self.gram[self._rows.is_fixed] = 0.0
        self.gram[:, self._rows.is_fixed] = 0.0
        self.u = np.zeros(len(over.b))
        self.name = "active set" if len(over.b) else "closed form"
        x0 = self.hull.point(over.e)
        self._place(x0 + self.inverse @ (self.P @ x0), over.b, over.e)

    def _place(self, origin: Vec, b: Vec, e: Vec) -> None:
        """Set the point `origin` (n,) of the equalities, and check the rows that no x changes."""
        self.origin = origin
        self._b = np.ascontiguousarray(b, float)
        self._e = np.asarray(e, float)
        self._basis_e = self._e[self.hull.basis]
        rows = self._rows
        size = rows.sizes @ np.abs(origin) + np.abs(b)
        slack = b - self.over.A @ origin
        self.verdict = self.hull.verdict(origin, e)
        if (
            rows.is_fixed.any()
            and not self.verdict
            and rows.misses_fixed_row(slack, size, self.hull.sizes(origin, e))
        ):
            self.verdict = QUADRATIC_STATUS_TEXTS[ACTIVE_SET_STATUS.infeasible]
        slack[
            rows.is_fixed | (np.abs(slack) <= ACTIVE_SET_TOLERANCES.rounding * size)
        ] = 0.0
        self.slack = slack

    def solve(self, p: Vec) -> Vec | str:
        """Return the solution x (n,), or the reason why there is none.

        The reason is a text of QUADRATIC_STATUS_TEXTS or UNDECIDED_STATUSES.
        """
        q = self.q + p
        if self.verdict:
            return self.verdict
        if not len(self.slack):
            x = self.inverse @ q + self.origin
            return (
                x
                if isfinite(x.sum())
                else QUADRATIC_STATUS_TEXTS[ACTIVE_SET_STATUS.not_finite]
            )
        x = np.empty_like(self.origin)
        steps = active_set.minimise(
            self.inverse, self.origin, self.image, self.slack, self.gram, q, self.u, x
        )
        if steps >= 0:
            return x if self._is_met(x) else self._polished(x)
        if steps == ACTIVE_SET_STATUS.infeasible:
            is_certain = self._is_surely_infeasible()
            self.u[:] = 0.0
            return (
                QUADRATIC_STATUS_TEXTS[ACTIVE_SET_STATUS.infeasible]
                if is_certain
                else DOUBTFUL_STATUS
            )
        return QUADRATIC_STATUS_TEXTS[steps]

    def _polished(self, x: Vec) -> Vec | str:
        """Return the point nearest to x (n,) that meets the equalities and the active rows.

        Returns INACCURATE_STATUS if that point misses another row. Where rows are nearly dependent, the
        active-set method loses twice as many digits as this refinement.
        """
        rows = np.flatnonzero(self.u)
        C = np.vstack([self.over.E, self.over.A[rows]])
        d = np.concatenate([self._e, self._b[rows]])
        for _ in range(2):
            x = (
                x
                + np.linalg.lstsq(
                    C, d - C @ x, rcond=QUADRATIC_TOLERANCES.rounded_zero
                )[0]
            )
        return x if self._is_met(x) else INACCURATE_STATUS

    def _is_met(self, x: Vec) -> bool:
        """Return True if x (n,) meets the inequalities and the basis of the equalities.

        The other equalities follow from the basis.
        """
        return bool(active_set.is_met(self._A, self._b, self._E, self._basis_e, x))

    def _is_surely_infeasible(self) -> bool:
        """Return True if it is certain that the rows with multipliers exclude each other."""
        rows = np.flatnonzero(self.u)
        size = self._rows.sizes[rows] @ np.abs(self.origin) + np.abs(self._b[rows])
        return self._rows.exclude_each_other(rows, self.slack[rows], size)


@dataclass
class MovingProgram(QuadraticProgram):
    """A quadratic program, solved for many linear costs p and right-hand sides b and e.

        min 1/2 x'Px + q'x + p'x  s.t.  A x <= b, E x = e

        k = (I + K P) E^+ e,   so that only the right-hand sides change

    The rows of A have length one. The rows of E have length one or zero.
    """

    def __post_init__(self) -> None:
        super().__post_init__()
        self.lift = (np.eye(len(self.P)) + self.inverse @ self.P) @ self.hull.lift

    def move(self, b: Vec, e: Vec) -> None:
        """Replace the right-hand sides b (m,) and e (l,).

        The next solve starts from the last solution all the same.
        """
        self._place(self.lift @ e, b, e)


def require_positive_definite(H: Mat) -> Mat:
    """Return the symmetric matrix H if it is positive definite; else raise LinAlgError."""
    if len(H):
        values = np.linalg.eigvalsh(H)
        if not values[0] > QUADRATIC_TOLERANCES.flat_eigenvalue * max(
            values[-1], QUADRATIC_TOLERANCES.flat_eigenvalue
        ):
            raise np.linalg.LinAlgError(
                f"smallest eigenvalue {values[0]:g} of {values[-1]:g}"
            )
    return H


def scale_rows(rows: Mat, bounds: Vec, keep: Mask) -> tuple[Mat, Vec, Vec]:
    """Return the rows scaled to length one, their bounds, and the lengths before scaling.

    rows: (m, n)
    bounds: (m,)
    keep: (m,), True where a row of zeros is kept; elsewhere rows of zeros are left out
    """
    rows = np.asarray(rows, float)
    bounds = np.asarray(bounds, float)
    largest = np.abs(rows).max(axis=1, initial=0.0)
    kept = (largest > 0.0) | keep
    largest = np.where(largest > 0.0, largest, 1.0)[kept]
    # Divide by the largest entry first: the squares of very large or very small entries would
    # overflow or vanish.
    rows = rows[kept] / largest[:, None]
    length = np.linalg.norm(rows, axis=1)
    length = np.where(length > 0.0, length, 1.0)
    return (
        np.ascontiguousarray(rows / length[:, None]),
        bounds[kept] / largest / length,
        largest * length,
    )
