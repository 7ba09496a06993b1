"""Piecewise polynomials of the flat output: all planned flights consist of them."""

import math
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from crazychoir.errors import ConfigError
from crazychoir.numerics.kernels import kernel, matrix, memory, real, table, vector
from crazychoir.numerics.math3d import wrap_angle
from crazychoir.types import FullState, Mat, Vec

POLYNOMIAL_DEGREE = 7
"""Degree of the polynomials."""
FACTORIAL_TABLE = np.array(
    [math.factorial(n) for n in range(POLYNOMIAL_DEGREE + 1)], dtype=float
)
"""n! for n = 0 .. POLYNOMIAL_DEGREE."""


@kernel(matrix, vector, real, memory)
def sample_pieces(coefficients: Mat, knots: Vec, t: float, out: Vec) -> None:
    """Compute the flat output at t.

    coefficients: (4 k, 8)
    knots: (k + 1,) s
    t: s, from the first knot to the last
    out: (14,): the result
    """
    low = 0
    high = knots.shape[0] - 1
    while high - low > 1:
        middle = (low + high) // 2
        if t >= knots[middle]:
            low = middle
        else:
            high = middle
    s = t - knots[low]
    for axis in range(4):
        c = coefficients[4 * low + axis]
        p = v = a = j = 0.0
        # Horner's scheme of the polynomial and of its Taylor coefficients at s.
        for n in range(7, -1, -1):
            j = j * s + a
            a = a * s + v
            v = v * s + p
            p = p * s + c[n]
        if axis < 3:
            out[axis] = p
            out[3 + axis] = v
            out[6 + axis] = 2.0 * a
            out[9 + axis] = 6.0 * j
        else:
            out[12] = p
            out[13] = v


@kernel(matrix, vector, memory)
def _fill_peaks(coefficients: Mat, knots: Vec, out: Vec) -> None:
    """Compute the largest speed, acceleration and yaw rate, at 33 times of each piece.

    coefficients: (4 k, 8)
    knots: (k + 1,) s
    out: (3,): the result
    """
    at = np.empty(14)
    out[:] = 0.0
    for i in range(knots.shape[0] - 1):
        for k in range(33):
            sample_pieces(
                coefficients, knots, knots[i] + (knots[i + 1] - knots[i]) * k / 32.0, at
            )
            out[0] = max(out[0], math.sqrt(at[3] ** 2 + at[4] ** 2 + at[5] ** 2))
            out[1] = max(out[1], math.sqrt(at[6] ** 2 + at[7] ** 2 + at[8] ** 2))
            out[2] = max(out[2], abs(at[13]))


@kernel(matrix, vector, vector, table)
def _sample_many(coefficients: Mat, knots: Vec, t: Vec, out: Mat) -> None:
    """Compute the flat outputs at several times.

    coefficients: (4 k, 8)
    knots: (k + 1,) s
    t: (n,) s, from the first knot to the last
    out: (n, 14): the result
    """
    for k in range(t.shape[0]):
        sample_pieces(coefficients, knots, t[k], out[k])


class Piecewise:
    """Polynomials of degree 7, one after the other.

        p(t) = sum_n c_in (t - t_i)^n,  n = 0..7,  t_i <= t < t_i+1,  t_0 = 0,  t_i+1 = t_i + T_i

    Before its start it holds the first state. At the end it has the state of the last piece; after
    that it stands.

    coefficients: c (k, 4, 8) of x, y, z m and yaw rad, ascending, per s^n
    durations: T (k,) s, positive
    Raises ConfigError for other shapes, numbers that are not finite, or durations that are not
    positive.
    """

    def __init__(self, coefficients: npt.ArrayLike, durations: npt.ArrayLike) -> None:
        c = np.asarray(coefficients, dtype=float)
        d = np.asarray(durations, dtype=float)
        if c.shape != (d.size, 4, POLYNOMIAL_DEGREE + 1) or d.ndim != 1 or d.size == 0:
            raise ConfigError(
                "Piecewise: shapes",
                f"{c.shape} and {d.shape}",
                "(k, 4, 8) and (k,), k at least 1",
            )
        if not np.isfinite(c).all():
            raise ConfigError(
                "Piecewise: coefficients of piece",
                int(np.argmin(np.isfinite(c).all((1, 2)))),
                "numbers",
            )
        if not (np.isfinite(d).all() and d.min() > 0.0):
            worst = int(np.argmin(np.isfinite(d) & (d > 0.0)))
            raise ConfigError(
                f"Piecewise: duration of piece {worst}",
                float(d[worst]),
                "a positive number of seconds",
            )
        rows = np.ascontiguousarray(c.reshape(-1, POLYNOMIAL_DEGREE + 1))
        knots = np.concatenate([[0.0], np.cumsum(d)])
        end = np.empty(14)
        sample_pieces(rows, knots, knots[-1], end)
        self._fill(rows, knots, end)

    def _fill(self, rows: Mat, knots: Vec, end: Vec) -> None:
        """Store the pieces.

        rows: (4 k, 8): coefficients
        knots: (k + 1,) s
        end: (14,): the exact state at the end
        """
        self._rows = rows
        self.knots = knots
        self.duration = float(knots[-1])
        self._end = end

    @property
    def rows(self) -> Mat:
        """(4 k, 8): the coefficients of x, y, z and yaw of each piece."""
        return self._rows

    @property
    def end(self) -> Vec:
        """(14,): the exact state at the end, as FullState.flat."""
        return self._end

    @property
    def durations(self) -> Vec:
        """T (k,) s."""
        return np.diff(self.knots)

    @property
    def coefficients(self) -> npt.NDArray[np.float64]:
        """c (k, 4, 8)."""
        return self._rows.reshape(-1, 4, POLYNOMIAL_DEGREE + 1)

    def sample(self, t: float) -> FullState:
        """Return the reference t seconds after the start."""
        if t >= self.duration:
            return self._at_end(t)
        out = np.empty(14)
        sample_pieces(self._rows, self.knots, max(t, 0.0), out)
        return FullState(out)

    def _at_end(self, t: float) -> FullState:
        """Return the reference at the end, or at rest after it."""
        out = self._end.copy()
        if t > self.duration:
            out[3:12] = 0.0
            out[13] = 0.0
        return FullState(out)

    def samples(self, t: Vec) -> Mat:
        """Return the references (n, 14) at times t (n,), 0 <= t <= duration."""
        out = np.empty((len(t), 14))
        _sample_many(self._rows, self.knots, t, out)
        return out

    def done(self, t: float) -> bool:
        """Return whether the end is reached at t."""
        return t >= self.duration

    @property
    def peaks(self) -> tuple[float, float, float]:
        """Largest speed m/s, acceleration m/s2 and yaw rate rad/s of the flight."""
        out = np.empty(3)
        _fill_peaks(self._rows, self.knots, out)
        return float(out[0]), float(out[1]), float(out[2])

    @property
    def jumps(self) -> Mat:
        """(4, 8): largest jump at inner knots of each derivative of x, y, z, yaw.

            p^(m)(t_i+1 -) = sum_n n! / (n - m)! c_in T_i^(n - m),  p^(m)(t_i+1 +) = m! c_(i+1)m

        The derivatives are those from the 0th to the 7th. The jump is exact, not sampled.
        """
        c = self.coefficients
        jumps = np.zeros((4, POLYNOMIAL_DEGREE + 1))
        for m in range(POLYNOMIAL_DEGREE + 1):
            n = np.arange(m, POLYNOMIAL_DEGREE + 1)
            powers = self.durations[:-1, None, None] ** (n - m)
            ends = np.sum(
                FACTORIAL_TABLE[n] / FACTORIAL_TABLE[n - m] * c[:-1, :, m:] * powers,
                axis=2,
            )
            jumps[:, m] = np.max(
                np.abs(ends - FACTORIAL_TABLE[m] * c[1:, :, m]), axis=0, initial=0.0
            )
        return jumps

    def slowed(self, factor: float) -> "Piecewise":
        """Return the same path with `factor` times the duration: q(t) = p(t / factor)."""
        return Piecewise(
            self.coefficients / factor ** np.arange(POLYNOMIAL_DEGREE + 1.0),
            self.durations * factor,
        )

    def reversed(self) -> "Piecewise":
        """Return the same path from its end to its start: q(t) = p(T - t).

        With s = T_i - t, a piece has  sum_n c_n (T_i - s)^n = sum_m s^m (-1)^m sum_n C(n, m) c_n T_i^(n - m).
        """
        c = self.coefficients[::-1]
        durations = self.durations[::-1]
        turned = np.zeros_like(c)
        for m in range(POLYNOMIAL_DEGREE + 1):
            n = np.arange(m, POLYNOMIAL_DEGREE + 1)
            binomials = FACTORIAL_TABLE[n] / (
                FACTORIAL_TABLE[m] * FACTORIAL_TABLE[n - m]
            )
            powers = durations[:, None, None] ** (n - m)
            turned[:, :, m] = (-1) ** m * np.sum(
                binomials * c[:, :, m:] * powers, axis=2
            )
        return Piecewise(turned, durations)

    def shifted(self, by: Sequence[float]) -> "Piecewise":
        """Return the same flight shifted by `by`, (3,) m."""
        coefficients = self.coefficients.copy()
        coefficients[:, 0:3, 0] += np.array(by)
        return Piecewise(coefficients, self.durations)


def join_pieces(parts: Sequence[Piecewise]) -> Piecewise:
    """Return the parts one after the other.

    The yaw of each part is shifted by whole turns to where the part before it ends.
    """
    coefficients = []
    yaw = parts[0].sample(0.0).yaw
    for part in parts:
        c = part.coefficients.copy()
        turns = yaw + wrap_angle(c[0, 3, 0] - yaw) - c[0, 3, 0]
        c[:, 3, 0] += turns
        coefficients.append(c)
        yaw = part.sample(part.duration).yaw + turns
    return Piecewise(
        np.concatenate(coefficients), np.concatenate([part.durations for part in parts])
    )
