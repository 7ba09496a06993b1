"""GT-SAGA and GTAdam follow their equations, and the trackers keep the sum of the estimates."""

import random

import numpy as np
import pytest
from in_step import run_in_step

from crazychoir.optimization.algorithms.stochastic.gt_adam import GTAdam, Momentum
from crazychoir.optimization.algorithms.stochastic.gt_saga import (
    GTSAGA,
    SUMMATION_ROUNDS,
)
from crazychoir.optimization.generate import random_quadratics
from crazychoir.optimization.problems.gradient import Samples
from crazychoir.optimization.rounds.mixing import team
from crazychoir.team import graph as graphs

GRAPH = graphs.erdos_renyi_connected(6, 0.5, 1)
WEIGHTS = graphs.metropolis(GRAPH)
W = np.array([[WEIGHTS[i].get(j, 0.0) for j in range(6)] for i in range(6)])
Q = random_quadratics(6, 3, seed=1)


def gathered(agents, name):
    return np.array([getattr(agent, name) for agent in agents.values()])


@pytest.mark.parametrize("batch", [1, 3])
def test_gt_saga_follows_its_equation(batch):
    chance = np.random.default_rng(5)
    a, b = chance.normal(size=(6, 8, 3)), chance.normal(size=(6, 8))

    def gradient(i, x, s):
        return a[i, s] * (a[i, s] @ x - b[i, s])

    def samples(i):
        return Samples(i, lambda x, s: gradient(i, x, s), range(8), batch, seed=2)

    agents = team(GRAPH, lambda i, w: GTSAGA(i, np.ones(3) * i, w, samples(i), 0.05))
    draws = [random.Random(f"2 {i}") for i in range(6)]  # noqa: S311
    x = gathered(agents, "x")
    table = np.array([[gradient(i, x[i], s) for s in range(8)] for i in range(6)])
    y = g = table.mean(axis=1)
    for _ in range(30):
        run_in_step(agents, GRAPH, 1)
        x = W @ x - 0.05 * y
        new = []
        for i in range(6):
            drawn = draws[i].sample(range(8), batch)
            fresh = np.array([gradient(i, x[i], s) for s in drawn])
            new.append((fresh - table[i, drawn]).mean(axis=0) + table[i].mean(axis=0))
            table[i, drawn] = fresh
        y, g = W @ y + np.array(new) - g, np.array(new)
        assert gathered(agents, "x") == pytest.approx(x, abs=1e-11)
        assert gathered(agents, "y").sum(axis=0) == pytest.approx(g.sum(axis=0))


def test_rounding_errors_of_a_far_start_do_not_stay_in_the_mean_gradient():
    chance = np.random.default_rng(7)
    a, b = chance.normal(size=(6, 8, 3)), chance.normal(size=(6, 8))

    def samples(i):
        return Samples(
            i, lambda x, s: a[i, s] * (a[i, s] @ x - b[i, s]), range(8), batch=8
        )

    def mean_gradient(i, x):
        return a[i].T @ (a[i] @ x - b[i]) / 8

    agents = team(GRAPH, lambda i, w: GTSAGA(i, np.full(3, 1e9), w, samples(i), 0.1))
    run_in_step(agents, GRAPH, 4 * SUMMATION_ROUNDS)
    for i, agent in agents.items():
        assert np.abs(agent.x).max() < 1000.0
        assert agent.g == pytest.approx(mean_gradient(i, agent.x), rel=1e-9)


def test_gt_adam_follows_its_equation():
    moments = Momentum(0.8, 0.9, 0.05, 3.0)
    agents = team(
        GRAPH,
        lambda i, w: GTAdam(i, np.ones(3) * i, w, Q.gradient(i), 0.02, moments),
    )
    x = gathered(agents, "x")
    y = g = np.array([Q.gradient(i)(x[i]) for i in range(6)])
    m = v = np.zeros((6, 3))
    for _ in range(30):
        run_in_step(agents, GRAPH, 1)
        m = 0.8 * m + 0.2 * y
        v = np.minimum(0.9 * v + 0.1 * y * y, 3.0)
        x = W @ x - 0.02 * m / np.sqrt(v + 0.05)
        new = np.array([Q.gradient(i)(x[i]) for i in range(6)])
        y, g = W @ y + new - g, new
        assert gathered(agents, "x") == pytest.approx(x, abs=1e-12)
        assert gathered(agents, "y").sum(axis=0) == pytest.approx(g.sum(axis=0))
