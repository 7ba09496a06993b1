"""The whole problem as one arc-flow MILP: a slow, independent judge of optimality for small instances."""

import math
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Literal

import highspy
import numpy as np

from crazychoir.errors import SolverError
from crazychoir.routing.columns import quiet_highs
from crazychoir.routing.instance import Instance, LocalProblem
from crazychoir.routing.plan import Plan, Route
from crazychoir.routing.vehicle import SLACK

Terms = dict[int, float]
Sense = Literal["<=", "==", ">="]


@dataclass
class _Model:
    """A MILP under construction."""

    highs: highspy.Highs = field(default_factory=quiet_highs)

    def variable(self, cost: float, low: float, high: float, integer: bool = False) -> int:
        j = int(self.highs.getNumCol())
        self.highs.addCol(cost, low, high, 0, np.array([], np.int32), np.array([]))
        if integer:
            self.highs.changeColIntegrality(j, highspy.HighsVarType.kInteger)
        return j

    def require(self, terms: Terms, sense: Sense, value: float) -> None:
        low = value if sense != "<=" else -highspy.kHighsInf
        high = value if sense != ">=" else highspy.kHighsInf
        index, coefficient = np.array(list(terms), np.int32), np.array(list(terms.values()))
        self.highs.addRow(low, high, len(terms), index, coefficient)


def solve_compact(instance: Instance, nodes: int = 1_000_000) -> Plan:
    """A proven optimal plan.

        min  sum_i sum_(j,k) d_i^jk x_i^jk
        s.t. sum_i sum_k x_i^jk = 1                      every pickup j is left once, by one robot
             sum_k x_i^sk = 1,  sum_j x_i^jt = 1         start s and end t at home; s -> t is staying there
             sum_j x_i^jk = sum_j x_i^kj                 flow, every stop k
             sum_k x_i^jk = sum_k x_i^(j+M)k             the same robot delivers
             B_i^k >= B_i^j + 1 - 2M (1 - x_i^jk)        place in the order: no subtours, not even of length 0
             B_i^j + 1 <= B_i^(j+M)                      pickup before delivery
             Q_i^k >= Q_i^j + q_k - C' (1 - x_i^jk)      load on board, 0 <= Q <= C_i
             sum d_i^jk x_i^jk <= route_length_limit

    Raises SolverError if HiGHS does not prove optimality within `nodes` nodes.
    Source: the three-index model of Parragh, Doerner, Hartl 2008, J. Betriebswirtschaft 58, with a robot index.
    """
    model = _Model()
    arcs = [_add_robot(model, instance.local(i)) for i in range(instance.robots)]
    for j in range(len(instance.tasks)):
        model.require({x: 1.0 for own in arcs for (v, _), x in own.items() if v == j}, "==", 1.0)
    model.highs.setOptionValue("mip_rel_gap", 0.0)
    model.highs.setOptionValue("mip_max_nodes", nodes)
    model.highs.run()
    status = model.highs.getModelStatus()
    if status != highspy.HighsModelStatus.kOptimal:
        raise SolverError(f"{instance.name}: compact model", status.name)
    values = model.highs.getSolution().col_value
    return Plan(tuple(_route(instance.local(i), own, values) for i, own in enumerate(arcs)))


def _add_robot(model: _Model, local: LocalProblem) -> dict[tuple[int, int], int]:
    """Variables and rows of one robot; returns its arc variables. Nodes: 0..2M-1 stops, 2M start, 2M + 1 end."""
    m, d = len(local.tasks), local.vehicle.distance
    start, end = 2 * m, 2 * m + 1
    served = [int(j) for j in local.servable]
    stops = served + [m + j for j in served]
    pairs = [(v, w) for v in [start, *stops] for w in [*stops, end] if v != w and v != w + m]
    arcs = {(v, w): model.variable(float(d[min(v, start), min(w, start)]), 0, 1, integer=True) for v, w in pairs}
    _add_flow(model, arcs, stops, m)
    _add_schedule(model, local, arcs, stops)
    if math.isfinite(local.limit):
        lengths = {x: float(d[min(v, start), min(w, start)]) for (v, w), x in arcs.items()}
        model.require(lengths, "<=", local.limit + SLACK)
    return arcs


def _add_flow(model: _Model, arcs: dict[tuple[int, int], int], stops: list[int], m: int) -> None:
    leaving = {v: {x: 1.0 for (a, _), x in arcs.items() if a == v} for v in [*stops, 2 * m]}
    entering = {w: {x: 1.0 for (_, b), x in arcs.items() if b == w} for w in [*stops, 2 * m + 1]}
    model.require(leaving[2 * m], "==", 1.0)
    model.require(entering[2 * m + 1], "==", 1.0)
    for v in stops:
        model.require(leaving[v] | {x: -1.0 for x in entering[v]}, "==", 0.0)
        if v < m:
            model.require(leaving[v] | {x: -1.0 for x in leaving[v + m]}, "==", 0.0)


def _add_schedule(model: _Model, local: LocalProblem, arcs: dict[tuple[int, int], int], stops: list[int]) -> None:
    m, q, last = len(local.tasks), local.tasks.load, len(stops) - 1
    place = {v: model.variable(0.0, 0 if v < m else 1, last if v >= m else last - 1) for v in stops}
    load = {v: model.variable(0.0, float(q[v]) if v < m else 0.0, local.capacity + SLACK) for v in stops}
    for v in stops:
        if v < m:
            model.require({place[v]: 1.0, place[v + m]: -1.0}, "<=", -1.0)
    for (v, w), x in arcs.items():
        if v in place and w in place:
            model.require({place[w]: 1.0, place[v]: -1.0, x: -(last + 1.0)}, ">=", -float(last))
            change = float(q[w]) if w < m else -float(q[w - m])
            spare = local.capacity + max(change, 0.0)
            model.require({load[w]: 1.0, load[v]: -1.0, x: -spare}, ">=", change - spare)


def _route(local: LocalProblem, arcs: dict[tuple[int, int], int], values: list[float]) -> Route:
    m = len(local.tasks)
    after = {v: w for (v, w), x in arcs.items() if values[x] > 0.5}
    nodes, at = [], after[2 * m]
    while at != 2 * m + 1:
        nodes.append(at)
        at = after[at]
    tour = [2 * m, *nodes, 2 * m]
    length = sum(float(local.vehicle.distance[v, w]) for v, w in pairwise(tour))
    return Route.from_nodes(local.robot, nodes, m, length)
