"""Eigenvalues of the matrices of formation laws, for formations of a thousand drones too."""

from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt
from scipy import sparse
from scipy.sparse.linalg import eigsh

from crazychoir.types import Mat, Vec

SINGULAR_SHIFT = 1e-10
"""Share of the largest eigenvalue below 0 around which the smallest eigenvalue is sought, because
the matrix itself may be singular.
"""
UPPER_SHIFT = 1e-3
"""Share of the upper bound above it around which the largest eigenvalue is sought."""

RELATIVE_TOLERANCE = 1e-8
"""Accuracy of the sought eigenvalues, relative to their distance from the place of the search. The
eigenvalues of a flexible formation are too close to each other for more.
"""

Eigenvalues = npt.NDArray[np.floating[Any]] | npt.NDArray[np.complexfloating[Any, Any]]
SparseMatrix: TypeAlias = sparse.csr_array
"""A sparse matrix, rows first."""


@dataclass(frozen=True)
class Spectrum:
    """Eigenvalues of an (n, n) matrix, with eigenvectors."""

    values: Eigenvalues
    """(k,): all eigenvalues, or the smallest and the largest if all are real."""
    vectors: Mat
    """(n, k): their eigenvectors, one a column."""

    @property
    def softest(self) -> Vec:
        """(n,): eigenvector of the smallest eigenvalue."""
        mode: Vec = self.vectors[:, np.abs(self.values).argmin()]
        return mode


def is_symmetric(matrix: SparseMatrix) -> bool:
    """Return whether a matrix equals its transpose, to the last bit."""
    return bool((matrix != matrix.T).nnz == 0)


def find_extremes(symmetric: SparseMatrix, upper: float) -> Spectrum:
    """Return the smallest and the largest eigenvalue.

    symmetric: (n, n), positive semi-definite.
    upper: no eigenvalue is above.
    """
    start = np.random.default_rng(0).normal(size=symmetric.shape[0])
    matrix = symmetric.tocsc()
    places = (-SINGULAR_SHIFT * upper, (1.0 + UPPER_SHIFT) * upper)
    pairs = [
        eigsh(matrix, k=1, sigma=place, v0=start, tol=RELATIVE_TOLERANCE)
        for place in places
    ]
    return Spectrum(
        np.concatenate([values for values, _ in pairs]),
        np.hstack([vectors for _, vectors in pairs]),
    )


def find_all(matrix: SparseMatrix) -> Spectrum:
    """Return all eigenvalues of a matrix; they are real if it is symmetric."""
    dense: Mat = matrix.toarray()
    if is_symmetric(matrix):
        return Spectrum(*np.linalg.eigh(dense))
    return Spectrum(*np.linalg.eig(dense))
