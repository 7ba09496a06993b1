"""The best plan from known routes: set partitioning over the routes with a small reduced cost."""

from collections.abc import Sequence
from typing import NamedTuple

import highspy
import numpy as np

from crazychoir.optimization.problems.linear import make_quiet_highs
from crazychoir.routing.search.route_pool import RoutePool
from crazychoir.routing.search.tours import Fleet, Tours, refresh_route
from crazychoir.types import Bools, Ints, Vec

MOST_COMBINED_ROUTES = 250
"""Largest number of routes in the integer program."""
MOST_PARTITIONING_NODES = 50
"""Largest number of nodes of its search."""


class _SparseColumns(NamedTuple):
    """Columns as a sparse matrix.

    The rows of column c are row[start[c] : start[c + 1]]: its tasks, then M + its kind of vehicle.
    """

    cost: Vec
    """(C,) m."""
    start: Ints
    """(C + 1,): where the rows of each column begin."""
    row: Ints
    """Row numbers of all columns, one column after the other."""

    def only(self, chosen: Ints) -> "_SparseColumns":
        parts = [self.row[self.start[c] : self.start[c + 1]] for c in chosen]
        return _SparseColumns(
            self.cost[chosen], np.cumsum([0, *map(len, parts)]), np.concatenate(parts)
        )


def assemble_plan(fleet: Fleet, pool: RoutePool, tours: Tours, closed: Bools) -> Tours:
    """Return a plan of routes of the pool that costs less than `tours`; `tours` if none is found.

        min  sum_c cost_c x_c + sum_j penalty_j v_j
        s.t. sum_{c serves j} x_c + v_j = 1,  x, v binary
             sum_{c of kind h} x_c <= vehicles of that kind

    A task that must be served has no v. Only the columns with a small reduced cost, at the
    prices of the linear relaxation, are used: at most the gap between `tours` and that
    relaxation. No other column can be part of a better plan. If there are more than
    MOST_COMBINED_ROUTES such columns, or MOST_PARTITIONING_NODES nodes do not suffice, the best
    plan may be missed. If vehicles are counted, each of them costs more than all routes of a
    plan with no more vehicles than `tours`. The plan found is then compared by its vehicles
    first, so that no rounding of the program decides.

    closed: (K,) vehicles that must not leave.
    """
    chosen = np.flatnonzero(pool.vehicle >= 0)
    vehicle = _price_vehicles(fleet, pool, tours, chosen)
    columns = _build_columns(fleet, pool, chosen, vehicle)
    cost = _compute_plan_cost(fleet, tours, vehicle)
    relaxation = _build_linear_program(fleet, columns, closed)
    relaxation.run()
    if relaxation.getModelStatus() != highspy.HighsModelStatus.kOptimal:
        return tours
    reduced = np.array(relaxation.getSolution().col_dual)[: len(chosen)]
    gap = cost - relaxation.getObjectiveValue()
    near = np.argsort(reduced, kind="stable")[:MOST_COMBINED_ROUTES]
    near = np.sort(near[reduced[near] <= gap])
    if gap <= 0.0 or not len(near):
        return tours
    taken = _solve_integer_program(fleet, columns.only(near), cost, closed)
    if taken is None:
        return tours
    found = _build_tours(fleet, pool, chosen[near[taken]], closed)
    return (
        tours
        if fleet.counted
        and _compute_plan_values(fleet, found) >= _compute_plan_values(fleet, tours)
        else found
    )


def _price_vehicles(fleet: Fleet, pool: RoutePool, tours: Tours, chosen: Ints) -> Vec:
    """Return (K,) m: cost of each vehicle that leaves, in the program."""
    if not fleet.counted:
        return fleet.fixed
    left = tours.stops > 0
    longest = max(
        [*tours.length[left], *(pool.cost[chosen] - fleet.fixed[pool.vehicle[chosen]])],
        default=0.0,
    )
    return np.minimum(fleet.fixed, 1.0 + np.count_nonzero(left) * longest)


def _compute_plan_values(fleet: Fleet, tours: Tours) -> tuple[float, int, float]:
    """Return penalties, vehicles, length: these compare plans if vehicles are counted."""
    left = tours.stops > 0
    penalties = sum(fleet.penalty[tours.at < 0].tolist(), 0.0)
    return penalties, int(np.count_nonzero(left)), sum(tours.length[left].tolist(), 0.0)


def _build_columns(
    fleet: Fleet, pool: RoutePool, chosen: Ints, vehicle: Vec
) -> _SparseColumns:
    m = len(fleet.load)
    rows = []
    for p in chosen:
        stops = pool.stop[p, : pool.stops[p]]
        rows.append(
            [
                *(stops[(m <= stops) & (stops < 2 * m)] - m),
                m + fleet.twin[pool.vehicle[p]],
            ]
        )
    cost = pool.cost[chosen]
    if fleet.counted:
        cost = cost - fleet.fixed[pool.vehicle[chosen]] + vehicle[pool.vehicle[chosen]]
    return _SparseColumns(
        cost,
        np.cumsum([0, *map(len, rows)]),
        np.array([r for row in rows for r in row]),
    )


def _compute_plan_cost(fleet: Fleet, tours: Tours, vehicle: Vec) -> float:
    """Return the cost in m; inf if a task is missing.

    It is the sum of distances, vehicles that leave and penalties, added in this order.
    """
    left = tours.stops > 0
    return sum(
        [
            *tours.length[left].tolist(),
            *vehicle[left].tolist(),
            *fleet.penalty[tours.at < 0].tolist(),
        ],
        0.0,
    )


def _build_linear_program(
    fleet: Fleet, columns: _SparseColumns, closed: Bools
) -> highspy.Highs:
    """Return the linear program.

    Rows: tasks, then the number of vehicles of each kind. Columns: the routes, then refusals.
    """
    m = len(fleet.load)
    k = len(fleet.start)
    highs = make_quiet_highs()
    empty = (np.array([], np.int32), np.array([]))
    for _ in range(m):
        highs.addRow(1.0, 1.0, 0, *empty)
    for number in np.bincount(fleet.twin[~closed], minlength=k):
        highs.addRow(-highspy.kHighsInf, float(number), 0, *empty)
    n = len(columns.cost)
    ones = np.ones(len(columns.row))
    start = columns.start[:-1].astype(np.int32)
    row = columns.row.astype(np.int32)
    highs.addCols(n, columns.cost, np.zeros(n), np.ones(n), len(row), start, row, ones)
    for j in np.flatnonzero(np.isfinite(fleet.penalty)):
        highs.addCol(
            float(fleet.penalty[j]), 0.0, 1.0, 1, np.array([j], np.int32), np.ones(1)
        )
    return highs


def _solve_integer_program(
    fleet: Fleet, columns: _SparseColumns, below: float, closed: Bools
) -> Ints | None:
    """Return the columns of a solution that costs less than `below`, None if none is found."""
    highs = _build_linear_program(fleet, columns, closed)
    index = np.arange(highs.getNumCol(), dtype=np.int32)
    kinds = np.full(len(index), int(highspy.HighsVarType.kInteger), np.uint8)
    highs.changeColsIntegrality(len(index), index, kinds)
    highs.setOptionValue("mip_rel_gap", 0.0)
    highs.setOptionValue("mip_max_nodes", MOST_PARTITIONING_NODES)
    highs.setOptionValue("objective_bound", below)
    highs.run()
    if highs.getInfo().primal_solution_status != int(
        highspy.SolutionStatus.kSolutionStatusFeasible
    ):
        return None
    if highs.getObjectiveValue() >= below:
        return None
    return np.flatnonzero(
        np.array(highs.getSolution().col_value)[: len(columns.cost)] > 0.5
    )


def _build_tours(fleet: Fleet, pool: RoutePool, taken: Ints, closed: Bools) -> Tours:
    """Return a plan of the routes of the pool at these places, each by a vehicle of its kind."""
    free = [
        list(np.flatnonzero((fleet.twin == kind) & ~closed))
        for kind in range(len(fleet.twin))
    ]
    routes: list[Sequence[int]] = [[] for _ in fleet.start]
    for p in taken:
        routes[free[fleet.twin[pool.vehicle[p]]].pop(0)] = pool.stop[
            p, : pool.stops[p]
        ].tolist()
    tours = Tours.of(fleet, routes)
    for k in range(len(routes)):
        refresh_route(fleet, tours, k)
    return tours
