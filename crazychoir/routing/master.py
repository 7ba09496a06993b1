"""The restricted master problem: set partitioning over the columns that are known of all robots."""

from collections.abc import Iterable
from dataclasses import dataclass

import highspy
import numpy as np

from crazychoir.errors import SolverError
from crazychoir.routing.columns import quiet_highs
from crazychoir.routing.pricing import Column
from crazychoir.types import Vec

Key = tuple[int, tuple[int, ...]]


@dataclass(frozen=True)
class Relaxation:
    """Value in m of the linear relaxation and the task prices (M,) m >= 0."""

    value: float
    prices: Vec


@dataclass(frozen=True)
class Partition:
    """Cost in m, the tasks of each robot that flies, and the bound in m that the search proved over these columns.

    Where no choice was found the cost is inf; the bound is too if there is none.
    """

    cost: float
    routes: dict[int, tuple[int, ...]]
    bound: float


class Pool:
    """The known columns of each robot, each set once, with its shortest length."""

    def __init__(self, tasks: int) -> None:
        self._tasks = tasks
        self._length: dict[Key, float] = {}

    def __len__(self) -> int:
        return len(self._length)

    def items(self) -> list[tuple[int, Column]]:
        """(robot, column), in the order (robot, tasks)."""
        return [(robot, Column(self._length[robot, tasks], tasks)) for robot, tasks in sorted(self._length)]

    def add(self, robot: int, columns: Iterable[Column]) -> int:
        """Take columns of a robot; returns how many are new or shorter than known."""
        new = 0
        for column in columns:
            if not self.has(robot, column):
                self._length[robot, column.tasks] = column.length
                new += 1
        return new

    def has(self, robot: int, column: Column) -> bool:
        """Whether the robot's column is known at this length."""
        return self._length.get((robot, column.tasks), np.inf) <= column.length

    def relax(self, penalty: Vec) -> Relaxation:
        """The covering relaxation, each robot at most one column.

        min  sum length_c x_c + sum_j penalty_j v_j   s.t.  sum_{c serves j} x_c + v_j >= 1,  sum_{c of i} x_c <= 1
        """
        highs = _model(self.items(), np.full(self._tasks, highspy.kHighsInf), seed=0)
        for j in range(self._tasks):
            highs.addCol(float(penalty[j]), 0.0, highspy.kHighsInf, 1, np.array([j], np.int32), np.ones(1))
        highs.run()
        status = highs.getModelStatus()
        if status != highspy.HighsModelStatus.kOptimal:
            raise SolverError("restricted master, relaxed", status.name)
        dual = np.array(highs.getSolution().row_dual)[: self._tasks]
        return Relaxation(highs.getObjectiveValue(), np.maximum(dual, 0.0))


def partition(columns: list[tuple[int, Column]], tasks: int, seed: int, nodes: int) -> Partition:
    """The cheapest choice of columns that serves each task exactly once.

        min  sum length_c x_c   s.t.  sum_{c serves j} x_c = 1,  sum_{c of i} x_c <= 1,  x binary

    Stops after `nodes` branch-and-bound nodes, never by time.
    """
    highs = _model(columns, np.ones(tasks), seed)
    index = np.arange(len(columns), dtype=np.int32)
    highs.changeColsIntegrality(len(index), index, np.full(len(index), int(highspy.HighsVarType.kInteger), np.uint8))
    highs.setOptionValue("mip_rel_gap", 0.0)
    highs.setOptionValue("mip_max_nodes", nodes)
    highs.run()
    info = highs.getInfo()
    if info.primal_solution_status != int(highspy.SolutionStatus.kSolutionStatusFeasible):
        none = not columns or highs.getModelStatus() == highspy.HighsModelStatus.kInfeasible
        return Partition(np.inf, {}, np.inf if none else -np.inf)
    chosen = [c for c, x in zip(columns, highs.getSolution().col_value, strict=True) if x > 0.5]
    cost = sum(column.length for _, column in chosen)
    return Partition(cost, {robot: column.tasks for robot, column in chosen}, min(cost, info.mip_dual_bound))


def _model(columns: list[tuple[int, Column]], upper: Vec, seed: int) -> highspy.Highs:
    """Rows: tasks in [1, upper], then the robots in use <= 1; columns in the given order, 0 <= x <= 1."""
    highs, robots = quiet_highs(seed), sorted({robot for robot, _ in columns})
    row_of = {robot: len(upper) + r for r, robot in enumerate(robots)}
    empty = np.array([], np.int32), np.array([])
    for most in upper:
        highs.addRow(1.0, float(most), 0, *empty)
    for _ in robots:
        highs.addRow(-highspy.kHighsInf, 1.0, 0, *empty)
    rows = [[*column.tasks, row_of[robot]] for robot, column in columns]
    starts = np.cumsum([0, *(len(r) for r in rows)])[:-1].astype(np.int32)
    index = np.array([r for column in rows for r in column], dtype=np.int32)
    n, cost = len(columns), np.array([column.length for _, column in columns])
    highs.addCols(n, cost, np.zeros(n), np.ones(n), len(index), starts, index, np.ones(len(index)))
    return highs
