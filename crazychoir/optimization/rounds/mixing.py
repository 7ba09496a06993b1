"""Averaging with neighbours: rows of weights, their checks, and the base class of such algorithms.

A row is {j: w_ij} of agent i itself and the agents that it hears. On a graph that changes with
the round there is one row for each graph of the sequence, used in turn.
"""

import math
from abc import abstractmethod
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Final, TypeVar

from crazychoir.errors import ConfigError
from crazychoir.numerics.kernels import kernel, memory, real, vector
from crazychoir.optimization.rounds.iteration import Iteration
from crazychoir.optimization.rounds.messages import (
    REAL_NUMBER_TYPES,
    check_array,
    check_parts,
)
from crazychoir.team.graph import Graph, GraphSequence, Weights, metropolis
from crazychoir.types import PerNeighbor, Vec

T = TypeVar("T")
Row = Mapping[int, float]
Rows = Row | Sequence[Row]
WEIGHT_SUM_TOLERANCE: Final = 1e-9
"""Error that is allowed in the sum of weights."""


def check_rows(i: int, weights: Rows, what: str = "weights") -> tuple[Row, ...]:
    """Return the rows of agent i: one for each graph of the sequence.

    weights: one row, or a sequence of rows
    Raises ConfigError unless each row has finite weights that sum to one.
    """
    rows = (weights,) if isinstance(weights, Mapping) else tuple(weights)
    if not rows:
        raise ConfigError(
            f"agent {i}: {what}", "none", "{j: weight}, of itself and those it hears"
        )
    for row in rows:
        _check_row(i, row, what)
    return tuple({j: float(row[j]) for j in sorted(row)} for row in rows)


def _check_row(i: int, row: Row, what: str) -> None:
    for j, weight in row.items():
        if not math.isfinite(weight):
            raise ConfigError(f"agent {i}: {what}[{j}]", f"{weight}", "finite numbers")
    if i not in row:
        raise ConfigError(
            f"agent {i}: {what}",
            f"weights of {sorted(row)}",
            f"one of agent {i} itself too",
        )
    total = math.fsum(row.values())
    if abs(total - 1.0) > WEIGHT_SUM_TOLERANCE:
        do = "Take those of crazychoir.team.graph: metropolis, row_stochastic, column_stochastic."
        raise ConfigError(
            f"agent {i}: {what}",
            dict(row),
            "weights that sum to one",
            do,
            f"they sum to {total:.9g}",
        )


@kernel(memory, real, vector)
def _add_weighted(total: Vec, weight: float, x: Vec) -> bool:
    """Add weight x to total, in place; return False if their lengths differ."""
    if len(x) != len(total):
        return False
    for n in range(len(x)):
        total[n] += weight * x[n]
    return True


def mix(i: int, row: Row, own: Vec, heard: Mapping[int, Vec]) -> Vec:
    """Return sum_j w_ij x_j over agent i itself and the agents it hears.

    Raises ConfigError that names the agents that the row does not fit.
    """
    if len(heard) + 1 != len(row):
        require_heard(i, row, heard)
    mixed = row[i] * own
    total = mixed if own.ndim == 1 else mixed.reshape(-1)
    for j, x in heard.items():
        if j not in row:
            require_heard(i, row, heard)
        try:
            fits = _add_weighted(
                total,
                row[j],
                x if own.ndim == 1 else check_array(i, j, x, own).reshape(-1),
            )
        except TypeError:  # not a vector of floats
            fits = False
        if not fits:
            allowed = f"floats of shape {own.shape}, as its own"
            raise ConfigError(
                f"agent {i}: message of agent {j}", describe_shape(x), allowed
            )
    return mixed


def describe_shape(x: Any) -> str:
    """Describe the shape of x for an error text, and its type if it does not hold floats."""
    if not hasattr(x, "shape"):
        return type(x).__name__
    return (
        f"shape {x.shape}" if x.dtype == "float64" else f"shape {x.shape} of {x.dtype}"
    )


def require_heard(i: int, row: Row, heard: Mapping[int, Any]) -> None:
    """Raise ConfigError unless the row has weights for exactly agent i and the agents heard."""
    wanted = sorted(j for j in row if j != i)
    if wanted != sorted(heard):
        do = "Make the weights from the graph that the team runs on."
        raise ConfigError(
            f"agent {i}: weights",
            f"of {wanted}",
            f"of the agents it hears, {sorted(heard)}",
            do,
        )


class Mixing(Iteration):
    """An algorithm that averages with its neighbours; a subclass writes `payload` and `mix_in`.

    Each agent checks at construction that its row sums to one.
    With `doubly_stochastic` the graph must be undirected. In the first round of each row, w_ij
    travels from i to j with the message, and each agent checks that its column sums to one. Wrong
    weights end the algorithm at all agents, with an error that names the column.
    """

    connected = True
    doubly_stochastic = True

    @property
    def undirected(self) -> bool:
        """True if two neighbours must hear each other."""
        return self.doubly_stochastic

    def __init__(self, i: int, weights: Rows, rounds: int | None) -> None:
        super().__init__(i, rounds)
        self.weights = check_rows(i, weights)

    @property
    def row(self) -> Row:
        """The weights of this round."""
        return self.weights[self.k % len(self.weights)]

    @abstractmethod
    def payload(self) -> Any:
        """Return the content of this round's message. `message` adds the weights."""

    @abstractmethod
    def mix_in(self, row: Row, heard: Mapping[int, Any]) -> None:
        """Update the agent in round k.

        row: its weights w_ij
        heard: payload of each neighbour
        """

    def message(self) -> Any:
        """Return the payload; in the first round of a row, send [w_ij, payload] to each j."""
        payload = self.payload()
        if self.k >= len(self.weights) or not self.doubly_stochastic:
            return payload
        return PerNeighbor(
            {j: [w, payload] for j, w in self.row.items() if j != self.i}
        )

    def update(self, heard: Mapping[int, Any]) -> None:
        """Check the column of a new row, then mix."""
        row = self.row
        if self.k < len(self.weights) and self.doubly_stochastic:
            require_heard(self.i, row, heard)
            check_parts(self.i, self.k, heard, REAL_NUMBER_TYPES, object)
            self._check_column(
                math.fsum([row[self.i], *(w for w, _ in heard.values())])
            )
            heard = {j: payload for j, (_, payload) in heard.items()}
        self.mix_in(row, heard)

    def _check_column(self, total: float) -> None:
        if abs(total - 1.0) > WEIGHT_SUM_TOLERANCE:
            allowed = "columns that sum to one, too: doubly stochastic weights"
            do = "Take those of crazychoir.team.graph.metropolis."
            where = f"agent {self.i}: weights, column {self.i}, round {self.k}"
            raise ConfigError(where, f"sum {total:.9g}", allowed, do)


def rows(
    graph: Graph | GraphSequence, rule: Callable[[Graph], Weights] = metropolis
) -> dict[int, tuple[Row, ...]]:
    """Return the rows of each agent by a rule of graph.py, one for each graph of the sequence."""
    graphs = graph.graphs if isinstance(graph, GraphSequence) else (graph,)
    weights = [rule(each) for each in graphs]
    return {i: tuple(of[i] for of in weights) for i in graph.ids}


def columns(
    graph: Graph | GraphSequence, rule: Callable[[Graph], Weights]
) -> dict[int, tuple[Row, ...]]:
    """Return the columns {i: w_ij} of each agent j by a rule of graph.py.

    They say which share agent j gives to each agent that hears it, and which share it keeps.
    """
    graphs = graph.graphs if isinstance(graph, GraphSequence) else (graph,)
    weights = [rule(each) for each in graphs]
    return {
        j: tuple({i: row[j] for i, row in of.items() if j in row} for of in weights)
        for j in graph.ids
    }


def team(
    graph: Graph | GraphSequence,
    make: Callable[[int, tuple[Row, ...]], T],
    rule: Callable[[Graph], Weights] = metropolis,
) -> dict[int, T]:
    """Make one agent for each node of the graph.

    make: called with (i, weights); the weights are the rows of agent i
    rule: rule of graph.py that gives the weights
    """
    return {i: make(i, weights) for i, weights in rows(graph, rule).items()}
