"""ProxSkip: several gradient steps between two messages, for a common variable."""

import random
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from crazychoir.errors import ConfigError
from crazychoir.optimization.problems.gradient import CheckedFunction, Gradient
from crazychoir.optimization.rounds.arrays import is_number
from crazychoir.optimization.rounds.mixing import Row, Rows, mix
from crazychoir.optimization.rounds.static_mixing import StaticMixing
from crazychoir.optimization.rounds.step_size import Constant, GrowthWatch
from crazychoir.types import Vec

SMALL_ENOUGH_STEP = "at most 1 / L, f_i L-smooth"
"""Steps with which ProxSkip converges, for error texts."""
LEAST_CHANCE = 1e-3
"""Smallest chance of a message: with it, an agent makes 1000 gradient steps a round."""


@dataclass(frozen=True)
class SharedCoin:
    """A coin that falls the same way at all agents, because they toss it with one seed."""

    p: float
    """Chance that the agents communicate after a gradient step, at least LEAST_CHANCE, at most 1."""
    seed: int = 0
    """Seed of the tosses."""

    def __post_init__(self) -> None:
        if not is_number(self.p) or not LEAST_CHANCE <= self.p <= 1.0:
            raise ConfigError("coin: p", f"{self.p}", f"{LEAST_CHANCE:g} to 1")

    def make_generator(self) -> random.Random:
        """Return the generator of the tosses, at its start."""
        return random.Random(self.seed)  # noqa: S311 - when to send, not secrets


class ProxSkip(StaticMixing):
    """Decentralized ProxSkip for  min sum_i f_i(x),  f_i strongly convex and L-smooth.

    After each gradient step all agents toss the same coin. It says with chance p that they
    communicate:

        y_i = x_i - a [grad f_i(x_i) - h_i],   h_i(0) = 0
        skip:         x_i <- y_i
        communicate:  x_i <- (y_i + sum_j w_ij y_j) / 2,   h_i <- h_i + (p / a) (x_i - y_i)

    A round is one communication with all gradient steps before it, 1/p of them on average: the
    agents are silent between two rounds. So each message is a communication. With p = 1 this is
    exact diffusion.

    i: id of the agent
    x: x_i(0), any shape, the same shape at all agents. After a round it is x_i just after the
        communication
    weights: row i of W, symmetric and doubly stochastic, of a static graph
    gradient: grad f_i
    step: a, the same at all agents. The expected distance from the optimum shrinks linearly for
        a <= 1 / L
    coin: p and the seed, the same at all agents. With strongly convex f_i (modulus m) and a
        well-connected graph, p = sqrt(m / L) needs the fewest rounds
    rounds: number of communications until done; None for no end
    steps: number of gradient steps done
    Raises ConfigError that names the step if it is so large that x grows without end.
    Source: Mishchenko, Malinovsky, Stich & Richtarik 2022, ICML, "ProxSkip: yes! Local gradient
    steps provably lead to communication acceleration! Finally!".
    """

    same = ("step_size", "coin")

    def __init__(
        self,
        i: int,
        x: ArrayLike,
        weights: Rows,
        gradient: Gradient,
        step: float,
        coin: SharedCoin,
        rounds: int | None = None,
    ) -> None:
        super().__init__(i, x, weights, rounds)
        self.step_size = Constant(step)
        self.gradient = CheckedFunction(i, "gradient", gradient)
        self.coin = coin
        self.steps = 0
        self.h = np.zeros_like(self.x)
        self._watch = GrowthWatch(f"agent {i}", self.step_size, SMALL_ENOUGH_STEP)
        self._tosses = coin.make_generator()
        self._descend()

    def _descend(self) -> None:
        """Make gradient steps until the coin says that the agents communicate."""
        y = self.x
        is_skipped = True
        while is_skipped:
            y = y - self.step_size.a * (self.gradient(self.k, y) - self.h)
            self.steps += 1
            is_skipped = self._tosses.random() >= self.coin.p
        self._y = y

    def payload(self) -> Vec:
        """Return y_i."""
        return self._y

    def mix_in(self, row: Row, heard: Mapping[int, Vec]) -> None:
        """Average, correct h_i, and make the gradient steps before the next round."""
        self.x = 0.5 * (self._y + mix(self.i, row, self._y, heard))
        self.h = self.h + (self.coin.p / self.step_size.a) * (self.x - self._y)
        self._watch(self.k, self.x)
        self._descend()
