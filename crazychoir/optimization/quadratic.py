"""Strictly convex quadratic programs over a polyhedron, factorised once and solved often."""

from dataclasses import dataclass
from math import isfinite

import numpy as np

from crazychoir.optimization.active_set import CAPPED, INFEASIBLE, NOT_FINITE, minimise
from crazychoir.optimization.linear import Mask
from crazychoir.types import Mat, Vec

FLAT = 1e-7
"""A Hessian with eigenvalues below this, relative to the largest, has no unique minimum."""
PARALLEL = 1e-9
"""Of singular values, relative to the largest: equalities below are dependent."""
WORDS = {INFEASIBLE: "infeasible", CAPPED: "too many steps", NOT_FINITE: "not finite"}


@dataclass(frozen=True)
class Polyhedron:
    """{x in R^n : A x <= b, E x = e}, its rows scaled to length one.

    A: (m, n);  b: (m,);  E: (l, n);  e: (l,).
    """

    A: Mat
    b: Vec
    E: Mat
    e: Vec

    @classmethod
    def of(cls, A: Mat, b: Vec, E: Mat, e: Vec) -> "Polyhedron":
        """From rows of any length; those of zeros that always hold are left out."""
        return cls(*_scaled(A, b, keep=b < 0.0), *_scaled(E, e, keep=e != 0.0))

    @property
    def n(self) -> int:
        """Dimension of x."""
        return int(self.A.shape[1])


@dataclass
class QuadraticProgram:
    """min 1/2 x'Px + q'x + p'x  s.t.  A x <= b, E x = e, for many p.

        K = -N (N'PN)^-1 N',   k = x_0 + K P x_0,   E x_0 = e,   the columns of N span the null space of E

    x = K (q + p) + k solves it without the inequalities, in closed form; with them `active_set.minimise` does, from the
    multipliers u of the last solution. Raises np.linalg.LinAlgError if N'PN is not positive definite.
    P: (n, n), symmetric;  q: (n,);  u: (m,) >= 0, the multipliers of A x <= b.
    """

    P: Mat
    q: Vec
    over: Polyhedron

    def __post_init__(self) -> None:
        over, (x0, null) = self.over, affine_hull(self.over.E, self.over.e)
        self.inverse = np.ascontiguousarray(-null @ np.linalg.solve(positive(null.T @ self.P @ null), null.T))
        self.origin = x0 + self.inverse @ (self.P @ x0)
        self.image = np.ascontiguousarray(over.A @ self.inverse)
        self.slack = over.b - over.A @ self.origin
        self.gram = np.ascontiguousarray(-self.image @ over.A.T)
        self.u = np.zeros(len(over.b))
        self.name = "active set" if len(over.b) else "closed form"

    def solve(self, p: Vec) -> Vec | str:
        """The solution x (n,), or why there is none: "infeasible", "too many steps", "not finite"."""
        q = self.q + p
        if not len(self.slack):
            x = self.inverse @ q + self.origin
            return x if isfinite(x.sum()) else WORDS[NOT_FINITE]
        x = np.empty_like(self.origin)
        steps = minimise(self.inverse, self.origin, self.image, self.slack, self.gram, q, self.u, x)
        return x if steps >= 0 else WORDS[steps]


@dataclass
class MovingProgram(QuadraticProgram):
    """min 1/2 x'Px + q'x + p'x  s.t.  A x <= b, E x = e, for many p, b and e.

        k = (I + K P) E^+ e,   so that the right-hand sides alone move

    The rows of A are of length one, those of E independent.
    """

    def __post_init__(self) -> None:
        super().__post_init__()
        self.lift = (np.eye(len(self.P)) + self.inverse @ self.P) @ np.linalg.pinv(self.over.E)

    def move(self, b: Vec, e: Vec) -> None:
        """Other right-hand sides b (m,) and e (l,); the next solution starts from the last one all the same."""
        self.origin = self.lift @ e
        self.slack = b - self.over.A @ self.origin


def affine_hull(E: Mat, e: Vec) -> tuple[Vec, Mat]:
    """A point x_0 (n,) with E x_0 = e, and N (n, n - rank E) with E N = 0, N'N = I."""
    if not len(e):
        return np.zeros(E.shape[1]), np.eye(E.shape[1])
    left, sizes, right = np.linalg.svd(E)
    rank = int(np.sum(sizes > PARALLEL * sizes[0]))
    x0 = right[:rank].T @ ((left[:, :rank].T @ e) / sizes[:rank])
    return x0, np.ascontiguousarray(right[rank:].T)


def positive(H: Mat) -> Mat:
    """H, symmetric, if it is positive definite; else raises LinAlgError."""
    if len(H):
        values = np.linalg.eigvalsh(H)
        if not values[0] > FLAT * max(values[-1], FLAT):
            raise np.linalg.LinAlgError(f"smallest eigenvalue {values[0]:g} of {values[-1]:g}")
    return H


def _scaled(rows: Mat, bounds: Vec, keep: Mask) -> tuple[Mat, Vec]:
    """Rows of length one; zero rows only where `keep` says so."""
    rows, bounds = np.asarray(rows, float), np.asarray(bounds, float)
    length = np.linalg.norm(rows, axis=1)
    kept = (length > 0.0) | keep
    length = np.where(length > 0.0, length, 1.0)[kept]
    return np.ascontiguousarray(rows[kept] / length[:, None]), bounds[kept] / length
