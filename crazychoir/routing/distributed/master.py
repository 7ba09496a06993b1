"""The restricted master problem: set partitioning over the known columns of all robots."""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import highspy
import numpy as np

from crazychoir.errors import SolverError
from crazychoir.optimization.problems.linear import make_quiet_highs
from crazychoir.routing.pricing.route_table import RouteColumn
from crazychoir.routing.pricing.subset_rows import (
    NO_ROWS,
    PricedRows,
    SubsetRow,
    find_violated_rows,
)
from crazychoir.types import Vec

GOLDEN_RATIO_FRACTION = 0.6180339887498949
"""Fraction of the golden ratio: its multiples modulo 1 spread evenly over an interval."""
HIGHS_STATUS = highspy.HighsModelStatus
NO_SOLUTION_STATUSES = (
    HIGHS_STATUS.kInfeasible,
    HIGHS_STATUS.kUnboundedOrInfeasible,
    HIGHS_STATUS.kModelEmpty,
)
"""Statuses that mean, in a search over x in [0, 1], that there is no solution."""
PROPER_END_STATUSES = (
    HIGHS_STATUS.kOptimal,
    *NO_SOLUTION_STATUSES,
    HIGHS_STATUS.kSolutionLimit,
    HIGHS_STATUS.kIterationLimit,
    HIGHS_STATUS.kObjectiveBound,
    HIGHS_STATUS.kObjectiveTarget,
)
"""Statuses of a search that ended properly: an answer or a limit.

HiGHS reports a limit of nodes as kSolutionLimit.
"""
COLUMN_COUNT_ROUNDING = 1e-6
"""A number of columns that exceeds a whole number by at most this counts as that number."""
ROUTE_LENGTH_ROUNDING = 1e-9
"""m: rounding of the length of one route if its legs are added in another order."""
Key = tuple[int, tuple[int, ...]]
"""A robot and the tasks of a column."""
Routes = dict[int, tuple[int, ...]]
"""Tasks of each robot, increasing."""


@dataclass(frozen=True)
class Relaxation:
    """Solution of the linear relaxation."""

    value: float
    """m: the optimal value."""
    prices: Vec
    """(M,) m >= 0: price of each task."""
    used: float = 0.0
    """Sum of x: the number of robots in use, fractions included."""
    reward: float = 0.0
    """m >= 0: reward of each robot in use, if too few robots would be used without it."""
    rows: PricedRows = NO_ROWS
    """The subset rows with a price above 0."""


@dataclass(frozen=True)
class PartitionProblem:
    """Columns to choose from, so that each task is served exactly once."""

    columns: list[tuple[int, RouteColumn]]
    """(robot, column)."""
    tasks: int
    """M, the number of tasks."""
    alike: Mapping[int, Sequence[int]] = field(default_factory=dict)
    """The K_i identical robots, i among them, that can fly a column of i; i alone if absent."""
    rows: tuple[SubsetRow, ...] = ()
    """Subset rows, which every plan satisfies: they make the relaxations of the search tighter."""

    def with_lengths(self, lengths: Sequence[float]) -> "PartitionProblem":
        """Return the problem with other lengths of its columns, in m."""
        columns = [
            (robot, RouteColumn(length, column.tasks))
            for (robot, column), length in zip(self.columns, lengths, strict=True)
        ]
        return replace(self, columns=columns)


@dataclass(frozen=True)
class PartitionResult:
    """Result of a search for an integer plan.

    If no plan was found the cost is inf. If it is proven that there is none, the bound is inf too.
    Where dearer plans may be left out, inf says that all plans are dearer.
    """

    cost: float
    """m: cost of the plan."""
    routes: Routes
    """Tasks of each robot that flies."""
    bound: float
    """m: lower bound over these columns that the search proved."""


class ColumnPool:
    """The known columns of each robot: each set of tasks once, with its shortest length."""

    def __init__(self, tasks: int) -> None:
        self._tasks = tasks
        self._length: dict[Key, float] = {}

    def __len__(self) -> int:
        return len(self._length)

    def items(self) -> list[tuple[int, RouteColumn]]:
        """Return all (robot, column), sorted by robot and tasks."""
        return [
            (robot, RouteColumn(self._length[robot, tasks], tasks))
            for robot, tasks in sorted(self._length)
        ]

    def add(self, robot: int, columns: Iterable[RouteColumn]) -> int:
        """Add columns of a robot; return how many are new or shorter than the known ones."""
        new = 0
        for column in columns:
            if not self.has(robot, column):
                self._length[robot, column.tasks] = column.length
                new += 1
        return new

    def has(self, robot: int, column: RouteColumn) -> bool:
        """Return whether the robot's column is known at this length or a shorter one."""
        return self._length.get((robot, column.tasks), np.inf) <= column.length

    def relax(self, penalty: Vec) -> Relaxation:
        """Solve the covering relaxation of these columns; see `Master`.

        penalty: (M,) m, cost of each task without a column
        """
        master = Master(penalty)
        for robot, column in self.items():
            master.add(robot, [column])
        return master.relax()


class Master:
    """The covering relaxation of the known columns, with at most one column a robot.

    Each solution starts from the last basis (warm start).

        min  sum length_c x_c + sum_j penalty_j v_j
        s.t. sum_{c serves j} x_c + v_j >= 1                     : pi_j >= 0
             sum_{c of i} x_c <= K_i                             : sigma_i <= 0,    x >= 0, v >= 0
             sum_c x_c + w >= n, at the cost f w                 : 0 <= mu <= f,    after `at_least`
             the subset rows                                     : charges >= 0,    after `cut`

    penalty: (M,) m, more than any price, or the cost of refusing the task.
    spread: the right-hand sides are raised by up to this, each by a different amount, which is
        the same at all robots. Then no optimal basis is degenerate, so that prices are unique.
    number: K_i, the size of the group of identical robots that robot i represents; 1 if absent.
    `basis`: columns of the last optimal basis, at most as many as there are rows.
    Raises SolverError if HiGHS does not reach the optimum.
    """

    def __init__(
        self, penalty: Vec, spread: float = 0.0, number: Mapping[int, int] | None = None
    ) -> None:
        self._spread = spread
        self._penalty = penalty
        self._number = number or {}
        self._highs = make_quiet_highs()
        self._tasks = len(penalty)
        self._columns: list[tuple[int, RouteColumn]] = []
        self._index: dict[Key, int] = {}
        self._row: dict[int, int] = {}
        self._count: tuple[int, int] | None = None
        self._cuts: dict[SubsetRow, int] = {}
        for j, price in enumerate(penalty):
            self._highs.addRow(
                self._raised(j),
                highspy.kHighsInf,
                0,
                np.array([], np.int32),
                np.array([]),
            )
            self._highs.addCol(
                float(price),
                0.0,
                highspy.kHighsInf,
                1,
                np.array([j], np.int32),
                np.ones(1),
            )

    def __len__(self) -> int:
        return len(self._columns)

    def add(self, robot: int, columns: Iterable[RouteColumn]) -> int:
        """Add columns of a robot; return how many are new or shorter than the known ones."""
        new = [
            column
            for column in columns
            if column.tasks and self._is_news(robot, column)
        ]
        if new:
            self._append(self._row_of(robot), new)
        return len(new)

    def _is_news(self, robot: int, column: RouteColumn) -> bool:
        """Store the column and return True if it is new or shorter than the known one.

        A column that is shorter only by rounding is not stored.
        """
        k = self._index.get((robot, column.tasks))
        if (
            k is not None
            and self._columns[k][1].length <= column.length + ROUTE_LENGTH_ROUNDING
        ):
            return False
        self._index[robot, column.tasks] = len(self._columns)
        self._columns.append((robot, column))
        return True

    def _row_of(self, robot: int) -> int:
        if robot not in self._row:
            self._row[robot] = self._highs.getNumRow()
            most = self._raised(self._tasks + robot, self._number.get(robot, 1))
            self._highs.addRow(
                -highspy.kHighsInf, most, 0, np.array([], np.int32), np.array([])
            )
        return self._row[robot]

    def _raised(self, row: int, number: int = 1) -> float:
        """Return the right-hand side of a row, raised by its share of `spread`."""
        return number + self._spread * ((row + 1) * GOLDEN_RATIO_FRACTION % 1.0)

    def _append(self, row: int, columns: list[RouteColumn]) -> None:
        common = [row] if self._count is None else [row, self._count[0]]
        robot = self._columns[-1][0]
        rows = [
            [
                *((j, 1) for j in (*column.tasks, *common)),
                *self._cut_entries(robot, column),
            ]
            for column in columns
        ]
        starts = np.cumsum([0, *(len(r) for r in rows)])[:-1].astype(np.int32)
        index = np.array([r for column in rows for r, _ in column], dtype=np.int32)
        value = np.array([v for column in rows for _, v in column], dtype=float)
        n = len(columns)
        cost = np.array([column.length for column in columns])
        free = np.full(n, highspy.kHighsInf)
        self._highs.addCols(
            n, cost, np.zeros(n), free, len(index), starts, index, value
        )

    def _cut_entries(self, robot: int, column: RouteColumn) -> list[tuple[int, int]]:
        """Return (row, coefficient) of a column in the subset rows."""
        entries = (
            (row, cut.coefficient(robot, column.tasks))
            for cut, row in self._cuts.items()
        )
        return [(row, count) for row, count in entries if count]

    def cut(self, most: int) -> int:
        """Add the subset rows that the last solution violates most; return how many.

        most: rows, at most.
        """
        parts = self.parts
        columns = [(i, column.tasks) for _, i, column in parts]
        x = np.array([part for part, _, _ in parts])
        single = [i for i in self._row if self._number.get(i, 1) == 1]
        found = [
            cut
            for cut in find_violated_rows(columns, x, single, most)
            if cut not in self._cuts
        ]
        for cut in found:
            self._cuts[cut] = self._highs.getNumRow()
            counts = [cut.coefficient(i, column.tasks) for i, column in self._columns]
            _add_cut(self._highs, cut, counts, self._tasks)
        return len(found)

    def at_least(self, robots: int, reward: float) -> None:
        """Add the row that asks for n columns in all; call it once.

        robots: n.
        reward: f in m, the cost of each missing column.
        """
        row = self._highs.getNumRow()
        n = len(self)
        self._count = row, robots
        index = np.arange(self._tasks, self._tasks + n, dtype=np.int32)
        self._highs.addRow(
            self._raised(row, robots), highspy.kHighsInf, n, index, np.ones(n)
        )
        self._highs.addCol(
            reward, 0.0, highspy.kHighsInf, 1, np.array([row], np.int32), np.ones(1)
        )
        self._columns.append(
            (-1, RouteColumn(reward, ()))
        )  # keeps the column numbers of HiGHS

    def relax(self) -> Relaxation:
        """Solve the relaxation with the columns added so far.

        The value is that of the prices at the right-hand sides without `spread`.
        """
        self._highs.run()
        status = self._highs.getModelStatus()
        if status != highspy.HighsModelStatus.kOptimal:
            raise SolverError("restricted master, relaxed", status.name)
        dual = np.array(self._highs.getSolution().row_dual)
        self._sigma = {
            robot: min(0.0, float(dual[row])) for robot, row in self._row.items()
        }
        prices = np.clip(dual[: self._tasks], 0.0, self._penalty)
        saved = [
            self._number.get(robot, 1) * sigma for robot, sigma in self._sigma.items()
        ]
        row, robots = self._count or (0, 0)
        reward = max(0.0, float(dual[row])) if self._count else 0.0
        charged = {
            cut: -float(dual[row]) for cut, row in self._cuts.items() if dual[row] < 0.0
        }
        rows = PricedRows(tuple(charged), tuple(charged.values()))
        return Relaxation(
            math.fsum([*prices, *saved, robots * reward, rows.value]),
            prices,
            self._used,
            reward,
            rows,
        )

    def sigma(self, robot: int) -> float:
        """Return sigma_i <= 0 in m of the last relaxation.

        It is the change of cost by one more route of robot i.
        """
        return self._sigma.get(robot, 0.0)

    @property
    def basis(self) -> list[tuple[int, RouteColumn]]:
        """Columns of the last basis, in the order in which they were added."""
        _, basic = self._highs.getBasicVariables()
        basis = [
            self._columns[int(k) - self._tasks]
            for k in np.sort(basic)
            if k >= self._tasks
        ]
        return [(robot, column) for robot, column in basis if column.tasks]

    def try_column(self, robot: int, column: RouteColumn) -> float:
        """Return the value of the relaxation in m if x of this known column is at least 1."""
        at = self._index[robot, column.tasks] + self._tasks
        self._highs.changeColBounds(at, 1.0, highspy.kHighsInf)
        self._highs.run()
        optimal = self._highs.getModelStatus() == HIGHS_STATUS.kOptimal
        value = self._highs.getObjectiveValue() if optimal else np.inf
        self._highs.changeColBounds(at, 0.0, highspy.kHighsInf)
        return float(value)

    @property
    def parts(self) -> list[tuple[float, int, RouteColumn]]:
        """(x, robot, column) of each column in use in the last solution."""
        x = self._highs.getSolution().col_value[self._tasks :]
        return [
            (part, robot, column)
            for part, (robot, column) in zip(x, self._columns, strict=True)
            if part > COLUMN_COUNT_ROUNDING and column.tasks
        ]

    @property
    def _used(self) -> float:
        x = self._highs.getSolution().col_value[self._tasks :]
        return math.fsum(
            part
            for part, (_, column) in zip(x, self._columns, strict=True)
            if column.tasks
        )


def find_partition(
    problem: PartitionProblem,
    seed: int,
    nodes: int,
    known: Routes | None = None,
    most: int | None = None,
    below: float = np.inf,
) -> PartitionResult:
    """Find the cheapest set of columns that serves each task exactly once.

        min  sum length_c x_c
        s.t. sum_{c serves j} x_c = 1,  sum_{c of i} x_c <= K_i,  x binary,
             sum_c x_c <= most if it is given

    The search stops after a number of branch-and-bound nodes, never after a time. If they do not
    suffice the result may be `known` although a cheaper plan exists; the bound is then below its cost.

    problem: the columns to choose from.
    seed: of HiGHS.
    nodes: branch-and-bound nodes, at most.
    known: a solution to start from.
    most: number of columns, at most.
    below: m; solutions that cost as much or more may be left out.
    Raises SolverError if HiGHS fails, also when it is run again without presolve and start.
    """
    columns = problem.columns
    same = {robot: problem.alike.get(robot, (robot,)) for robot, _ in columns}
    number = {robot: len(robots) for robot, robots in same.items()}
    start = None
    if known is not None:
        start = np.array(
            [
                float(any(known.get(i) == c.tasks for i in same[robot]))
                for robot, c in columns
            ]
        )
    highs = _search_columns(
        _build_partition_model(problem, seed, number, most), nodes, start, below
    )
    if (
        highs.getModelStatus() not in PROPER_END_STATUSES
    ):  # HiGHS 1.x presolves some infeasible problems to a solution that it then rejects
        highs = _build_partition_model(problem, seed, number, most)
        highs.setOptionValue("presolve", "off")
        highs = _search_columns(highs, nodes, None, below)
    status = highs.getModelStatus()
    info = highs.getInfo()
    if status not in PROPER_END_STATUSES:
        raise SolverError(f"set partitioning of {len(columns)} columns", status.name)
    if info.primal_solution_status != int(
        highspy.SolutionStatus.kSolutionStatusFeasible
    ):
        if not columns or status in NO_SOLUTION_STATUSES:
            return PartitionResult(np.inf, {}, np.inf)
        proven = info.mip_dual_bound
        return PartitionResult(np.inf, {}, proven if proven < np.inf else -np.inf)
    chosen = [
        c
        for c, x in zip(columns, highs.getSolution().col_value, strict=True)
        if x > 0.5
    ]
    cost = sum(column.length for _, column in chosen)
    return PartitionResult(
        cost, _assign_columns(chosen, same), min(cost, info.mip_dual_bound)
    )


def find_fewest_columns(
    problem: PartitionProblem,
    seed: int,
    nodes: int,
    weight: float,
    least: int,
    known: Routes | None = None,
) -> PartitionResult:
    """Find the smallest set of columns that serves each task once; among these, the shortest.

        n* = min sum_c x_c,    then  min sum (length_c - weight) x_c  s.t.  sum_c x_c <= n*

    Neither program contains a large number. The cost and the bound of the result include the
    weight.

    weight: m, the part of each length that counts the vehicle, more than any plan costs without it.
    least: no plan has fewer columns.
    The other arguments are those of `find_partition`.
    """
    count = None if known is None else len(known)
    if count is None or count > least:
        counted = problem.with_lengths([1.0] * len(problem.columns))
        few = find_partition(counted, seed, nodes, known)
        if few.cost == np.inf:
            return few
        known = few.routes
        count = len(known)
        least = (
            max(least, math.ceil(few.bound - COLUMN_COUNT_ROUNDING))
            if few.bound > -np.inf
            else least
        )
    light = problem.with_lengths(
        [column.length - weight for _, column in problem.columns]
    )
    found = find_partition(light, seed, nodes, known, count)
    if found.cost == np.inf:
        return PartitionResult(np.inf, {}, np.inf if found.bound == np.inf else -np.inf)
    proven = found.bound if least >= len(found.routes) else 0.0
    return PartitionResult(
        cost=weight * len(found.routes) + found.cost,
        routes=found.routes,
        bound=weight * min(least, len(found.routes)) + proven,
    )


def _search_columns(
    highs: highspy.Highs, nodes: int, start: Vec | None, below: float
) -> highspy.Highs:
    """Run branch and bound over binary columns, for costs below `below`; return the solver."""
    n = highs.getNumCol()
    index = np.arange(n, dtype=np.int32)
    highs.changeColsIntegrality(
        n, index, np.full(n, int(highspy.HighsVarType.kInteger), np.uint8)
    )
    highs.setOptionValue("mip_rel_gap", 0.0)
    highs.setOptionValue("mip_max_nodes", nodes)
    highs.setOptionValue("objective_bound", below)
    if start is not None:
        highs.setSolution(n, index, start)
    highs.run()
    return highs


def _assign_columns(
    chosen: list[tuple[int, RouteColumn]], same: Mapping[int, Sequence[int]]
) -> Routes:
    """Assign each column to a robot of its own."""
    free = {robot: iter(robots) for robot, robots in same.items()}
    return {next(free[robot]): column.tasks for robot, column in chosen}


def _build_partition_model(
    problem: PartitionProblem,
    seed: int,
    number: Mapping[int, int],
    most: int | None,
) -> highspy.Highs:
    """Return the model of `find_partition` with 0 <= x <= 1.

    Rows: tasks = 1, robots in use <= number, all columns <= most, subset rows. Columns: in the given order.
    """
    highs = make_quiet_highs(seed)
    columns = problem.columns
    tasks = problem.tasks
    robots = sorted(number)
    row_of = {robot: tasks + r for r, robot in enumerate(robots)}
    empty = np.array([], np.int32), np.array([])
    for _ in range(tasks):
        highs.addRow(1.0, 1.0, 0, *empty)
    for robot in robots:
        highs.addRow(-highspy.kHighsInf, float(number[robot]), 0, *empty)
    last = []
    if most is not None:
        last = [tasks + len(robots)]
        highs.addRow(-highspy.kHighsInf, float(most), 0, *empty)
    rows = [[*column.tasks, row_of[robot], *last] for robot, column in columns]
    starts = np.cumsum([0, *(len(r) for r in rows)])[:-1].astype(np.int32)
    index = np.array([r for column in rows for r in column], dtype=np.int32)
    n = len(columns)
    cost = np.array([column.length for _, column in columns])
    highs.addCols(
        n, cost, np.zeros(n), np.ones(n), len(index), starts, index, np.ones(len(index))
    )
    for row in problem.rows:
        counts = [row.coefficient(robot, column.tasks) for robot, column in columns]
        _add_cut(highs, row, counts, 0)
    return highs


def _add_cut(
    highs: highspy.Highs, row: SubsetRow, counts: Sequence[int], first: int
) -> None:
    """Add a subset row; counts: coefficients of the columns, beginning with column `first`."""
    index = np.flatnonzero(counts)
    highs.addRow(
        -highspy.kHighsInf,
        float(row.limit),
        len(index),
        (index + first).astype(np.int32),
        np.array(counts, float)[index],
    )
