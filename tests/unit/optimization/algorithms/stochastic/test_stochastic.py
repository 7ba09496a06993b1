"""GT-SAGA and GTAdam: the central optimum, the same iterates with loss, and clear errors."""

import numpy as np
import pytest
from in_step import run_in_step

from crazychoir.errors import ConfigError
from crazychoir.optimization.algorithms.stochastic.gt_adam import GTAdam, Momentum
from crazychoir.optimization.algorithms.stochastic.gt_saga import GTSAGA
from crazychoir.optimization.algorithms.subgradient import SubgradientMethod
from crazychoir.optimization.generate import random_quadratics
from crazychoir.optimization.problems.gradient import Samples
from crazychoir.optimization.rounds.mixing import rows, team
from crazychoir.solve.simulate import simulate
from crazychoir.team.graph import erdos_renyi_connected

GRAPH = erdos_renyi_connected(5, 0.5, 2)


class LeastSquares:
    """Noisy linear measurements, spread over the agents."""

    def __init__(self, seed, count=6):
        chance = np.random.default_rng(seed)
        self.a = chance.normal(size=(5, count, 2))
        noise = 0.3 * chance.normal(size=(5, count))
        self.b = self.a @ np.array([1.0, -2.0]) + noise
        self.optimum = np.linalg.lstsq(
            self.a.reshape(-1, 2), self.b.ravel(), rcond=None
        )[0]

    def samples(self, i):
        def gradient(x, s):
            return self.a[i, s] * (self.a[i, s] @ x - self.b[i, s])

        return Samples(i, gradient, range(len(self.b[i])))


def saga(data, rounds):
    return team(
        GRAPH, lambda i, w: GTSAGA(i, np.zeros(2), w, data.samples(i), 0.06, rounds)
    )


def adam(costs, rounds):
    moments = Momentum(epsilon=0.1)
    return team(
        GRAPH,
        lambda i, w: GTAdam(
            i, np.zeros(2), w, costs.gradient(i), 0.01, moments, rounds
        ),
    )


@pytest.mark.parametrize("seed", range(3))
def test_gt_saga_reaches_the_optimum_that_a_constant_step_misses_without_it(seed):
    data = LeastSquares(seed)
    agents = saga(data, 700)
    run_in_step(agents, GRAPH)
    for agent in agents.values():
        assert agent.x == pytest.approx(data.optimum, abs=1e-5)
    plain = team(
        GRAPH,
        lambda i, w: SubgradientMethod(
            i, np.zeros(2), w, data.samples(i), 0.06, rounds=700
        ),
    )
    run_in_step(plain, GRAPH)
    assert max(np.abs(p.x - data.optimum).max() for p in plain.values()) > 1e-3


@pytest.mark.parametrize("seed", range(3))
def test_gt_adam_reaches_the_optimum(seed):
    costs = random_quadratics(5, 2, seed)
    agents = adam(costs, 900)
    run_in_step(agents, GRAPH)
    for agent in agents.values():
        assert agent.x == pytest.approx(costs.optimum, abs=1e-5)


@pytest.mark.parametrize(
    "make",
    [
        lambda: saga(LeastSquares(0), 60),
        lambda: adam(random_quadratics(5, 2, 0), 60),
    ],
)
def test_loss_changes_no_bit(make):
    calm, lossy = make(), make()
    run_in_step(calm, GRAPH)
    history = simulate(lossy, GRAPH, loss=0.4, seed=3)
    assert history.lost > 0.2 * history.messages
    for i, agent in lossy.items():
        assert agent.x.tobytes() == calm[i].x.tobytes()


def test_too_large_a_step_is_named():
    data = LeastSquares(0)
    agents = team(
        GRAPH, lambda i, w: GTSAGA(i, np.ones(2), w, data.samples(i), 5.0, 2000)
    )
    with pytest.raises(ConfigError, match=r"step 5, round .*allowed: of the order of"):
        run_in_step(agents, GRAPH)


def test_a_malformed_message_names_the_neighbour():
    weights = rows(GRAPH)
    agent = GTAdam(0, np.ones(2), weights[0], lambda x: x, 0.1)
    heard = {j: [weights[j][0][0], "text"] for j in GRAPH.neighbors(0)}
    error = r"agent 0: message of agent \d, round 0: found .*; allowed: a list of 2"
    with pytest.raises(ConfigError, match=error):
        agent.step(heard)


@pytest.mark.parametrize(
    ("arguments", "error"),
    [
        ({"beta_1": 1.0}, "Momentum: beta_1: found 1.0"),
        ({"beta_2": -0.1}, "Momentum: beta_2: found -0.1"),
        ({"epsilon": 0.0}, "Momentum: epsilon: found 0.0"),
        ({"largest": 0.0}, "Momentum: largest: found 0.0"),
    ],
)
def test_bad_moments_are_named(arguments, error):
    with pytest.raises(ConfigError, match=error):
        Momentum(**arguments)
