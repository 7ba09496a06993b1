"""EXTRA, an exact first-order algorithm for a common variable."""

from numpy.typing import ArrayLike

from crazychoir.optimization.algorithms.exact_gradient.pg_extra import PGEXTRA
from crazychoir.optimization.problems.composite import CompositeCost
from crazychoir.optimization.problems.gradient import Gradient
from crazychoir.optimization.rounds.mixing import Rows


class EXTRA(PGEXTRA):
    """EXTRA for  min sum_i f_i(x),  f_i convex and L-smooth.

        x_i(1) = sum_j w_ij x_j(0) - a grad f_i(x_i(0))
        x_i(k+1) = x_i(k) + sum_j w_ij x_j(k) - sum_j v_ij x_j(k-1)
                   - a [grad f_i(x_i(k)) - grad f_i(x_i(k-1))],   V = (I + W) / 2

    It is PG-EXTRA with r_i = 0. One message of x_i travels in each round.

    i: id of the agent
    x: x_i(0), any shape, the same shape at all agents
    weights: row i of W, symmetric and doubly stochastic, of a static graph
    gradient: grad f_i
    step: a, the same at all agents. The iterates converge to an optimum for
        a < 2 v / L = (1 + w) / L, with v and w the smallest eigenvalues of V and W
    rounds: number of rounds until done; None for no end
    Raises ConfigError that names the step if it is so large that x grows without end.
    Source: Shi, Ling, Wu & Yin 2015, SIAM J. Optim. 25(2), 944-966, "EXTRA: an exact first-order
    algorithm for decentralized consensus optimization".
    """

    def __init__(
        self,
        i: int,
        x: ArrayLike,
        weights: Rows,
        gradient: Gradient,
        step: float,
        rounds: int | None = None,
    ) -> None:
        super().__init__(i, x, weights, CompositeCost(gradient), step, rounds)
