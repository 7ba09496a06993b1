"""Primal decomposition: agents own shares of common resources and trade them.

Each agent names the prices that it would pay.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

from crazychoir.errors import ConfigError
from crazychoir.optimization.rounds.arrays import copy_vector
from crazychoir.optimization.rounds.average import RunningAverage
from crazychoir.optimization.rounds.mixing import Mixing, Row, Rows, mix
from crazychoir.optimization.rounds.step_size import StepSize, step_size
from crazychoir.types import Vec


@dataclass(frozen=True)
class AllocatedSolution:
    """The local solution at an allocation y."""

    value: float
    """p_i(y)."""
    x: Vec
    """(n,) the minimiser."""
    mu: Vec
    """(S,) >= 0, the prices of the resources: -mu is a subgradient of p_i."""
    violation: float
    """rho, the largest excess of x over y in one resource."""


@runtime_checkable
class LocalProgram(Protocol):
    """An agent's problem for a given allocation.

    Convexified is one, and Allocation for a convex problem.
    """

    def allocate(self, y: Vec) -> AllocatedSolution:
        """Return p_i(y) and its prices."""
        ...


class PrimalDecomposition(Mixing):
    """Agent i's part of  min sum_i f_i(x_i)  s.t.  sum_i g_i(x_i) <= sum_i b_i,  x_i in X_i.

        p_i(y) = min f_i(x) + M rho  s.t.  g_i(x) <= y + rho 1 : mu_i,   x in X_i,  rho >= 0
        y_i(0) = b_i,    y_i(k+1) = y_i(k) + a_k (mu_i - sum_j w_ij mu_j)

    mu_i (S,) are the prices at y_i(k), and only they travel. The weights w are doubly stochastic
    (Metropolis): so sum_i y_i stays sum_i b_i, and a dense graph needs no smaller step than a
    sparse one.
    If sum a_k is infinite and sum a_k^2 is finite, the method reaches the least sum_i p_i(y_i). It
    is the optimum of the problem if M exceeds the sum of the optimal prices. From the first round
    on, the x_i(k) are feasible together, but for rho.

    i: id of the agent
    weights: row i, doubly stochastic, or one row for each graph of a sequence
    local: the local problem, such as Convexified
    share: b_i (S,)
    step: a_k, the same at all agents
    rounds: number of rounds until done; None for no end
    x: (n,) at y_i(k)
    y: y_i (S,)
    mu: mu_i (S,)
    cost: p_i(y_i)
    violation: rho
    y_mean: (S,) average of y_i weighted by a_k
    Source: Silverman 1972; with neighbours' prices only Notarnicola & Notarstefano 2020, IEEE TCNS
    7(1), 483-492.
    """

    heavy = True
    common = False
    same = ("step_size",)

    def __init__(
        self,
        i: int,
        weights: Rows,
        local: LocalProgram,
        share: Vec,
        step: float | StepSize,
        rounds: int | None = None,
    ) -> None:
        super().__init__(i, weights, rounds)
        if not isinstance(local, LocalProgram):
            do = "Wrap it: Allocation(problem, penalty) of optimization/algorithms/allocation.py, or Convexified."
            raise ConfigError(
                f"agent {i}: local", type(local).__name__, "one with allocate(y)", do
            )
        self._local, self.step_size = local, step_size(step)
        self._mean = RunningAverage()
        self._set(copy_vector(share, f"agent {i}", "share"))

    def _set(self, y: Vec, weight: float = 1.0) -> None:
        found = self._local.allocate(y)
        self.y = y
        self.x = found.x
        self.mu = found.mu
        self.cost = found.value
        self.violation = found.violation
        self.y_mean = self._mean.add(y, weight)

    def payload(self) -> Vec:
        """Return the prices."""
        return self.mu

    def mix_in(self, row: Row, heard: Mapping[int, Any]) -> None:
        """Trade, then solve for the new allocation."""
        a = self.step_size(self.k)
        self._set(self.y + a * (self.mu - mix(self.i, row, self.mu, heard)), a)
