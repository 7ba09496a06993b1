"""Relaxed ADMM for a common variable: lost messages may stay lost."""

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from crazychoir.errors import ConfigError
from crazychoir.optimization.problems.problems import CostCoupled, require_problem
from crazychoir.optimization.rounds.arrays import is_number
from crazychoir.optimization.rounds.iteration import Iteration
from crazychoir.optimization.rounds.messages import (
    INTEGER_TYPES,
    check_array,
    check_parts,
)
from crazychoir.types import PerNeighbor


class RelaxedADMM(Iteration):
    """Relaxed ADMM for  min sum_i f_i(x_i)  s.t.  x_i in X_i,  x_i = x_j  for all j in N_i.

        x_i = argmin_{x in X_i} f_i(x) - x'sum_{j in N_i} z_ij + rho |N_i| / 2 |x|^2
        q_ij = 2 rho x_i - z_ij                                        (q_ij travels from i to j)
        z_ji <- (1 - a) z_ji + a q_ij   when q_ij arrives at j,   z_ij(0) = 0

    Agent i holds z_ij for each neighbour j. Where a message is lost, the entry stays as it is. The
    agents wake by themselves, and nothing is sent twice: each message has a number, so that no agent
    takes one twice. The graph is static and undirected.

    problem: f_i and X_i, convex
    neighbors: N_i
    penalty: rho > 0, the same at all agents
    relaxation: a, above 0, below 1, the same at all agents. With independent losses of any share
        below 1 the x_i converge to an optimum, almost surely, for each rho. Losses make it slower,
        about as 1 / (1 - loss)
    rounds: number of steps until done; None for no end
    x: (n,) of the last step, 0 before the first
    Raises SolverError if the local problem is infeasible.
    Source: Bastianello, Carli, Schenato & Todescato 2021, IEEE Trans. Autom. Control 66(6),
    2620-2635, "Asynchronous distributed optimization over lossy networks via relaxed ADMM:
    stability and linear convergence".
    """

    asynchronous = True
    connected = True
    undirected = True
    same = ("penalty", "relaxation")

    def __init__(
        self,
        problem: CostCoupled,
        neighbors: Iterable[int],
        penalty: float,
        relaxation: float = 0.5,
        rounds: int | None = None,
    ) -> None:
        require_problem(problem, CostCoupled, "RelaxedADMM")
        super().__init__(problem.agent, rounds)
        for name, value, most in (
            ("penalty", penalty, np.inf),
            ("relaxation", relaxation, 1.0),
        ):
            if not is_number(value) or not 0.0 < value < most:
                raise ConfigError(
                    f"agent {self.i}: {name}", f"{value}", f"above 0, below {most:g}"
                )
        self.problem = problem
        self.neighbors = tuple(sorted(neighbors))
        self.penalty = penalty
        self.relaxation = relaxation
        self.x = np.zeros(problem.n)
        self._stiffness = penalty * len(self.neighbors)
        self.heavy = not problem.is_fast(self._stiffness)
        self._z = {j: np.zeros(problem.n) for j in self.neighbors}
        self._last = dict.fromkeys(self.neighbors, -1)
        self._is_outdated = True

    def message(self) -> PerNeighbor:
        """Return [number of the message, q_ij] for each j."""
        self._minimise()
        return PerNeighbor(
            {j: [self.k, 2.0 * self.penalty * self.x - z] for j, z in self._z.items()}
        )

    def update(self, heard: Mapping[int, Any]) -> None:
        """Take the messages that are new, then minimise."""
        check_parts(self.i, self.k, heard, INTEGER_TYPES, object)
        for j, (number, q) in heard.items():
            if j not in self._z:
                raise ConfigError(
                    f"agent {self.i}: message of agent {j}",
                    f"agent {j}",
                    f"its neighbors {list(self.neighbors)}",
                )
            if number > self._last[j]:
                self._last[j] = number
                self._relax(j, check_array(self.i, j, q, self.x))
        self._minimise()

    def _relax(self, j: int, q: Any) -> None:
        self._z[j] = (1.0 - self.relaxation) * self._z[j] + self.relaxation * q
        self._is_outdated = True

    def _minimise(self) -> None:
        """Compute x_i, if a z_ij has changed since the last time."""
        if not self._is_outdated:
            return
        pull = -sum(self._z.values(), start=np.zeros(self.problem.n))
        self.x = self.problem.argmin(pull, penalty=self._stiffness)
        self._is_outdated = False
