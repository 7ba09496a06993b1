"""Prediction and correction: the team tracks the optimum of costs that change in time."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from crazychoir.errors import ConfigError
from crazychoir.optimization.problems.gradient import CheckedFunction
from crazychoir.optimization.rounds.blocks import require_vector
from crazychoir.optimization.rounds.iteration import Iteration, copy_state
from crazychoir.optimization.rounds.messages import check_array, require_heard
from crazychoir.optimization.rounds.step_size import GrowthWatch, step_size
from crazychoir.types import Vec

AtTime = Callable[[Vec, float], ArrayLike]
SMALL_ENOUGH_STEP = "below 2 / (L + 2 c d), with L-smooth f_i, d the largest degree"
"""Steps with which a correction converges, for error texts."""


@dataclass(frozen=True)
class MovingCost:
    """An agent's part of  min F(y; t) = sum_i f_i(y_i; t) + c/2 sum_{edges {i,j}} |y_i - y_j|^2.

    Every agent has its own y_i. A large c brings them together.
    """

    gradient: AtTime
    """grad f_i(y; t), (n,)."""
    hessian: AtTime
    """(n, n) Hessian of f_i at (y; t), positive definite."""
    coupling: float
    """c, above 0, the same at all agents."""
    rate: AtTime | None = None
    """(n,) partial derivative of grad f_i with respect to t, in 1/s.

    None for the backward difference (grad f_i(y; t_k) - grad f_i(y; t_k-1)) / h.
    """


@dataclass(frozen=True)
class Sampling:
    """How often the team samples its costs, and what it does in between; the same at all agents."""

    period: float
    """h, s between two samples, above 0."""
    corrections: int = 1
    """C, rounds of correction at each sample, 1 or more."""
    predictions: int | None = 3
    """K, rounds of prediction after them, 0 or more; None for no prediction."""

    def __post_init__(self) -> None:
        if not self.period > 0.0:
            raise ConfigError("Sampling: period", self.period, "above 0 s")
        if self.corrections < 1:
            raise ConfigError("Sampling: corrections", self.corrections, "1 or more")
        if self.predictions is not None and self.predictions < 0:
            allowed = "0 or more rounds; None for no prediction"
            raise ConfigError("Sampling: predictions", self.predictions, allowed)

    @property
    def rounds(self) -> int:
        """Rounds from one sample to the next."""
        return self.corrections + (self.predictions or 0)


class PredictionCorrection(Iteration):
    """Track the minimiser of a `MovingCost` at the samples t_k = k h, in C + K rounds a sample.

    Correction by the gradient of F at t_k, C times, from the predicted y_i:

        y_i <- y_i - a (grad f_i(y_i; t_k) + c sum_{j in N_i} (y_i - y_j)),   then x_i <- y_i

    Prediction of the next sample from the optimality conditions, with K rounds of the splitting
    D - B of the Hessian of F:

        p_i <- -D_i^-1 r_i,                             r_i = d/dt grad f_i(x_i; t_k)
        p_i <- D_i^-1 (c sum_{j in N_i} p_j - r_i),     D_i = Hess f_i(x_i; t_k) + c |N_i| I
        y_i <- x_i + h p_i

    One message of y_i or p_i travels in each round. The graph is static and undirected.

    With F strongly convex, with bounded derivatives, and a < 2 / (L + 2 c d), d the largest degree,
    the tracking error settles: at the order of h without prediction, and at the order of
    h^2 + s^(K+1) h with it, where s < 1 is the largest c |N_i| / (m + c |N_i|) for m-strongly convex
    f_i. So prediction pays where h is small against the motion, and K is large enough for c.
    Lost messages change no iterate: they delay rounds. If the cost follows a clock, h must leave
    time for C + K rounds with their resends.

    agent: id of the agent
    x: (n,) start
    neighbors: N_i, ids of the neighbours, in increasing order
    cost: f_i and c
    step: a, the same at all agents
    sampling: h, C and K
    samples: number of samples until done; None for no end
    y: (n,) the point that the next correction starts from
    Raises ConfigError that names the step if x grows without end.
    Source: Simonetto, Koppel, Mokhtari, Leus & Ribeiro 2017, "Decentralized prediction-correction
    methods for networked time-varying convex optimization", IEEE Trans. Autom. Control 62(11),
    5724-5738: DPC-G, and DAPC-G with the backward difference.
    """

    connected = True
    undirected = True
    common = False
    same = ("coupling", "period", "corrections", "predictions", "step_size")

    def __init__(
        self,
        agent: int,
        x: ArrayLike,
        neighbors: tuple[int, ...],
        cost: MovingCost,
        step: float,
        sampling: Sampling,
        samples: int | None = None,
    ) -> None:
        super().__init__(agent, None if samples is None else samples * sampling.rounds)
        if not cost.coupling > 0.0:
            raise ConfigError(f"agent {agent}: coupling", cost.coupling, "above 0")
        self.x = require_vector(agent, copy_state(f"agent {agent}: x", x))
        self.y = self.x
        self.neighbors = tuple(neighbors)
        self.coupling = cost.coupling
        self.period = sampling.period
        self.corrections = sampling.corrections
        self.predictions = -1 if sampling.predictions is None else sampling.predictions
        self.step_size = step_size(step)
        self._rounds = sampling.rounds
        self._gradient = CheckedFunction(agent, "gradient", cost.gradient)
        self._hessian = CheckedFunction(agent, "hessian", cost.hessian)
        rate = self._backward_difference if cost.rate is None else cost.rate
        self._rate = CheckedFunction(agent, "rate", rate)
        self._watch = GrowthWatch(f"agent {agent}", self.step_size, SMALL_ENOUGH_STEP)
        self._p = np.zeros_like(self.x)
        self._r = np.zeros_like(self.x)
        self._D = np.eye(len(self.x))

    @property
    def sample(self) -> int:
        """The number k of the sample that is being tracked."""
        return self.k // self._rounds

    @property
    def time(self) -> float:
        """t_k, in s."""
        return self.sample * self.period

    def message(self) -> Vec:
        """Return y_i in a round of correction, p_i in a round of prediction."""
        return self.y if self.k % self._rounds < self.corrections else self._p

    def update(self, heard: Mapping[int, Any]) -> None:
        """Correct x, or improve the prediction."""
        require_heard(self.i, self.neighbors, heard)
        total = np.zeros_like(self.x)
        for j, theirs in heard.items():
            total += check_array(self.i, j, theirs, self.x)
        done = self.k % self._rounds + 1
        if done <= self.corrections:
            self._correct(total)
        else:
            self._p = self._solve(self.coupling * total - self._r)
        if done == self.corrections and self.predictions >= 0:
            self._begin_prediction()
        if done == self._rounds and self.predictions >= 0:
            self.y = self.x + self.period * self._p

    def _correct(self, total: Vec) -> None:
        """Move y along the gradient of F at t_k; total: (n,) sum of the y_j."""
        pull = self.coupling * (len(self.neighbors) * self.y - total)
        g = self._gradient(self.k, self.y, self.time) + pull
        self.y = self.y - self.step_size(self.k) * g
        self._watch(self.k, self.y)
        self.x = self.y

    def _begin_prediction(self) -> None:
        """Linearise the optimality conditions at x; start from the own part alone."""
        n = len(self.x)
        here = self._hessian(self.k, self.x, self.time, shape=(n, n))
        self._D = here + self.coupling * len(self.neighbors) * np.eye(n)
        self._r = self._rate(self.k, self.x, self.time)
        self._p = self._solve(-self._r)

    def _solve(self, right: Vec) -> Vec:
        """Return D_i^-1 right, (n,)."""
        return np.asarray(np.linalg.solve(self._D, right), dtype=np.float64)

    def _backward_difference(self, x: Vec, t: float) -> Vec:
        """Return the change of the gradient since the last sample; 0 in the first one."""
        if self.sample == 0:
            return np.zeros_like(x)
        before = self._gradient(self.k, x, t - self.period)
        change: Vec = (self._gradient(self.k, x, t) - before) / self.period
        return change
