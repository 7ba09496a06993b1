"""Least squares with the set-point as instrument, which feedback does not bias.

In a closed loop the motors answer disturbances, so plain least squares finds too weak torques. The set-point knows
nothing of disturbances: only what it explains of the flight tells the parameters.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares

from crazychoir.types import Bools, Ints, Mat, Vec

INSTRUMENT_LAGS = (*range(10), *range(10, 40, 4), *range(40, 190, 15))
"""Rows by which the set-point is shifted to make instruments: up to 1.8 s."""
BLOCK_ROWS = 200
"""Rows of a part that counts as independent of the others: 2 s."""
LEAST_STRENGTH = 1e-10
"""Instruments count as dependent below this share of the largest eigenvalue of their products."""
JACOBIAN_STEP = 0.02
"""Step of the differences that give standard errors, in scales."""
FEWEST_BLOCKS = 5
"""Least number of such parts for a standard error."""


@dataclass(frozen=True, slots=True)
class IdentifiedValues:
    """Parameters of one flight with their uncertainty."""

    values: Vec
    """(k,) parameters."""
    covariance: Mat
    """(k, k): their covariance, from parts of 2 s that count as independent."""

    @property
    def deviations(self) -> Vec:
        """(k,): standard errors."""
        return np.asarray(np.sqrt(np.maximum(np.diag(self.covariance), 0.0)))


def shift_setpoint(sp: Mat) -> Mat:
    """Return the set-points (n, c), shifted by each of INSTRUMENT_LAGS: (n, c lags)."""
    shifted = []
    for column in (sp - sp.mean(axis=0)).T:
        for lag in INSTRUMENT_LAGS:
            late = np.roll(column, lag)
            late[:lag] = column[0]
            shifted.append(late)
    return np.column_stack(shifted)


def make_basis(instruments: Mat) -> Mat:
    """Return an orthonormal basis (n, k) of the instruments (n, m); dependent ones are left out."""
    scale = np.linalg.norm(instruments, axis=0)
    kept = instruments[:, scale > LEAST_STRENGTH * scale.max()]
    unit = kept / np.linalg.norm(kept, axis=0)
    strength, directions = np.linalg.eigh(unit.T @ unit)
    strong = strength > LEAST_STRENGTH * strength[-1]
    return np.asarray(unit @ (directions[:, strong] / np.sqrt(strength[strong])))


def solve_linear(y: Vec, x: Mat, basis: Mat | None, block: Ints) -> IdentifiedValues:
    """Solve y = x b in the space of the instruments.

        b = (Z^T x)^-1 Z^T y,   Z = Q Q^T x

    y: (n,)
    x: (n, k): regressors
    basis: (n, m): Q, an orthonormal basis of the instruments; None: Z = x
    block: (n,): number of the independent part of each row
    """
    z = x if basis is None else basis @ (basis.T @ x)
    inverse: Mat = np.asarray(np.linalg.pinv(z.T @ x), float)
    values = inverse @ (z.T @ y)
    return IdentifiedValues(values, _sandwich(inverse, z, y - x @ values, block))


@dataclass(frozen=True, slots=True)
class ParameterPriors:
    """What is known of k parameters before a fit."""

    expected: Vec
    """(k,): first guesses, and expected values."""
    deviations: Vec
    """(k,): how far the true values may be from the expected ones; infinite for what is not known."""
    smallest: Vec
    """(k,): smallest values."""
    largest: Vec
    """(k,): largest values."""
    scales: Vec
    """(k,): typical values, by which the solver divides."""


def solve_nonlinear(
    residual: Callable[[Vec], Vec],
    priors: ParameterPriors,
    basis: Mat | None,
    block: Ints,
) -> IdentifiedValues:
    """Return the parameters with the least residuals in the space of the instruments.

        |Q^T e(x)|^2 / s^2 + sum_k ((x_k - expected_k) / deviation_k)^2   is least

    residual: returns e (n,) for parameters x (k,)
    basis: (n, m): Q, an orthonormal basis of the instruments; None: plain least squares
    block: (n,): number of the independent part of each row
    """
    scales = priors.scales
    noise = 1.0

    def project(x: Vec) -> Vec:
        e = residual(x * scales) / noise
        told = e if basis is None else basis.T @ e
        known = (x * scales - priors.expected) / priors.deviations
        return np.concatenate([told, known])

    values = priors.expected
    for _ in range(2):
        noise = float(residual(values).std())
        found = least_squares(
            project,
            values / scales,
            bounds=(priors.smallest / scales, priors.largest / scales),
            diff_step=1e-3,
            max_nfev=40,
        )
        values = found.x * scales
    e = residual(values)
    jacobian = np.empty((len(block), len(values)))
    for k in range(len(values)):
        step = JACOBIAN_STEP * scales[k]
        step = -step if values[k] + step > priors.largest[k] else step
        moved = values.copy()
        moved[k] += step
        jacobian[:, k] = (residual(moved) - e) / step
    z = jacobian if basis is None else basis @ (basis.T @ jacobian)
    known = np.diag((noise / priors.deviations) ** 2)
    inverse: Mat = np.asarray(np.linalg.pinv(z.T @ jacobian + known), float)
    told = _sandwich(inverse, z, e, block)
    return IdentifiedValues(values, told + noise**2 * inverse @ known @ inverse.T)


def _sandwich(inverse: Mat, z: Mat, e: Vec, block: Ints) -> Mat:
    """Return the covariance that holds for residuals that are correlated within a block."""
    count = int(block.max()) + 1 if len(block) else 0
    if count < FEWEST_BLOCKS:
        return np.full_like(inverse, np.inf)
    scores = np.zeros((count, z.shape[1]))
    np.add.at(scores, block, z * e[:, None])
    return np.asarray(inverse @ (scores.T @ scores) @ inverse.T)


def number_blocks(chosen: Bools) -> Ints:
    """Return for the chosen rows of (n,) the number of their part of BLOCK_ROWS, without holes: (m,)."""
    number = np.flatnonzero(chosen) // BLOCK_ROWS
    return np.asarray(np.unique(number, return_inverse=True)[1])
