"""Linear and mixed-integer linear programs in HiGHS: built once, solved often, stopped by iterations or nodes."""

from typing import Final

import highspy
import numpy as np
import numpy.typing as npt

from crazychoir.types import Mat, Vec

Mask = npt.NDArray[np.bool_]

MOST_ITERATIONS: Final = 100_000
"""Simplex iterations of one solve."""
MOST_NODES: Final = 100_000
"""Branch-and-bound nodes of one solve."""
WORDS = {
    highspy.HighsModelStatus.kInfeasible: "infeasible",
    highspy.HighsModelStatus.kUnbounded: "unbounded",
    highspy.HighsModelStatus.kUnboundedOrInfeasible: "infeasible",  # `solve` knows when it is unbounded
    highspy.HighsModelStatus.kIterationLimit: "too many iterations",
    highspy.HighsModelStatus.kSolutionLimit: "too many nodes",
}


class _Quiet(highspy.Highs):  # type: ignore[misc]
    """One that says nothing from its beginning on: HiGHS 1.16 prints who it is as soon as it has callbacks."""

    def enableCallbacks(self) -> highspy.HighsStatus:
        self.setOptionValue("output_flag", False)
        return super().enableCallbacks()


def quiet_highs(seed: int = 0) -> highspy.Highs:
    """A HiGHS object that repeats itself: one thread, a fixed seed, no output, no time limit."""
    highs = _Quiet()
    highs.setOptionValue("threads", 1)
    highs.setOptionValue("random_seed", seed)
    highs.setOptionValue("simplex_iteration_limit", MOST_ITERATIONS)
    return highs


class LinearProgram:
    """min c'x + p'x  s.t.  A x <= b,  E x = e,  low <= x <= high,  x_k integer where `integer`, for many p.

    c: (n,);  rows: A (m, n), b (m,);  equalities: E (l, n), e (l,);  bounds: low, high (n,), may be infinite;
    integer: (n,) of bool;  most_nodes: of branch and bound, a solve. The last basis is where the next solve starts.
    """

    name = "HiGHS"

    def __init__(
        self,
        c: Vec,
        rows: tuple[Mat, Vec],
        equalities: tuple[Mat, Vec] | None = None,
        bounds: tuple[Vec, Vec] | None = None,
        integer: Mask | None = None,
        most_nodes: int = MOST_NODES,
    ) -> None:
        (A, b), n = rows, len(c)
        self._c = np.asarray(c, float)
        E, e = (np.zeros((0, n)), np.zeros(0)) if equalities is None else equalities
        low, high = (
            (np.full(n, -np.inf), np.full(n, np.inf)) if bounds is None else bounds
        )
        self._index = np.arange(n, dtype=np.int32)
        self._highs = quiet_highs()
        self._highs.addVars(n, np.asarray(low, float), np.asarray(high, float))
        self._add(A, np.full(len(b), -np.inf), b)
        self._add(E, e, e)
        self._mixed = False
        if integer is not None and np.any(integer):
            self._mixed = True
            kinds = np.where(
                integer,
                int(highspy.HighsVarType.kInteger),
                int(highspy.HighsVarType.kContinuous),
            )
            self._highs.changeColsIntegrality(n, self._index, kinds.astype(np.uint8))
            self._highs.setOptionValue("mip_max_nodes", most_nodes)
            self._highs.setOptionValue("mip_rel_gap", 0.0)

    def solve(self, p: Vec) -> Vec | str:
        """A solution x (n,), a corner; or why there is none, in the words of WORDS, or in HiGHS' own."""
        return self._minimise(self._c + p)

    @property
    def proven(self) -> float:
        """No x costs less, by the last `solve` that found one; with integers the bound of its search."""
        info = self._highs.getInfo()
        return float(
            info.mip_dual_bound if self._mixed else info.objective_function_value
        )

    @property
    def multipliers(self) -> Vec:
        """(m + l,) of the rows and of the equalities, in the last `solve` that found a solution."""
        return np.array(self._highs.getSolution().row_dual)

    def _minimise(self, c: Vec) -> Vec | str:
        if not np.isfinite(c).all():
            return "not finite"
        self._highs.changeColsCost(len(self._index), self._index, c)
        self._highs.run()
        status = self._highs.getModelStatus()
        if status == highspy.HighsModelStatus.kOptimal:
            return np.array(self._highs.getSolution().col_value)
        if status == highspy.HighsModelStatus.kUnboundedOrInfeasible and np.any(c):
            feasible = self._minimise(np.zeros_like(c))
            return "unbounded" if not isinstance(feasible, str) else feasible
        return WORDS.get(status, str(status.name))

    def _add(self, rows: Mat, low: Vec, high: Vec) -> None:
        for a, least, most in zip(np.asarray(rows, float), low, high, strict=True):
            at = np.flatnonzero(a).astype(np.int32)
            self._highs.addRow(float(least), float(most), len(at), at, a[at])
