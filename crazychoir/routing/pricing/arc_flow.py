"""The whole problem as one arc-flow MILP: a slow, independent check of optimality."""

import math
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Literal

import highspy
import numpy as np

from crazychoir.errors import SolverError
from crazychoir.optimization.problems.linear import make_quiet_highs
from crazychoir.routing.instance.instance import Instance
from crazychoir.routing.instance.plan import Route, RoutePlan
from crazychoir.routing.instance.vehicle import (
    OBJECTIVE_NAMES,
    ROUNDING_SLACK,
    Vehicle,
)

Terms = dict[int, float]
"""Coefficient of each variable of a sum."""
Sense = Literal["<=", "==", ">="]
"""Relation between a sum and a number."""
FIRST_OBJECTIVE_TOLERANCE = 1e-6
"""m or s: by how much the first objective may be worse when the second is minimised."""


@dataclass
class _Model:
    """A MILP under construction."""

    highs: highspy.Highs = field(default_factory=make_quiet_highs)

    def variable(
        self, cost: float, low: float, high: float, integer: bool = False
    ) -> int:
        j = int(self.highs.getNumCol())
        self.highs.addCol(cost, low, high, 0, np.array([], np.int32), np.array([]))
        if integer:
            self.highs.changeColIntegrality(j, highspy.HighsVarType.kInteger)
        return j

    def require(self, terms: Terms, sense: Sense, value: float) -> None:
        low = value if sense != "<=" else -highspy.kHighsInf
        high = value if sense != ">=" else highspy.kHighsInf
        index = np.array(list(terms), np.int32)
        coefficient = np.array(list(terms.values()))
        self.highs.addRow(low, high, len(terms), index, coefficient)

    def minimise(self, terms: Terms, where: str) -> list[float]:
        """Minimise the sum of `terms` and return the values of all variables.

        Raises SolverError if optimality is not proven.
        """
        count = int(self.highs.getNumCol())
        costs = np.zeros(count)
        costs[list(terms)] = list(terms.values())
        self.highs.changeColsCost(count, np.arange(count, dtype=np.int32), costs)
        self.highs.run()
        status = self.highs.getModelStatus()
        if status != highspy.HighsModelStatus.kOptimal:
            raise SolverError(where, status.name)
        return list(self.highs.getSolution().col_value)


@dataclass
class _Trip:
    """One trip of one robot."""

    vehicle: Vehicle
    """The robot."""
    begin: int
    """The node at which the trip begins."""
    arcs: dict[tuple[int, int], int]
    """Variable x of each arc (v, w)."""
    stay: int
    """Variable: 1 if the trip is not flown."""
    left: int
    """Variable: when the trip begins, s."""
    back: int
    """Variable: when the trip ends, s."""

    def distances(self) -> Terms:
        """Return the terms of its length.

        A trip without a stop flies from its begin to the end. A trip that is not flown has no
        length.
        """
        m = self.vehicle.tasks
        at = {(v, w): (self.begin if v == 2 * m else v, w) for v, w in self.arcs}
        return {
            x: float(self.vehicle.distance[at[arc]]) for arc, x in self.arcs.items()
        }


def solve_compact(instance: Instance, nodes: int = 1_000_000) -> RoutePlan:
    """Return a proven optimal plan.

        min  sum_i [ sum_(j,k) d_i^jk x_i^jk + fixed (1 - stay_i) ] + sum_j penalty_j z_j
        s.t. sum_i sum_k x_i^jk + z_j = 1                pickup j: left once by one robot, or refused
             sum_k x_i^sk + stay_i = 1                   start s; s -> t flies there without a stop
             sum_j x_i^jt + stay_i = 1                   end t
             sum_j x_i^jk = sum_j x_i^kj                 flow, every stop k
             sum_k x_i^jk = sum_k x_i^(j+M)k             the same robot delivers
             P_i^k >= P_i^j + 1 - 2M (1 - x_i^jk)        order: no subtours, even of length 0
             P_i^j + 1 <= P_i^(j+M)                      pickup before delivery
             Q_i^k >= Q_i^j + q_k - C' (1 - x_i^jk)      load on board, 0 <= Q <= C_i
             B_i^k >= B_i^j + t_i^jk - H (1 - x_i^jk)    begin of service, in its window
             sum d_i^jk x_i^jk <= route_length_limit
             T >= B_i^t - H stay_i                       makespan, in place of the sum over i

    A robot with several trips has a copy of x for each trip: B_i^s of the next trip is at least
    B_i^t of this one, and the next stays if this one does. If there are two objectives, the second
    is minimised with the first at its optimum.

    instance: the problem.
    nodes: branch-and-bound nodes, at most.
    Raises SolverError if HiGHS does not prove optimality within `nodes` nodes.
    Source: the three-index model of Parragh, Doerner, Hartl 2008, J. Betriebswirtschaft 58, with
    a robot index.
    """
    model = _Model()
    vehicles = [instance.local(i).vehicle for i in range(instance.robots)]
    teams = [_add_robot(model, vehicle) for vehicle in vehicles]
    refused = _add_tasks(model, instance, [trip for trips in teams for trip in trips])
    last = _add_makespan(model, teams)
    model.highs.setOptionValue("mip_rel_gap", 0.0)
    model.highs.setOptionValue("mip_abs_gap", 0.0)
    model.highs.setOptionValue("mip_max_nodes", nodes)
    counted = {trips[0].stay: -1.0 for trips in teams}
    costs = {
        OBJECTIVE_NAMES.total: _list_cost_terms(teams, instance.fixed_cost),
        OBJECTIVE_NAMES.makespan: {last: 1.0},
        OBJECTIVE_NAMES.vehicles: counted,
    }
    values: list[float] = []
    terms: Terms = refused
    for name in instance.objective:
        values = model.minimise(costs[name] | terms, f"{instance.name}: compact model")
        best = math.fsum(c * values[x] for x, c in (costs[name] | terms).items())
        model.require(costs[name] | terms, "<=", best + FIRST_OBJECTIVE_TOLERANCE)
        terms = {}
    return instance.plan(_read_route(trips, values) for trips in teams)


def _add_robot(model: _Model, vehicle: Vehicle) -> list[_Trip]:
    """Add variables and rows of one robot, a copy for each trip.

    Nodes: 0..2M-1 stops, 2M start, 2M + 1 end.
    """
    m = vehicle.tasks
    trips = [
        _add_trip(model, vehicle, 2 * m if r == 0 else 2 * m + 1)
        for r in range(vehicle.trips)
    ]
    for r, trip in enumerate(trips):
        limit = vehicle.limit if r == 0 else vehicle.limit_again
        if math.isfinite(limit):
            model.require(trip.distances(), "<=", limit + ROUNDING_SLACK)
    for one, two in pairwise(trips):
        model.require({one.stay: 1.0, two.stay: -1.0}, "<=", 0.0)
        model.require({two.left: 1.0, one.back: -1.0}, ">=", 0.0)
    return trips


def _add_trip(model: _Model, vehicle: Vehicle, begin: int) -> _Trip:
    m = vehicle.tasks
    start = 2 * m
    end = 2 * m + 1
    served = [int(j) for j in vehicle.servable]
    stops = served + [m + j for j in served]
    pairs = [
        (v, w) for v in [start, *stops] for w in [*stops, end] if v != w and v != w + m
    ]
    arcs = {pair: model.variable(0.0, 0, 1, integer=True) for pair in pairs}
    horizon = _bound_duration(vehicle)
    latest = np.minimum(vehicle.latest + ROUNDING_SLACK, horizon)
    stay = model.variable(0.0, 0, 1, integer=True)
    begun = {
        v: model.variable(0.0, float(vehicle.earliest[v]), float(latest[v]))
        for v in [start, *stops, end]
    }
    trip = _Trip(vehicle, begin, arcs, stay, begun[start], begun[end])
    _add_flow(model, trip, stops)
    _add_schedule(model, trip, stops)
    for (v, w), x in arcs.items():
        way = float(vehicle.duration[begin if v == start else v, w])
        model.require(
            {begun[w]: 1.0, begun[v]: -1.0, x: -(horizon + way)}, ">=", -horizon
        )
    model.require({trip.back: 1.0, trip.left: -1.0, stay: horizon}, ">=", 0.0)
    return trip


def _bound_duration(vehicle: Vehicle) -> float:
    """Return a time in s by which any route without needless waiting is over."""
    return float(
        vehicle.earliest.max() + vehicle.trips * vehicle.duration.max(axis=1).sum()
    )


def _add_flow(model: _Model, trip: _Trip, stops: list[int]) -> None:
    m = trip.vehicle.tasks
    leaving = {
        v: {x: 1.0 for (a, _), x in trip.arcs.items() if a == v}
        for v in [*stops, 2 * m]
    }
    entering = {
        w: {x: 1.0 for (_, b), x in trip.arcs.items() if b == w}
        for w in [*stops, 2 * m + 1]
    }
    model.require(leaving[2 * m] | {trip.stay: 1.0}, "==", 1.0)
    model.require(entering[2 * m + 1] | {trip.stay: 1.0}, "==", 1.0)
    for v in stops:
        model.require(leaving[v] | {x: -1.0 for x in entering[v]}, "==", 0.0)
        if v < m:
            model.require(leaving[v] | {x: -1.0 for x in leaving[v + m]}, "==", 0.0)


def _add_schedule(model: _Model, trip: _Trip, stops: list[int]) -> None:
    vehicle = trip.vehicle
    last = len(stops) - 1
    m = vehicle.tasks
    q = vehicle.load
    place = {
        v: model.variable(0.0, 0 if v < m else 1, last if v >= m else last - 1)
        for v in stops
    }
    load = {
        v: model.variable(
            0.0, float(q[v]) if v < m else 0.0, vehicle.capacity + ROUNDING_SLACK
        )
        for v in stops
    }
    for v in stops:
        if v < m:
            model.require({place[v]: 1.0, place[v + m]: -1.0}, "<=", -1.0)
    for (v, w), x in trip.arcs.items():
        if v in place and w in place:
            model.require(
                {place[w]: 1.0, place[v]: -1.0, x: -(last + 1.0)}, ">=", -float(last)
            )
            change = float(q[w]) if w < m else -float(q[w - m])
            spare = vehicle.capacity + max(change, 0.0)
            model.require(
                {load[w]: 1.0, load[v]: -1.0, x: -spare}, ">=", change - spare
            )


def _add_tasks(model: _Model, instance: Instance, trips: list[_Trip]) -> Terms:
    """Require that every task has one robot or is refused; return the costs of the refusals."""
    costs: Terms = {}
    for j, refusal in enumerate(instance.tasks.refusal):
        terms = {x: 1.0 for trip in trips for (v, _), x in trip.arcs.items() if v == j}
        if math.isfinite(refusal):
            left_out = model.variable(0.0, 0, 1, integer=True)
            costs[left_out] = float(refusal)
            terms[left_out] = 1.0
        model.require(terms, "==", 1.0)
    return costs


def _add_makespan(model: _Model, teams: list[list[_Trip]]) -> int:
    last = model.variable(0.0, 0.0, highspy.kHighsInf)
    for trips in teams:
        horizon = _bound_duration(trips[0].vehicle)
        model.require(
            {last: 1.0, trips[-1].back: -1.0, trips[0].stay: horizon}, ">=", 0.0
        )
    return last


def _list_cost_terms(teams: list[list[_Trip]], fixed: float) -> Terms:
    """Return the terms of lengths and fixed costs.

    A robot that stays saves the fixed cost; the constant part is left out.
    """
    terms: Terms = {}
    for trips in teams:
        for trip in trips:
            terms |= trip.distances()
        terms[trips[0].stay] = -fixed
    return terms


def _read_route(trips: list[_Trip], values: list[float]) -> Route:
    vehicle = trips[0].vehicle
    m = vehicle.tasks
    nodes = []
    for trip in (trip for trip in trips if values[trip.stay] < 0.5):
        after = {v: w for (v, w), x in trip.arcs.items() if values[x] > 0.5}
        nodes += [2 * m + 1] if trip is not trips[0] else []
        at = after[2 * m]
        while at != 2 * m + 1:
            nodes.append(at)
            at = after[at]
    while nodes and nodes[-1] > 2 * m:  # trips without a stop
        nodes.pop()
    return Route.from_nodes(
        vehicle.robot, nodes, m, vehicle.length(nodes), vehicle.finish(nodes)
    )
