"""The local problem of primal decomposition: a linear program over the columns of one robot."""

from dataclasses import dataclass

import highspy
import numpy as np

from crazychoir.errors import SolverError
from crazychoir.optimization.problems.linear import make_quiet_highs
from crazychoir.routing.pricing.route_table import RouteColumn, RouteTable
from crazychoir.types import Vec

COLUMN_TOLERANCE = 1e-7
"""Tolerance of reduced costs (m) and of the weights of columns."""
PRICING_BATCH = 10
"""Columns added after each pricing, at most."""


@dataclass(frozen=True)
class LocalSolution:
    """Solution of the local problem at a demand y."""

    value: float
    """m: the optimal value p_i(y)."""
    mu: Vec
    """(M,) m >= 0: price of each task."""
    violation: Vec
    """(M,): unserved demand v."""
    active: list[RouteColumn]
    """The columns with positive weight."""


class ColumnProgram:
    """Serve the demand y_i of robot i as cheaply as a convex combination of its routes can.

        p_i(y) = min  sum_c length_c lambda_c + sum_j M_j v_j
                 s.t. sum_{c serves j} lambda_c + v_j >= y_j    : mu_j >= 0
                      sum_c lambda_c = 1,  lambda >= 0,  v >= 0

    c runs over all columns of the robot, which are the corners of conv(Z_i). Exact pricing at the
    duals finds the columns that matter. The penalty M_j must exceed any price of task j, because
    0 <= mu_j <= M_j. The program stays warm: solve(y) changes bounds and adds columns.

    table: the routes of the robot.
    penalty: (M,) m: M_j.
    robot: its id, for messages.
    Raises SolverError if HiGHS does not reach the optimum.
    """

    def __init__(self, table: RouteTable, penalty: Vec, robot: int = 0) -> None:
        self._table = table
        self._penalty = penalty
        self._where = f"robot {robot}: local problem"
        self._rows = np.unique(table.task)
        self._unservable = np.setdiff1d(np.arange(len(penalty)), self._rows)
        self._row_index = np.arange(len(self._rows), dtype=np.int32)
        self._no_upper_bounds = np.full(len(self._rows), highspy.kHighsInf)
        self._row_of = {int(j): r for r, j in enumerate(self._rows)}
        self._columns: dict[RouteColumn, None] = {RouteColumn(0.0, ()): None}
        self._highs = make_quiet_highs()
        self._build()

    def solve(self, y: Vec) -> LocalSolution:
        """Return p_i(y), its prices, and the columns with positive weight; y: (M,)."""
        rows = self._rows
        count = len(rows)
        if count:
            self._highs.changeRowsBounds(
                count, self._row_index, y[rows], self._no_upper_bounds
            )
        solution = self._generate()
        weights = np.array(solution.col_value)
        mu = np.where(y > 0, self._penalty, 0.0)
        dual = np.array(solution.row_dual)[:count]
        mu[rows] = np.minimum(np.maximum(dual, 0.0), self._penalty[rows])
        violation = np.maximum(y, 0.0)
        violation[rows] = weights[:count]
        unservable = self._unservable
        value = self._highs.getObjectiveValue() + float(
            self._penalty[unservable] @ violation[unservable]
        )
        columns = list(self._columns)
        used = np.flatnonzero(weights[count:] > COLUMN_TOLERANCE)
        active = [columns[c] for c in used.tolist() if columns[c].tasks]
        return LocalSolution(value, mu, violation, active)

    def _build(self) -> None:
        for _ in self._rows:
            self._highs.addRow(
                -highspy.kHighsInf,
                highspy.kHighsInf,
                0,
                np.array([], np.int32),
                np.array([]),
            )
        self._highs.addRow(1.0, 1.0, 0, np.array([], np.int32), np.array([]))
        for r, j in enumerate(self._rows):
            self._add(float(self._penalty[j]), [r])
        self._add(0.0, [len(self._rows)])

    def _generate(self) -> highspy.HighsSolution:
        """Alternate solving and pricing until no further column has a negative reduced cost.

        A known column that still seems to have a negative reduced cost is within HiGHS's tolerance.
        """
        while True:
            solution = self._run()
            dual = np.array(solution.row_dual)
            prices = np.zeros_like(self._penalty)
            prices[self._rows] = dual[:-1]
            cheap = self._table.cheapest(
                prices, PRICING_BATCH, below=float(dual[-1]) - COLUMN_TOLERANCE
            )
            new = [column for column in cheap if column not in self._columns]
            if not new:
                return solution
            for column in new:
                self._columns[column] = None
                self._add(
                    column.length,
                    [*(self._row_of[j] for j in column.tasks), len(self._rows)],
                )

    def _run(self) -> highspy.HighsSolution:
        self._highs.run()
        status = self._highs.getModelStatus()
        if status != highspy.HighsModelStatus.kOptimal:
            raise SolverError(self._where, status.name)
        return self._highs.getSolution()

    def _add(self, cost: float, rows: list[int]) -> None:
        self._highs.addCol(
            cost,
            0.0,
            highspy.kHighsInf,
            len(rows),
            np.array(rows, np.int32),
            np.ones(len(rows)),
        )
