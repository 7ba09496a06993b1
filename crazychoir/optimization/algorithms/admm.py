"""The alternating direction method of multipliers for a common variable."""

from collections.abc import Iterable, Mapping

import numpy as np

from crazychoir.errors import ConfigError
from crazychoir.optimization.problems.problems import CostCoupled, require_problem
from crazychoir.optimization.rounds.arrays import is_number
from crazychoir.optimization.rounds.iteration import Iteration
from crazychoir.optimization.rounds.messages import check_array, require_heard
from crazychoir.types import Vec


class ADMM(Iteration):
    """Consensus ADMM for  min sum_i f_i(x_i)  s.t.  x_i in X_i,  x_i = z_j  for all j in M_i.

    M_i is the set of the neighbours N_i and i itself.

        x_i = argmin_{x in X_i} f_i(x) + x'L_i + rho/2 sum_{j in M_i} |x - z_j|^2      (x_i travels)
        z_i = mean_{j in M_i} x_j                                                     (z_i travels)
        L_i <- L_i + rho sum_{j in M_i} (x_i - z_j),   L_i(0) = 0

    L_i = sum_{j in M_i} l_ij, with l_ij the multiplier of x_i = z_j. The multipliers of z_i,
    sum_j l_ji, add up to zero, so that no multiplier travels. An iteration is two rounds.
    The graph is static and undirected. There is no step size: the method converges for each penalty
    rho > 0 and convex f_i. A large rho first brings the x_i together. A small rho first brings each
    x_i to its own minimum.

    problem: f_i and X_i
    neighbors: N_i
    penalty: rho, the same at all agents
    iterations: number of iterations until done; None for no end
    x: (n,) of the last iteration, 0 before the first
    z: (n,) of the last iteration, 0 before the first
    Raises SolverError if the local problem is infeasible.
    Raises ConfigError if the agents that are heard are not exactly N_i.
    Source: Boyd, Parikh, Chu, Peleato & Eckstein 2011, Foundations and Trends in Machine Learning
    3(1), section 7.2.
    """

    connected = True
    undirected = True
    same = ("penalty",)

    def __init__(
        self,
        problem: CostCoupled,
        neighbors: Iterable[int],
        penalty: float,
        iterations: int | None = None,
    ) -> None:
        require_problem(problem, CostCoupled, "ADMM")
        super().__init__(problem.agent, None if iterations is None else 2 * iterations)
        if not is_number(penalty) or not 0.0 < penalty < np.inf:
            raise ConfigError(
                f"agent {self.i}: penalty", f"{penalty}", "a finite number above 0"
            )
        self.problem = problem
        self.neighbors = tuple(sorted(neighbors))
        self.penalty = penalty
        self._members = 1 + len(self.neighbors)
        self.heavy = not problem.is_fast(penalty * self._members)
        self.x = np.zeros(problem.n)
        self.z = np.zeros(problem.n)
        self._L = np.zeros(problem.n)

    @property
    def iterations(self) -> int:
        """Number of iterations done."""
        return self.k // 2

    def message(self) -> Vec:
        """Return x_i in even rounds and z_i in odd rounds."""
        if self.k == 0:
            self._minimise(self.z)
        return self.z if self.k % 2 else self.x

    def update(self, heard: Mapping[int, Vec]) -> None:
        """Compute z in even rounds; in odd rounds compute L, and x for the next iteration."""
        require_heard(self.i, self.neighbors, heard)
        own = self.z if self.k % 2 else self.x
        total = sum(
            (check_array(self.i, j, x, own) for j, x in heard.items()), start=own
        )
        if self.k % 2 == 0:
            self.z = total / self._members
            return
        self._L += self.penalty * (self._members * self.x - total)
        self._minimise(total / self._members)

    def _minimise(self, centre: Vec) -> None:
        """Compute x.

        centre: mean of the z_j; the terms |x - z_j|^2 add up to |M_i| |x - centre|^2 and a constant
        """
        self.x = self.problem.argmin(self._L, centre, self.penalty * self._members)
