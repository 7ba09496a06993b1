"""Options of all agents, of which each takes one: what they cost, and what they use of the common resources."""

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import highspy
import numpy as np

from crazychoir.errors import SolverError
from crazychoir.optimization.problems.linear import quiet_highs
from crazychoir.optimization.problems.mixed_integer import MixedIntegerBlock
from crazychoir.types import Vec

NODES = 1_000
"""Of the branch and bound that combines them."""
ENOUGH = 1e-6
"""The gap at which it ends."""
DEAR = 10.0
"""What a unit that is exceeded costs, in sums of all costs."""


class Options:
    """Distinct solutions of one agent. x: of each;  table: [cost, use of each resource] of each."""

    def __init__(self, block: MixedIntegerBlock) -> None:
        self._block = block
        self.x: list[Vec] = []
        self.table: list[list[float]] = []

    def add(self, x: Vec) -> None:
        """One more, if it is another one."""
        row = [float(self._block.c @ x), *(self._block.A @ x).tolist()]
        if row not in self.table:
            self.x.append(x)
            self.table.append(row)


class Pool:
    """What all agents know of the options of all.

        min  sum_io cost_io l_io + W sum_s v_s   s.t.  sum_io use_io l_io <= capacity + v,   sum_o l_io = 1,   l, v >= 0

    capacity: (S,);  agents: ids;  W: more than any difference of costs, so that as little as possible is exceeded.
    """

    def __init__(self, capacity: Vec, agents: Sequence[int]) -> None:
        self._capacity = capacity
        self.agents = list(agents)
        self._tables: dict[int, list[list[float]]] = {j: [] for j in agents}

    def add(self, fresh: Mapping[int, Sequence[Sequence[float]]]) -> bool:
        """Options by agent; whether there are any."""
        for j, rows in fresh.items():
            self._tables[j] += [list(row) for row in rows]
        return any(fresh.values())

    def prices(self) -> Vec:
        """(S,) pi >= 0 of the resources, of the cheapest mixture."""
        highs, _ = self._model()
        highs.run()
        if highs.getModelStatus() != highspy.HighsModelStatus.kOptimal:
            raise SolverError("options of all agents", highs.getModelStatus().name)
        return np.asarray(
            np.maximum(
                -np.array(highs.getSolution().row_dual)[: len(self._capacity)], 0.0
            )
        )

    def best(self, searcher: int) -> list[Any] | None:
        """[[what is exceeded, cost], searcher, chosen option of each agent]: one each; None if none was found."""
        highs, count = self._model(searcher)
        binary = np.arange(count, dtype=np.int32)
        highs.changeColsIntegrality(
            count, binary, np.full(count, int(highspy.HighsVarType.kInteger), np.uint8)
        )
        highs.setOptionValue("mip_rel_gap", ENOUGH)
        highs.setOptionValue("mip_max_nodes", NODES)
        highs.run()
        if highs.getInfo().primal_solution_status != int(
            highspy.SolutionStatus.kSolutionStatusFeasible
        ):
            return None
        ends = np.cumsum([len(table) for table in self._tables.values()])[:-1]
        weights = np.split(np.array(highs.getSolution().col_value)[:count], ends)
        chosen = [int(np.argmax(of_agent)) for of_agent in weights]
        cost, left = self.value(chosen)
        return [[exceeded(left), cost], searcher, chosen]

    def value(self, chosen: Sequence[int]) -> tuple[float, Vec]:
        """Cost, and what is left of the resources, of one option an agent."""
        rows = [
            table[o] for table, o in zip(self._tables.values(), chosen, strict=True)
        ]
        return math.fsum(row[0] for row in rows), self._capacity - column_sums(
            row[1:] for row in rows
        )

    def _model(self, seed: int = 0) -> tuple[highspy.Highs, int]:
        """Columns: the options, then v."""
        highs = quiet_highs(seed)
        S = len(self._capacity)
        none = np.array([], np.int32)
        for most in self._capacity:
            highs.addRow(-highspy.kHighsInf, float(most), 0, none, none)
        for _ in self.agents:
            highs.addRow(1.0, 1.0, 0, none, none)
        columns = [
            (i, row) for i, table in enumerate(self._tables.values()) for row in table
        ]
        for i, (cost, *use) in columns:
            at = np.array([*range(S), S + i], np.int32)
            highs.addCol(cost, 0.0, highspy.kHighsInf, S + 1, at, np.array([*use, 1.0]))
        large = 1.0 + DEAR * math.fsum(abs(row[0]) for _, row in columns)
        for s in range(S):
            highs.addCol(
                large, 0.0, highspy.kHighsInf, 1, np.array([s], np.int32), -np.ones(1)
            )
        return highs, len(columns)


def exceeded(left: Vec) -> float:
    """By how much resources are exceeded, in all."""
    return math.fsum(np.maximum(-left, 0.0))


def column_sums(rows: Iterable[Sequence[float] | Vec]) -> Vec:
    """Of each column, rounded alike by all."""
    return np.array(
        [math.fsum(column) for column in np.array(list(rows), dtype=float).T]
    )
