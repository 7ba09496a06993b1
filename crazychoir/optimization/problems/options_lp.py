"""Combine the options of all agents: each agent takes one of its options.

An option has a cost and uses common resources.
"""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import highspy
import numpy as np

from crazychoir.errors import SolverError
from crazychoir.optimization.problems.linear import make_quiet_highs
from crazychoir.optimization.problems.mixed_integer import MixedIntegerBlock
from crazychoir.types import Vec


@dataclass(frozen=True, slots=True)
class OptionsSearch:
    """How the options of all agents are combined by branch and bound."""

    most_nodes: int = 1_000
    """Limit of branch-and-bound nodes when the options are combined."""
    relative_gap: float = 1e-6
    """Relative gap at which the branch and bound ends."""
    excess_cost: float = 10.0
    """Cost of one unit of excess, in sums of the absolute costs of all options."""


OPTIONS_SEARCH = OptionsSearch()


class AgentOptions:
    """Distinct solutions of one agent.

    x: each solution
    table: [cost, use of each resource] of each solution
    """

    def __init__(self, block: MixedIntegerBlock) -> None:
        self._block = block
        self.x: list[Vec] = []
        self.table: list[list[float]] = []

    def add(self, x: Vec) -> None:
        """Add a solution unless an equal one is there already."""
        row = [float(self._block.c @ x), *(self._block.A @ x).tolist()]
        if row not in self.table:
            self.x.append(x)
            self.table.append(row)


class OptionsPool:
    """All agents' options, as far as they are known.

        min  sum_io cost_io l_io + W sum_s v_s
        s.t.  sum_io use_io l_io <= capacity + v,   sum_o l_io = 1,   l, v >= 0

    W is larger than any difference of costs, so that the excess v is as small as possible.

    capacity: (S,) amount of each resource
    agents: ids of the agents
    """

    def __init__(self, capacity: Vec, agents: Sequence[int]) -> None:
        self._capacity = capacity
        self.agents = list(agents)
        self._tables: dict[int, list[list[float]]] = {j: [] for j in agents}

    def add(self, fresh: Mapping[int, Sequence[Sequence[float]]]) -> bool:
        """Add the options of each agent; return True if there are any."""
        for j, rows in fresh.items():
            self._tables[j] += [list(row) for row in rows]
        return any(fresh.values())

    def prices(self) -> Vec:
        """Return the prices pi >= 0 (S,) of the resources for the cheapest mixture of options."""
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
        """Return the best choice of one option an agent, or None if none was found.

        searcher: id of the agent that searches; it is the seed of the search
        Returns [[excess, cost], searcher, chosen option of each agent].
        """
        highs, count = self._model(searcher)
        binary = np.arange(count, dtype=np.int32)
        highs.changeColsIntegrality(
            count, binary, np.full(count, int(highspy.HighsVarType.kInteger), np.uint8)
        )
        highs.setOptionValue("mip_rel_gap", OPTIONS_SEARCH.relative_gap)
        highs.setOptionValue("mip_max_nodes", OPTIONS_SEARCH.most_nodes)
        highs.run()
        if highs.getInfo().primal_solution_status != int(
            highspy.SolutionStatus.kSolutionStatusFeasible
        ):
            return None
        ends = np.cumsum([len(table) for table in self._tables.values()])[:-1]
        weights = np.split(np.array(highs.getSolution().col_value)[:count], ends)
        chosen = [int(np.argmax(of_agent)) for of_agent in weights]
        cost, left = self.value(chosen)
        return [[sum_excess(left), cost], searcher, chosen]

    def value(self, chosen: Sequence[int]) -> tuple[float, Vec]:
        """Return the cost of one option an agent, and the resources (S,) that remain.

        chosen: index of the option of each agent
        """
        rows = [
            table[o] for table, o in zip(self._tables.values(), chosen, strict=True)
        ]
        return math.fsum(row[0] for row in rows), self._capacity - sum_columns(
            row[1:] for row in rows
        )

    def _model(self, seed: int = 0) -> tuple[highspy.Highs, int]:
        """Return the model and the number of options. Its columns are the options, then v."""
        highs = make_quiet_highs(seed)
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
        large = 1.0 + OPTIONS_SEARCH.excess_cost * math.fsum(
            abs(row[0]) for _, row in columns
        )
        for s in range(S):
            highs.addCol(
                large, 0.0, highspy.kHighsInf, 1, np.array([s], np.int32), -np.ones(1)
            )
        return highs, len(columns)


def sum_excess(left: Vec) -> float:
    """Return the sum by which resources are exceeded.

    left: (S,) what remains of each resource, negative where it is exceeded
    """
    return math.fsum(np.maximum(-left, 0.0))


def sum_columns(rows: Iterable[Sequence[float] | Vec]) -> Vec:
    """Return the exact sum of each column, rounded once, so that all agents get the same bits."""
    return np.array(
        [math.fsum(column) for column in np.array(list(rows), dtype=float).T]
    )
