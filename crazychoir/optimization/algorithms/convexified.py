"""The convex hull of an agent's mixed-integer set, by column generation.

Only the corners that matter at the prices are computed.
"""

from dataclasses import dataclass

import highspy
import numpy as np

from crazychoir.errors import SolverError
from crazychoir.optimization.algorithms.primal_decomposition import AllocatedSolution
from crazychoir.optimization.problems.linear import make_quiet_highs
from crazychoir.optimization.problems.mixed_integer import (
    MixedIntegerBlock,
    require_block,
)
from crazychoir.types import Vec


@dataclass(frozen=True, slots=True)
class CornerGeneration:
    """When column generation over the corners of conv(X_i) ends, and which corners are in use."""

    relative_gap: float = 1e-9
    """Relative gap of the value at which column generation ends."""
    most_corners: int = 10_000
    """Largest number of corners in one solve."""
    least_weight: float = 1e-7
    """A weight above this is not zero."""


CORNER_GENERATION = CornerGeneration()


class Convexified:
    """The local problem of primal decomposition over conv(X_i).

        p_i(y) = min  c'x + M rho   s.t.  A x <= y + rho 1 : mu,   x in conv(X_i),   rho >= 0
               = min  sum_k l_k c'v_k + M rho   s.t.  sum_k l_k A v_k <= y + rho 1,
                 sum_k l_k = 1,   l >= 0

    v_k are the corners of conv(X_i). The prices tell which corners matter:
    v = argmin (c + A'mu)'v over X_i, a small mixed-integer program. From one y to the next the
    corners are kept, and the master program starts from its last solution.

    block: the agent's part of the program
    penalty: M, larger than the sum of the prices on which the team will agree
    active: (K, n), the corners with a weight at the last y, K <= S + 1
    Source: Camisa, Notarnicola & Notarstefano 2022, IEEE TAC 67(1), 413-420 (arXiv 2010.14446),
    problem (7) there; Dantzig & Wolfe 1960.
    """

    def __init__(self, block: MixedIntegerBlock, penalty: float) -> None:
        require_block(block, "Convexified")
        self._block = block
        self._corners = np.zeros((0, block.n))
        self.active = np.zeros((0, block.n))
        S = block.S
        none = np.array([], np.int32)
        self._highs = make_quiet_highs()
        for _ in range(S):
            self._highs.addRow(-highspy.kHighsInf, 0.0, 0, none, none)
        self._highs.addRow(1.0, 1.0, 0, none, none)
        rows = np.arange(S, dtype=np.int32)
        self._highs.addCol(penalty, 0.0, highspy.kHighsInf, S, rows, -block.scale)
        self._add(block.corner(block.c))

    def allocate(self, y: Vec) -> AllocatedSolution:
        """Return p_i(y) and its prices.

        y: (S,)
        """
        for s, most in enumerate(y * self._block.scale):
            self._highs.changeRowBounds(s, -highspy.kHighsInf, float(most))
        block = self._block
        for _ in range(CORNER_GENERATION.most_corners):
            value, weights, dual = self._master()
            mu = np.maximum(-dual[:-1], 0.0) * block.scale
            priced = block.c + mu @ block.A
            corner = block.corner(priced)
            if float(priced @ corner) >= float(
                dual[-1]
            ) - CORNER_GENERATION.relative_gap * (1.0 + abs(value)) or self._known(
                corner
            ):
                self.active = self._corners[
                    weights[1:] > CORNER_GENERATION.least_weight
                ]
                return AllocatedSolution(
                    value, weights[1:] @ self._corners, mu, float(weights[0])
                )
            self._add(corner)
        raise SolverError(
            f"{block.where}: local problem",
            f"{CORNER_GENERATION.most_corners} corners without an end",
        )

    def _known(self, corner: Vec) -> bool:
        """Return True if the corner is there already.

        If such a corner still seems to gain, the gain is within the tolerance of HiGHS.
        """
        return bool(
            (
                np.abs(self._corners - corner)
                <= CORNER_GENERATION.relative_gap * (1.0 + np.abs(corner))
            )
            .all(axis=1)
            .any()
        )

    def _add(self, corner: Vec) -> None:
        block = self._block
        self._corners = np.vstack([self._corners, corner])
        column = np.concatenate([block.scale * (block.A @ corner), [1.0]])
        rows = np.arange(len(column), dtype=np.int32)
        self._highs.addCol(
            float(block.c @ corner), 0.0, highspy.kHighsInf, len(column), rows, column
        )

    def _master(self) -> tuple[float, Vec, Vec]:
        self._highs.run()
        status = self._highs.getModelStatus()
        if status != highspy.HighsModelStatus.kOptimal:
            raise SolverError(f"{self._block.where}: local problem", status.name)
        solution = self._highs.getSolution()
        return (
            self._highs.getObjectiveValue(),
            np.array(solution.col_value),
            np.array(solution.row_dual),
        )
