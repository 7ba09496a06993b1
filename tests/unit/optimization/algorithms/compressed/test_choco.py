"""CHOCO: the mean and the optimum with few bytes, the same iterates with loss, and clear errors."""

import numpy as np
import pytest
from in_step import run_in_step

from crazychoir.errors import ConfigError
from crazychoir.optimization.algorithms.compressed.choco import (
    ChocoGossip,
    ChocoSGD,
    ChocoSteps,
    choco_gamma,
)
from crazychoir.optimization.algorithms.compressed.compressors import Quantised, TopK
from crazychoir.optimization.algorithms.consensus import Consensus
from crazychoir.optimization.generate import random_quadratics
from crazychoir.optimization.problems.gradient import Samples
from crazychoir.optimization.rounds.mixing import rows, team
from crazychoir.solve.simulate import simulate
from crazychoir.team.graph import (
    GraphSequence,
    erdos_renyi_connected,
    metropolis,
    path,
    ring,
)

GRAPH = erdos_renyi_connected(5, 0.5, 2)
COMPRESSORS = (Quantised(2), Quantised(4), Quantised(4, seed=5), TopK(4))


def gossip(graph, start, compressor, gamma=0.4, rounds=120):
    return team(
        graph,
        lambda i, w: ChocoGossip(i, start[i], w, compressor, gamma, rounds),
    )


def inverse_time(k):
    """A step of the order of 1 / k."""
    return 1.0 / (k + 40)


@pytest.mark.parametrize("compressor", COMPRESSORS)
def test_gossip_agrees_on_the_mean_and_loss_changes_no_bit(compressor):
    start = np.random.default_rng(1).normal(size=(5, 10))
    calm = gossip(GRAPH, start, compressor)
    run_in_step(calm, GRAPH)
    lossy = gossip(GRAPH, start, compressor)
    history = simulate(lossy, GRAPH, loss=0.4, seed=2)
    assert history.lost > 0.2 * history.messages
    for i, agent in lossy.items():
        assert agent.x.tobytes() == calm[i].x.tobytes()
        assert agent.x == pytest.approx(start.mean(axis=0), abs=1e-6)


@pytest.mark.parametrize("seed", range(3))
def test_gossip_agrees_on_random_graphs_and_from_any_scale(seed):
    graph = erdos_renyi_connected(8, 0.4, seed)
    start = np.random.default_rng(seed).normal(size=(8, 6)) * 10.0 ** (6 * seed - 6)
    agents = gossip(graph, start, Quantised(4), rounds=800)
    run_in_step(agents, graph)
    for agent in agents.values():
        error = np.abs(agent.x - start.mean(axis=0)).max()
        assert error < 1e-9 * np.abs(start).max()


def test_few_bits_an_entry_leave_few_bytes_a_message():
    """A vector of 500 entries: 4000 bytes, or 254 with 4 bits each, or 150 for the 25 largest."""
    start = np.random.default_rng(1).normal(size=(5, 500))
    whole = team(ring(5), lambda i, w: Consensus(i, start[i], w, 20))
    sent = simulate(whole, ring(5)).bytes
    for compressor, size in ((Quantised(4), 254), (TopK(25), 150)):
        agents = gossip(ring(5), start, compressor, rounds=20)
        history = simulate(agents, ring(5))
        assert len(agents[0].payload()) == size
        assert history.bytes / history.messages < size + 100
        assert history.bytes < 0.1 * sent


@pytest.mark.parametrize("compressor", [Quantised(4), Quantised(4, seed=5), TopK(1)])
@pytest.mark.parametrize("seed", range(2))
def test_the_error_of_choco_sgd_goes_down_as_its_step(compressor, seed):
    costs = random_quadratics(5, 2, seed)
    agents = team(
        GRAPH,
        lambda i, w: ChocoSGD(
            i,
            np.zeros(2),
            w,
            costs.gradient(i),
            compressor,
            ChocoSteps(0.5, inverse_time),
        ),
    )
    errors = []
    for rounds in (160, 640):  # steps of 1/200 and 1/800 in the end
        run_in_step(agents, GRAPH, rounds)
        x = np.array([agent.x for agent in agents.values()])
        errors.append(np.abs(x - costs.optimum).max())
    assert errors[1] < 0.35 * errors[0]
    assert errors[1] < 0.06


def test_choco_sgd_with_samples_makes_the_same_iterates_with_loss():
    def agents():
        return team(
            GRAPH,
            lambda i, w: ChocoSGD(
                i,
                np.zeros(2),
                w,
                Samples(i, lambda x, s: x - s, [0.0, i, 2.0 * i], 1),
                Quantised(3),
                ChocoSteps(0.3, inverse_time),
                200,
            ),
        )

    calm, lossy = agents(), agents()
    run_in_step(calm, GRAPH)
    history = simulate(lossy, GRAPH, loss=0.4, seed=2)
    assert history.lost > 0.2 * history.messages
    for i, agent in lossy.items():
        assert agent.x.tobytes() == calm[i].x.tobytes()
        assert agent.x == pytest.approx([2.0, 2.0], abs=0.4)


def test_too_large_a_gamma_is_named():
    start = np.random.default_rng(1).normal(size=(5, 20))
    agents = gossip(GRAPH, start, TopK(1), gamma=1.0, rounds=2000)
    with pytest.raises(ConfigError, match=r"gamma: step 1, round .* choco_gamma"):
        run_in_step(agents, GRAPH)


@pytest.mark.parametrize(
    ("payload", "error"),
    [
        (np.ones(3), r"message of agent \d, round 0: found shape \(3,\)"),
        ("text", r"message of agent \d, round 0: found str"),
        (b"123", r"message of agent \d, round 0: found 3 bytes; allowed: 6"),
        (b"\x00\x00\xc0\x7f12", r"message of agent \d, round 0: found scale nan"),
    ],
)
def test_a_malformed_message_is_named(payload, error):
    weights = rows(GRAPH)
    agent = ChocoGossip(0, np.ones(3), weights[0], Quantised(4), 0.3)
    heard = {j: [weights[j][0][0], payload] for j in GRAPH.neighbors(0)}
    with pytest.raises(ConfigError, match=error):
        agent.step(heard)


def test_an_index_beyond_the_vector_is_refused():
    with pytest.raises(ValueError, match="indices"):
        TopK(1).decode(b"\x09\x00\x00\x00\x00", 3, 0, 0)
    with pytest.raises(ValueError, match="4 bytes; allowed: 5"):
        TopK(1).decode(b"\x09\x00\x00\x00", 3, 0, 0)


def test_huge_and_vanishing_entries_do_not_break_the_message():
    for x in (np.array([1e300, 1.0]), np.array([1e-300, 0.0]), np.zeros(2)):
        for compressor in (Quantised(4), Quantised(4, seed=1), TopK(1)):
            decoded = compressor.decode(compressor.encode(x, 0, 0), 2, 0, 0)
            assert np.isfinite(decoded).all()


@pytest.mark.parametrize(
    ("make", "error"),
    [
        (lambda: Quantised(1), "Quantised: bits: found 1"),
        (lambda: Quantised(17), "Quantised: bits: found 17"),
        (lambda: TopK(0), "TopK: k: found 0"),
        (lambda: choco_gamma(metropolis(path(3)), 0.0), "choco_gamma: omega: found 0"),
        (
            lambda: ChocoGossip(0, [1.0], {0: 1.0}, TopK(1), 1.5),
            "agent 0: gamma: found 1.5",
        ),
        (
            lambda: gossip(
                GraphSequence.draw(GRAPH, 0.5, 3, 1), np.ones((5, 2)), TopK(1)
            ),
            "agent 0: weights: found 3 rows",
        ),
    ],
)
def test_bad_arguments_are_named(make, error):
    with pytest.raises(ConfigError, match=error):
        make()


def test_dithers_that_differ_are_named():
    graph = ring(4)
    agents = team(
        graph,
        lambda i, w: ChocoGossip(i, np.array([i]), w, Quantised(4, seed=i), 0.1, 5),
    )
    with pytest.raises(ConfigError, match="compressor"):
        simulate(agents, graph)
