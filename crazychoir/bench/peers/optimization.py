"""The problems of `bench optimization` for both programs: consensus, and dual decomposition.

Dual decomposition uses the same local solver in both.
"""

import importlib
from typing import TYPE_CHECKING, Any

import numpy as np

from crazychoir.team.graph import Graph, metropolis
from crazychoir.types import Mat, Vec

if TYPE_CHECKING:
    from crazychoir.optimization.problems.problems import CostCoupled

VARIABLE_SIZE = 3
"""Number of entries of x."""
DUAL_STEP_SIZE = 0.05
"""Step size of dual decomposition."""


def start(i: int) -> Vec:
    """Return the initial x of agent i for consensus."""
    return np.random.default_rng(i).normal(size=VARIABLE_SIZE)


def weights(neighbors: dict[int, tuple[int, ...]], i: int) -> dict[int, float]:
    """Return row i of the Metropolis weights."""
    return metropolis(Graph.from_neighbors(neighbors))[i]


def problem(i: int) -> "CostCoupled":
    """Return f_i(x) = x'Q_i x / 2 + c_i'x over a box, Q_i positive definite."""
    from crazychoir.optimization.problems.problems import CostCoupled

    # The problem is modelled as users do. The import takes 1 s, which consensus does not need.
    cp = importlib.import_module("cvxpy")
    draw = np.random.default_rng(i)
    half: Mat = draw.normal(size=(VARIABLE_SIZE, VARIABLE_SIZE))
    x = cp.Variable(VARIABLE_SIZE)
    cost = (
        0.5 * cp.quad_form(x, half @ half.T + np.eye(VARIABLE_SIZE))
        + draw.normal(size=VARIABLE_SIZE) @ x
    )
    return CostCoupled(i, x, cost, [x >= -10.0, x <= 10.0])


def algorithm(name: str, neighbors: dict[int, tuple[int, ...]], i: int) -> Any:
    """Return agent i of our program."""
    if name == "consensus":
        from crazychoir.optimization.algorithms.consensus import Consensus

        return Consensus(i, start(i), weights(neighbors, i))
    from crazychoir.optimization.algorithms.dual_decomposition import DualDecomposition

    return DualDecomposition(problem(i), DUAL_STEP_SIZE)
