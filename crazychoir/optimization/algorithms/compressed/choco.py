"""CHOCO: averaging and stochastic gradients with compressed messages and error feedback."""

from abc import abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from crazychoir.errors import ConfigError
from crazychoir.optimization.algorithms.compressed.compressors import Compressor
from crazychoir.optimization.problems.gradient import CheckedFunction, Gradient
from crazychoir.optimization.rounds.blocks import require_vector
from crazychoir.optimization.rounds.iteration import copy_state
from crazychoir.optimization.rounds.messages import build_malformed_error
from crazychoir.optimization.rounds.mixing import Mixing, Row, Rows, require_heard
from crazychoir.optimization.rounds.step_size import (
    GrowthWatch,
    StepSize,
    step_size,
)
from crazychoir.team.graph import Weights
from crazychoir.types import Vec

SMALL_ENOUGH_GAMMA = "gamma at most choco_gamma(weights, compressor.omega(n))"
"""Consensus steps with which CHOCO converges, for error texts."""
SMALL_ENOUGH_STEP = "well below 1 / L, with L-smooth f_i; a smaller gamma, too"
"""Steps with which CHOCO-SGD stays near the optimum, for error texts."""


def choco_gamma(weights: Weights, omega: float) -> float:
    """Return a consensus step with which CHOCO converges linearly.

        gamma = d^2 w / (16 d + d^2 + 4 b^2 + 2 d b^2 - 8 d w),   b = |I - W|_2,  d = 1 - |l_2(W)|

    l_2 is the eigenvalue of the second largest magnitude. The step is careful: many times as large a
    step often converges too, and faster.

    weights: all rows, symmetric and doubly stochastic, such as metropolis(graph)
    omega: w, quality of the compressor, above 0 and at most 1
    Source: Koloskova, Stich & Jaggi 2019, ICML, PMLR 97, theorem of CHOCO-Gossip.
    """
    if not 0.0 < omega <= 1.0:
        do = "Take more bits or more entries."
        raise ConfigError("choco_gamma: omega", omega, "above 0, at most 1", do)
    ids = sorted(weights)
    W = np.array([[weights[i].get(j, 0.0) for j in ids] for i in ids])
    values = np.linalg.eigvalsh(W)
    d = 1.0 - float(np.sort(np.abs(values))[-2]) if len(ids) > 1 else 1.0
    b2 = (1.0 - float(values[0])) ** 2
    below = 16.0 * d + d**2 + 4.0 * b2 + 2.0 * d * b2 - 8.0 * d * omega
    return d**2 * omega / below


class _Choco(Mixing):
    """The part of both algorithms: public copies of the own value and of those of the neighbours."""

    same: tuple[str, ...] = ("gamma", "compressor")

    def __init__(
        self,
        i: int,
        x: ArrayLike,
        weights: Rows,
        compressor: Compressor,
        gamma: float,
        rounds: int | None,
    ) -> None:
        super().__init__(i, weights, rounds)
        if len(self.weights) > 1:
            found = f"{len(self.weights)} rows"
            allowed = "one: the graph must not change"
            raise ConfigError(f"agent {i}: weights", found, allowed)
        if not 0.0 < gamma <= 1.0:
            raise ConfigError(f"agent {i}: gamma", gamma, "above 0, at most 1")
        self.x = require_vector(i, copy_state(f"agent {i}: x", x))
        self.gamma = gamma
        self.compressor = compressor
        self._public = {j: np.zeros(len(self.x)) for j in self.weights[0]}
        self._half = self.x
        self._told = b""
        self._told_round = -1

    @property
    def public(self) -> Vec:
        """The public copy of the own x, (n,), which all neighbours have too."""
        return self._public[self.i]

    @abstractmethod
    def move(self) -> Vec:
        """Return the own value (n,) of this round before the averaging."""

    def payload(self) -> bytes:
        """Return the compressed difference of the own value and its public copy."""
        if self._told_round != self.k:
            self._told_round = self.k
            self._half = self.move()
            change = self._half - self.public
            self._told = self.compressor.encode(change, self.i, self.k)
        return self._told

    def mix_in(self, row: Row, heard: Mapping[int, Any]) -> None:
        """Update the public copies, and move x towards the copies of the neighbours."""
        require_heard(self.i, row, heard)
        for j, payload in {self.i: self.payload(), **heard}.items():
            self._public[j] = self._public[j] + self._decode(j, payload)
        x = self._half.copy()
        for j in heard:
            x += self.gamma * row[j] * (self._public[j] - self.public)
        self.x = x

    def _decode(self, j: int, payload: Any) -> Vec:
        """Return the difference (n,) that agent j has sent."""
        where = f"agent {self.i}"
        if not isinstance(payload, bytes):
            allowed = f"the bytes of a {type(self.compressor).__name__}"
            raise build_malformed_error(where, j, self.k, payload, allowed)
        try:
            return self.compressor.decode(payload, len(self.x), j, self.k)
        except ValueError as error:
            found, allowed = str(error).split("; allowed: ")
            do = "All agents need the same compressor, and an x of the same length."
            place = f"{where}: message of agent {j}, round {self.k}"
            raise ConfigError(place, found, allowed, do) from None


class ChocoGossip(_Choco):
    """Consensus on the mean with compressed messages and error feedback.

        q_i = Q(x_i - ^x_i)
        ^x_j <- ^x_j + q_j                        for agent i itself and its neighbours, ^x(0) = 0
        x_i <- x_i + gamma sum_j w_ij (^x_j - ^x_i)

    Only q_i travels, a few bytes. What the compressor leaves out stays in x_i - ^x_i and is sent
    later, so that the agents agree on the mean of the start itself, and not near it. The mean of all
    x does not change. The graph is static.

    i: id of the agent
    x: (n,) start
    weights: row i, symmetric and doubly stochastic
    compressor: Q, `Quantised` or `TopK`, the same at all agents
    gamma: consensus step, above 0 and at most 1, the same at all agents. `choco_gamma` returns one
        with which convergence is linear: (1 - d^2 w / 82) a round, with d = 1 - |l_2(W)| and w the
        quality of Q. A larger one is often faster, until it diverges
    rounds: number of rounds until done; None for no end
    Raises ConfigError that names gamma if x grows without end.
    Source: Koloskova, Stich & Jaggi 2019, "Decentralized stochastic optimization and gossip
    algorithms with compressed communication", ICML, PMLR 97, 3478-3487.
    """

    def __init__(
        self,
        i: int,
        x: ArrayLike,
        weights: Rows,
        compressor: Compressor,
        gamma: float,
        rounds: int | None = None,
    ) -> None:
        super().__init__(i, x, weights, compressor, gamma, rounds)
        step = step_size(gamma)
        self._watch = GrowthWatch(f"agent {i}: gamma", step, SMALL_ENOUGH_GAMMA)

    def move(self) -> Vec:
        """Return x_i."""
        self._watch(self.k, self.x)
        return self.x


@dataclass(frozen=True)
class ChocoSteps:
    """The two step sizes of CHOCO-SGD, the same at all agents."""

    gamma: float
    """Consensus step, above 0 and at most 1, see `choco_gamma`."""
    step: float | StepSize
    """a_k, step along the gradient."""


class ChocoSGD(_Choco):
    """Stochastic gradient method for  min sum_i f_i(x)  with compressed messages.

        v_i = x_i - a_k g_i(x_i)
        q_i = Q(v_i - ^x_i)
        ^x_j <- ^x_j + q_j                        for agent i itself and its neighbours, ^x(0) = 0
        x_i <- v_i + gamma sum_j w_ij (^x_j - ^x_i)

    Only q_i travels, a few bytes. The graph is static.

    i: id of the agent
    x: (n,) start
    weights: row i, symmetric and doubly stochastic
    gradient: g_i, the gradient of f_i or a stochastic one, see `Samples`
    compressor: Q, `Quantised` or `TopK`, the same at all agents
    steps: gamma and a_k. With f_i strongly convex and smooth, and a_k of the order of 1 / k, it
        converges at the rate 1 / k. A constant a_k converges to a neighbourhood of the optimum that
        grows with a_k, and with 1 / gamma
    rounds: number of rounds until done; None for no end
    Raises ConfigError that names the step if x grows without end.
    Source: Koloskova, Stich & Jaggi 2019, "Decentralized stochastic optimization and gossip
    algorithms with compressed communication", ICML, PMLR 97, 3478-3487.
    """

    same = ("gamma", "compressor", "step_size")

    def __init__(
        self,
        i: int,
        x: ArrayLike,
        weights: Rows,
        gradient: Gradient,
        compressor: Compressor,
        steps: ChocoSteps,
        rounds: int | None = None,
    ) -> None:
        super().__init__(i, x, weights, compressor, steps.gamma, rounds)
        self.gradient = CheckedFunction(i, "gradient", gradient)
        self.step_size = step_size(steps.step)
        self._watch = GrowthWatch(f"agent {i}", self.step_size, SMALL_ENOUGH_STEP)

    def move(self) -> Vec:
        """Return x_i after its gradient step."""
        self._watch(self.k, self.x)
        g = self.gradient(self.k, self.x)
        moved: Vec = self.x - self.step_size(self.k) * g
        return moved
