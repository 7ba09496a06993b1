"""Combine the options of all agents: each agent takes a mixture of options with the same integers.

An option has a cost and uses common resources.
"""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import highspy
import numpy as np

from crazychoir.errors import SolverError
from crazychoir.optimization.problems.linear import demand_tolerance, make_quiet_highs
from crazychoir.optimization.problems.mixed_integer import (
    LOCAL_TOLERANCE,
    BoxBounds,
    MixedIntegerBlock,
)
from crazychoir.types import Vec

Mixture = list[list[Any]]
"""[option, weight] of each option in use of one agent; the weights add up to 1."""


@dataclass(frozen=True, slots=True)
class CombinationLimits:
    """How the options of all agents are combined by branch and bound."""

    most_nodes: int = 1_000
    """Limit of branch-and-bound nodes when the options are combined."""
    relative_gap: float = 1e-6
    """Relative gap at which the branch and bound ends."""
    excess_cost: float = 10.0
    """Cost of one unit of excess, in sums of the absolute costs of all options."""
    least_weight: float = 1e-7
    """A weight above this is not zero."""


COMBINATION_LIMITS = CombinationLimits()


class AgentOptions:
    """Distinct solutions of one agent.

    Solutions with the same integers have the same pattern. A mixture of them is a solution too,
    because they are points of one convex set.

    x: each solution
    table: [pattern, cost, use of each resource] of each solution
    """

    def __init__(self, block: MixedIntegerBlock) -> None:
        self.block = block
        self._patterns: dict[tuple[float, ...], int] = {}
        self.x: list[Vec] = []
        self.table: list[list[float]] = []

    def add(self, x: Vec) -> None:
        """Add a solution unless an equal one is there already."""
        block = self.block
        integers = tuple(x[block.integer].tolist())
        pattern = self._patterns.setdefault(integers, len(self._patterns))
        row = [pattern, float(block.c @ x), *(block.A @ x).tolist()]
        if row not in self.table:
            self.x.append(x)
            self.table.append(row)

    def within(self, box: BoxBounds) -> list[int] | None:
        """Return the indices of the solutions in a box, or None for all if it is the whole set."""
        if box is self.block.bounds:
            return None
        low, high = box
        slack = COMBINATION_LIMITS.least_weight
        return [
            o
            for o, x in enumerate(self.x)
            if (x >= low - slack).all() and (x <= high + slack).all()
        ]

    def mean(self, mixture: Mixture) -> Vec:
        """Return the mean (n,) of a mixture, a point of conv(X_i)."""
        return np.asarray(np.sum([weight * self.x[o] for o, weight in mixture], axis=0))

    def mix(self, mixture: Mixture) -> Vec:
        """Return the solution (n,) that is the mean of a mixture, if its integers are integers."""
        x = self.mean(mixture)
        return np.where(self.block.integer, np.round(x), x)


@dataclass(frozen=True)
class TeamChoice:
    """A mixture of options of each agent."""

    mixtures: list[Mixture]
    """The mixture of each agent, in the order of the pool's agents."""
    cost: float
    """Cost of all agents."""
    left: Vec
    """(S,) what remains of each resource, negative where it is exceeded."""

    excess: float
    """Sum by which resources are exceeded, in units in which the largest number of each is 1 to 2."""


class OptionsPool:
    """All agents' options, as far as they are known.

        min  sum_io cost_io l_io + W sum_s v_s
        s.t.  sum_io use_io l_io <= capacity + v,   sum_o l_io = 1,   l, v >= 0
              and, for a solution, all o with l_io > 0 have the same pattern, for each i

    W is larger than any difference of costs, so that the excess v is as small as possible.

    capacity: (S,) amount of each resource
    scale: (S,) factors, with which the largest number of each resource is 1 to 2
    agents: ids of the agents
    """

    def __init__(self, capacity: Vec, scale: Vec, agents: Sequence[int]) -> None:
        self.capacity = capacity
        self._scale = scale
        self.agents = list(agents)
        self._tables: dict[int, list[list[float]]] = {j: [] for j in agents}

    def add(self, fresh: Mapping[int, Sequence[Sequence[float]]]) -> bool:
        """Add the options of each agent; return True if there are any."""
        for j, rows in fresh.items():
            self._tables[j] += [list(row) for row in rows]
        return any(fresh.values())

    def relaxed(
        self, allowed: Mapping[int, Sequence[int] | None]
    ) -> tuple[Vec, TeamChoice]:
        """Return the prices pi >= 0 (S,) and the weights of the cheapest mixture of options.

        The integers of the options may differ.

        allowed: indices of the options of each agent that may be used; None for all
        """
        highs, count = self._model(0, allowed)
        highs.run()
        if highs.getModelStatus() != highspy.HighsModelStatus.kOptimal:
            raise SolverError("options of all agents", highs.getModelStatus().name)
        solution = highs.getSolution()
        dual = np.array(solution.row_dual)[: len(self.capacity)] * self._scale
        weights = np.array(solution.col_value)[:count]
        return np.asarray(np.maximum(-dual, 0.0)), self._read(weights)

    def best(self, searcher: int, start: TeamChoice | None) -> list[Any] | None:
        """Return the best choice, or None if none was found.

        searcher: id of the agent that searches; it is the seed of the search
        start: a choice from which the search begins
        Returns [[excess, cost], searcher, mixture of each agent].
        """
        highs, count = self._model(searcher, {})
        first = highs.getNumCol()
        self._add_patterns(highs)
        patterns = np.arange(first, highs.getNumCol(), dtype=np.int32)
        integer = np.full(len(patterns), int(highspy.HighsVarType.kInteger), np.uint8)
        highs.changeColsIntegrality(len(patterns), patterns, integer)
        highs.setOptionValue("mip_rel_gap", COMBINATION_LIMITS.relative_gap)
        highs.setOptionValue("mip_max_nodes", COMBINATION_LIMITS.most_nodes)
        if start is not None:
            weights = self._flatten(start)
            used = np.flatnonzero(weights).astype(np.int32)
            highs.setSolution(len(used), used, weights[used])
        highs.run()
        if highs.getInfo().primal_solution_status != int(
            highspy.SolutionStatus.kSolutionStatusFeasible
        ):
            return None
        weights = np.array(highs.getSolution().col_value)[:count]
        choice = self._read(self._keep_patterns(weights))
        return [[choice.excess, choice.cost], searcher, choice.mixtures]

    def value(self, mixtures: list[Mixture]) -> TeamChoice:
        """Return the choice of the given mixture of each agent, with its cost and what is left."""
        rows = [
            [weight * number for number in table[o][1:]]
            for table, mixture in zip(self._tables.values(), mixtures, strict=True)
            for o, weight in mixture
        ]
        left = self.capacity - sum_columns(row[1:] for row in rows)
        cost = math.fsum(row[0] for row in rows)
        excess = math.fsum(np.maximum(-left * self._scale, 0.0))
        return TeamChoice(mixtures, cost, left, excess)

    def _keep_patterns(self, weights: Vec) -> Vec:
        """Return the weights of all options without those of other patterns than each agent's heaviest."""
        kept = weights.copy()
        at = 0
        for table in self._tables.values():
            patterns = np.array([row[0] for row in table], int)
            own = kept[at : at + len(table)]
            heaviest = np.argmax(np.bincount(patterns, own))
            own[patterns != heaviest] = 0.0
            at += len(table)
        return kept

    def _read(self, weights: Vec) -> TeamChoice:
        """Return the choice with the given weights of all options."""
        mixtures = []
        at = 0
        for table in self._tables.values():
            own = weights[at : at + len(table)]
            at += len(table)
            used = np.flatnonzero(own > COMBINATION_LIMITS.least_weight)
            total = math.fsum(own[used])
            mixtures.append([[int(o), float(own[o] / total)] for o in used])
        return self.value(mixtures)

    def _flatten(self, choice: TeamChoice) -> Vec:
        """Return the weights of all options."""
        weights = np.zeros(sum(map(len, self._tables.values())))
        at = 0
        for table, mixture in zip(self._tables.values(), choice.mixtures, strict=True):
            for o, weight in mixture:
                weights[at + o] = weight
            at += len(table)
        return weights

    def _model(
        self, seed: int, allowed: Mapping[int, Sequence[int] | None]
    ) -> tuple[highspy.Highs, int]:
        """Return the model without patterns, and the number of options.

        Its columns are the options, then v. Options that are not allowed are 0.
        """
        highs = make_quiet_highs(seed)
        demand_tolerance(highs, LOCAL_TOLERANCE)
        S = len(self.capacity)
        none = np.array([], np.int32)
        for most in self.capacity * self._scale:
            highs.addRow(-highspy.kHighsInf, float(most), 0, none, none)
        for _ in self.agents:
            highs.addRow(1.0, 1.0, 0, none, none)
        costs = []
        for i, (agent, table) in enumerate(self._tables.items()):
            usable = allowed.get(agent)
            for o, (_, cost, *use) in enumerate(table):
                at = np.array([*range(S), S + i], np.int32)
                most = highspy.kHighsInf if usable is None or o in usable else 0.0
                column = np.array([*(use * self._scale), 1.0])
                highs.addCol(cost, 0.0, most, S + 1, at, column)
                costs.append(abs(cost))
        large = 1.0 + COMBINATION_LIMITS.excess_cost * math.fsum(costs)
        for s in range(S):
            highs.addCol(
                large, 0.0, highspy.kHighsInf, 1, np.array([s], np.int32), -np.ones(1)
            )
        return highs, len(costs)

    def _add_patterns(self, highs: highspy.Highs) -> None:
        """Add a column of 0 or 1 for each pattern that has options: their weights add up to it."""
        column = 0
        for table in self._tables.values():
            of_pattern: dict[float, list[int]] = {}
            for pattern, *_ in table:
                of_pattern.setdefault(pattern, []).append(column)
                column += 1
            for members in of_pattern.values():
                row = np.array([highs.getNumRow()], np.int32)
                at = np.array(members, np.int32)
                highs.addRow(0.0, 0.0, len(at), at, np.ones(len(at)))
                highs.addCol(0.0, 0.0, 1.0, 1, row, -np.ones(1))


def sum_columns(rows: Iterable[Sequence[float] | Vec]) -> Vec:
    """Return the exact sum of each column, rounded once, so that all agents get the same bits."""
    return np.array(
        [math.fsum(column) for column in np.array(list(rows), dtype=float).T]
    )
