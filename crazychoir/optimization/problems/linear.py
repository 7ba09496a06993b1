"""Linear and mixed-integer linear programs in HiGHS: built once, solved often.

A solve is limited by a number of iterations or nodes, never by time.
"""

from typing import Final

import highspy
import numpy as np
import numpy.typing as npt

from crazychoir.types import Mat, Vec

Mask = npt.NDArray[np.bool_]

MOST_SIMPLEX_ITERATIONS: Final = 100_000
"""Simplex iterations of one solve."""
MOST_BRANCH_NODES: Final = 100_000
"""Branch-and-bound nodes of one solve."""
HIGHS_STATUS_TEXTS = {
    highspy.HighsModelStatus.kInfeasible: "infeasible",
    highspy.HighsModelStatus.kUnbounded: "unbounded",
    highspy.HighsModelStatus.kUnboundedOrInfeasible: "infeasible",  # `_minimise` tests for unbounded
    highspy.HighsModelStatus.kIterationLimit: "too many iterations",
    highspy.HighsModelStatus.kSolutionLimit: "too many nodes",
}
"""Status texts of HiGHS that callers test for."""


class _QuietHighs(highspy.Highs):  # type: ignore[misc]
    """A HiGHS object that prints nothing and leaves no worker threads behind.

    HiGHS 1.16 prints a banner as soon as it has callbacks, so the output is switched off before.
    """

    def enableCallbacks(self) -> highspy.HighsStatus:
        self.setOptionValue("output_flag", False)
        return super().enableCallbacks()

    def run(self) -> highspy.HighsStatus:
        """Solve the model, whatever this thread has solved in HiGHS before, and will solve after.

        HiGHS keeps the workers of a thread's first solve, and refuses each later solve of that thread
        with another number of threads. cvxpy solves in HiGHS too, with numbers of its own. Therefore
        each solve begins and ends without workers. With one thread this costs 0.2 us.

        From an old basis the simplex method sometimes ends in kUnknown. The solve then starts anew.
        """
        self.resetGlobalScheduler(True)
        status = super().run()
        if self.getModelStatus() == highspy.HighsModelStatus.kUnknown:
            self.clearSolver()
            status = super().run()
        self.resetGlobalScheduler(True)
        return status


def make_quiet_highs(seed: int = 0) -> highspy.Highs:
    """Return a HiGHS object with repeatable results.

    It uses one thread and a fixed seed. It has no output and no time limit.
    """
    highs = _QuietHighs()
    highs.setOptionValue("threads", 1)
    highs.setOptionValue("random_seed", seed)
    highs.setOptionValue("simplex_iteration_limit", MOST_SIMPLEX_ITERATIONS)
    # This search for a first solution takes over 1 ms even for five variables; the programs of an
    # agent are small, and are solved thousands of times.
    highs.setOptionValue("mip_heuristic_run_feasibility_jump", False)
    return highs


def demand_tolerance(highs: highspy.Highs, tolerance: float) -> None:
    """Let the solutions of `highs` miss rows, bounds and integers by no more than `tolerance`."""
    highs.setOptionValue("primal_feasibility_tolerance", tolerance)
    highs.setOptionValue("mip_feasibility_tolerance", tolerance)


class LinearProgram:
    """A linear program, perhaps with integers, solved for many linear costs p.

        min c'x + p'x  s.t.  A x <= b,  E x = e,  low <= x <= high,  x_k integer where `integer`

    c: (n,)
    rows: A (m, n), b (m,)
    equalities: E (l, n), e (l,)
    bounds: low (n,), high (n,), may be infinite
    integer: (n,) of bool: True where x_k must be an integer
    most_nodes: limit of branch-and-bound nodes of one solve

    Each solve starts from the last basis.
    """

    name = "HiGHS"
    """Name of the solver."""

    def __init__(
        self,
        c: Vec,
        rows: tuple[Mat, Vec],
        equalities: tuple[Mat, Vec] | None = None,
        bounds: tuple[Vec, Vec] | None = None,
        integer: Mask | None = None,
        most_nodes: int = MOST_BRANCH_NODES,
    ) -> None:
        (A, b), n = rows, len(c)
        self._c = np.asarray(c, float)
        E, e = (np.zeros((0, n)), np.zeros(0)) if equalities is None else equalities
        low, high = (
            (np.full(n, -np.inf), np.full(n, np.inf)) if bounds is None else bounds
        )
        self._index = np.arange(n, dtype=np.int32)
        self._highs = make_quiet_highs()
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
        """Return a solution x (n,), which is a corner, or the reason why there is none.

        The reason is a text of HIGHS_STATUS_TEXTS, or the name of the status in HiGHS.
        """
        return self._minimise(self._c + p)

    def restrict(self, low: Vec, high: Vec) -> None:
        """Replace the bounds of x, each (n,)."""
        self._highs.changeColsBounds(len(self._index), self._index, low, high)

    def demand(self, tolerance: float) -> None:
        """Let rows, bounds and integers be missed by no more than `tolerance`, 1e-10 or more."""
        demand_tolerance(self._highs, tolerance)

    @property
    def proven(self) -> float:
        """Lower bound of the cost of every x, proven by the last `solve` that found a solution.

        With integers it is the bound of the branch-and-bound search.
        """
        info = self._highs.getInfo()
        return float(
            info.mip_dual_bound if self._mixed else info.objective_function_value
        )

    @property
    def multipliers(self) -> Vec:
        """(m + l,) multipliers of the rows and equalities in the last solution found."""
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
        return HIGHS_STATUS_TEXTS.get(status, str(status.name))

    def _add(self, rows: Mat, low: Vec, high: Vec) -> None:
        for a, least, most in zip(np.asarray(rows, float), low, high, strict=True):
            at = np.flatnonzero(a).astype(np.int32)
            self._highs.addRow(float(least), float(most), len(at), at, a[at])
