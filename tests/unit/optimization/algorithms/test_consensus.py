import json

import numpy as np
import pytest
from in_step import run_in_step

from crazychoir.errors import AgentFailed, ConfigError
from crazychoir.optimization.algorithms.consensus import Consensus
from crazychoir.optimization.rounds.mixing import rows, team
from crazychoir.solve.simulate import simulate
from crazychoir.team.graph import (
    GraphSequence,
    erdos_renyi_connected,
    ring,
    row_stochastic,
)


def matrix(graph, rule):
    weights = rows(graph, rule)
    return np.array([[weights[i][0].get(j, 0.0) for j in graph.ids] for i in graph.ids])


def test_it_gives_the_recorded_trajectory(reference_data):
    """Ring of 5, Metropolis weights, 500 rounds."""
    data = json.loads(
        (reference_data("disropt") / "consensus_ring_N5.json").read_text()
    )
    weights = [{j: w for j, w in enumerate(row) if w} for row in data["W"]]
    agents = {
        i: Consensus(i, data["x0"][i], weights[i], data["iterations"]) for i in range(5)
    }
    history = simulate(agents, ring(5), loss=0.4)
    assert history.rounds == 500
    np.testing.assert_allclose(history.of()[:, -1], data["x_final"], atol=1e-9)


def test_row_stochastic_weights_lead_to_the_mean_weighted_by_their_left_eigenvector():
    graph = erdos_renyi_connected(7, 0.4, 5, directed=True)
    x = np.random.default_rng(1).normal(size=(7, 2))
    agents = team(graph, lambda i, w: Consensus(i, x[i], w, 400), row_stochastic)
    run_in_step(agents, graph)
    values, vectors = np.linalg.eig(matrix(graph, row_stochastic).T)
    pi = np.real(vectors[:, np.argmax(np.real(values))])
    np.testing.assert_allclose(
        [agent.x for agent in agents.values()],
        np.tile(pi / pi.sum() @ x, (7, 1)),
        atol=1e-12,
    )


def test_a_changing_graph_leads_to_the_mean():
    graph = GraphSequence.draw(erdos_renyi_connected(6, 0.5, 1), 0.3, 6, 2)
    agents = team(graph, lambda i, w: Consensus(i, [i, i**2], w, 600))
    assert len(agents[0].weights) == 6
    run_in_step(agents, graph)
    np.testing.assert_allclose(
        [agent.x for agent in agents.values()],
        np.tile([2.5, 55 / 6], (6, 1)),
        atol=1e-9,
    )


@pytest.mark.parametrize(
    ("x", "weights", "error"),
    [
        (
            [1.0, np.nan],
            {0: 1.0},
            r"agent 0: x\[1\]: found nan; allowed: finite numbers",
        ),
        ("three", {0: 1.0}, r"agent 0: x: found str"),
        (
            [1.0],
            {0: 0.5, 1: 0.4},
            r"agent 0: weights = {0: 0.5, 1: 0.4}: they sum to 0.9",
        ),
        (
            [1.0],
            {1: 1.0},
            r"agent 0: weights: found weights of \[1\]; allowed: one of agent 0 itself too",
        ),
        ([1.0], {0: np.inf, 1: 0.5}, r"agent 0: weights\[0\]: found inf"),
        ([1.0], (), r"agent 0: weights: found none"),
    ],
)
def test_what_is_wrong_with_one_agent_is_said_when_it_is_made(x, weights, error):
    with pytest.raises(ConfigError, match=error):
        Consensus(0, x, weights)


def test_rounds_are_no_negative_number():
    with pytest.raises(ConfigError, match="agent 3: rounds: found -1"):
        Consensus(3, [1.0], {3: 1.0}, -1)


def test_an_agent_that_hears_other_agents_than_its_weights_name_says_so():
    agent = Consensus(0, [1.0], {0: 0.5, 1: 0.5})
    with pytest.raises(
        ConfigError,
        match=r"agent 0: weights: found of \[1\]; allowed: of the agents it hears, \[2\]",
    ):
        agent.step({2: np.ones(1)})
    with pytest.raises(
        ConfigError,
        match=r"agent 0: weights: found of \[1\]; allowed: of the agents it hears, \[\]",
    ):
        agent.step({})
    with pytest.raises(
        ConfigError,
        match=r"agent 0: message of agent 1: found shape \(2,\); allowed: floats of shape",
    ):
        agent.step({1: np.ones(2)})
    with pytest.raises(
        ConfigError,
        match=r"found shape \(1,\) of int64; allowed: floats of shape \(1,\), as its own",
    ):
        agent.step({1: np.ones(1, np.int64)})
    with pytest.raises(ConfigError, match=r"agent 0: message of agent 1: found str"):
        agent.step({1: "x"})


def test_each_agent_hears_of_a_neighbours_wrong_size_in_flight():
    """Without the look at the whole team, as in flight."""
    agents = team(ring(5), lambda i, w: Consensus(i, np.ones(2 + (i == 3)), w, 50))
    for agent in agents.values():
        agent.connected = False
    with pytest.raises(ConfigError, match="agent 2: message of agent 3"):
        simulate(agents, ring(5), loss=0.3)
    assert all(agent.k <= 3 for agent in agents.values())
    assert issubclass(AgentFailed, RuntimeError)
