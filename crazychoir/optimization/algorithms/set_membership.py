"""Set membership: estimate a point that agrees with all measurements of a team."""

from collections.abc import Callable, Mapping

import numpy as np
from numpy.typing import ArrayLike

from crazychoir.errors import ConfigError
from crazychoir.optimization.algorithms.asynchronous_consensus import (
    AsynchronousConsensus,
)
from crazychoir.optimization.algorithms.consensus import Consensus
from crazychoir.optimization.problems.projection import ConvexSet, Intersection
from crazychoir.optimization.rounds.mixing import Row, Rows
from crazychoir.types import Vec

Measure = Callable[[], ConvexSet | None]


def measure_nothing() -> None:
    """Return no further measurement."""


class SetMembership(Consensus):
    """Set-membership estimation: agents agree on a point that all measurements of the team allow.

        X_i(k+1) = X_i(k) and M_i(k+1),   x_i <- P_{X_i(k+1)}(sum_j w_ij x_j)

    Sets stay with the agent, and only estimates travel. There is no step size.

    i: id of the agent
    x: (n,) the first estimate
    weights: row i, or one row for each graph of a sequence. If the columns sum to one as well, the
        method also converges on changing graphs
    first: the sets that are known at the start
    measure: called in each round; returns the set M_i that a new measurement allows (Box, Strip,
        Disc, Convex), or None
    rounds: number of rounds until done; None for no end
    Raises SolverError that names the agent if its sets have no point in common.
    Source: Farina, Garulli & Giannitrapani 2019, "Distributed interpolatory algorithms for set
    membership estimation", IEEE Trans. Autom. Control 64(9); projections: Nedic, Ozdaglar & Parrilo
    2010, IEEE Trans. Autom. Control 55(4).
    """

    def __init__(
        self,
        i: int,
        x: ArrayLike,
        weights: Rows,
        first: tuple[ConvexSet, ...],
        measure: Measure = measure_nothing,
        rounds: int | None = None,
    ) -> None:
        super().__init__(i, x, weights, rounds)
        self.possible = possible(i, self.x, first)
        self.measure = measure

    def mix_in(self, row: Row, heard: Mapping[int, Vec]) -> None:
        """Measure, average, project."""
        super().mix_in(row, heard)
        self.x = within(self.possible, self.measure, self.x)


class AsynchronousSetMembership(AsynchronousConsensus):
    """SetMembership for agents that wake at different times.

    They use the latest message of each neighbour.

    weights: row i, no entry negative
    The other arguments are those of SetMembership.
    """

    def __init__(
        self,
        i: int,
        x: ArrayLike,
        weights: Row,
        first: tuple[ConvexSet, ...],
        measure: Measure = measure_nothing,
        rounds: int | None = None,
    ) -> None:
        super().__init__(i, x, weights, rounds)
        self.possible = possible(i, self.x, first)
        self.measure = measure

    def update(self, heard: Mapping[int, Vec]) -> None:
        """Measure, average, project."""
        super().update(heard)
        self.x = within(self.possible, self.measure, self.x)


def possible(i: int, x: Vec, first: tuple[ConvexSet, ...]) -> Intersection:
    """Return the set of points that agent i allows at the start."""
    if x.ndim != 1:
        raise ConfigError(f"agent {i}: x", f"shape {x.shape}", "a vector")
    return Intersection(len(x), first, f"agent {i}: measurements")


def within(known: Intersection, measure: Measure, x: Vec) -> Vec:
    """Take a new measurement, then return the nearest point that all measurements allow."""
    new = measure()
    if new is not None:
        known.add(new)
    return np.array(known.project(x))
