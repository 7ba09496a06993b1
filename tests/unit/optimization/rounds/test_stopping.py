"""All agents stop in one round, or each when it knows."""

import numpy as np
import pytest
from in_step import run_in_step

from crazychoir.errors import ConfigError
from crazychoir.optimization.algorithms.asynchronous_consensus import (
    AsynchronousConsensus,
)
from crazychoir.optimization.rounds.stopping import (
    AsynchronousLogicAnd,
    Flags,
    LogicAnd,
    Settled,
    Stoppable,
    Until,
)
from crazychoir.solve.simulate import simulate
from crazychoir.team.graph import (
    GraphSequence,
    complete,
    erdos_renyi_connected,
    metropolis,
    path,
    ring,
    star,
)

GRAPHS = [
    path(5),
    ring(6),
    ring(6, directed=True),
    star(5),
    complete(4),
    path(1),
    ring(80),
]


@pytest.mark.parametrize("graph", GRAPHS)
def test_all_are_done_in_one_round_as_many_as_the_diameter_after_the_last_flag(graph):
    agents = {i: LogicAnd(graph.diameter()) for i in graph.ids}
    for k in range(7):
        sent = {i: agent.message() for i, agent in agents.items()}
        for i, agent in agents.items():
            agent.flag = k >= 3 + i % 4
            agent.step({j: sent[j] for j in graph.in_neighbors(i)})
    latest = max(3 + i % 4 for i in graph.ids)
    assert run_in_step(agents, graph) + 7 == max(7, latest + 1 + graph.diameter())


def test_flags_that_come_and_go_count_only_if_all_were_up_in_one_round():
    """s_i^D(k) = and_j flag_j(k - D), against that definition, on random flags."""
    chance, graph = np.random.default_rng(3), erdos_renyi_connected(7, 0.3, 2)
    d = graph.diameter()
    flags = {i: Flags(d, False) for i in graph.ids}
    ups = [dict.fromkeys(graph.ids, False)]
    for k in range(1, 200):
        ups.append({i: chance.random() < 0.8 for i in graph.ids})
        sent = {i: flag.message() for i, flag in flags.items()}
        for i, flag in flags.items():
            flag.step(ups[k][i], {j: sent[j] for j in graph.in_neighbors(i)})
        assert {flag.agreed for flag in flags.values()} == {
            k >= d and all(ups[k - d].values())
        }
    assert sum(all(up.values()) for up in ups) > 20


def test_on_a_sequence_of_graphs_it_needs_the_rounds_of_a_flood():
    graph = GraphSequence.draw(ring(6), 0.3, 4, 1)
    assert graph.is_connected
    agents = {i: LogicAnd(4 * 3, flag=True) for i in graph.ids}
    assert run_in_step(agents, graph) == 12


@pytest.mark.parametrize("loss", [0.0, 0.6])
def test_asynchronous_agents_all_learn_it_and_none_too_early(loss):
    graph = path(6)
    agents = {
        i: AsynchronousLogicAnd(graph.neighbors(i), 5, flag=i != 3) for i in graph.ids
    }
    seen = []

    def watch(agents):
        seen.append(any(agent.done for agent in agents.values()))
        if len(seen) == 500:
            agents[3].flag = True

    simulate(agents, graph, loss=loss, record=(), watch=watch, seed=4)
    assert not any(seen[:500])
    assert all(agent.done for agent in agents.values())


def test_a_diameter_that_is_none():
    with pytest.raises(ConfigError, match="logic-and: diameter: found -1"):
        LogicAnd(-1)


class Halving:
    def __init__(self, x):
        self.x, self.done = x, False

    def message(self):
        return None

    def step(self, heard):
        self.x = self.x / 2.0


def test_settled_looks_at_the_largest_change_some_rounds_in_a_row():
    agent, settled = Halving(np.array([8.0, 1.0])), Settled(1.0, rounds=2)
    said = []
    for _ in range(6):
        agent.step({})
        said.append(settled(agent))
    assert said == [False, False, False, True, True, True]  # changes 2, 1, 0.5, ...
    with pytest.raises(ConfigError, match="Settled"):
        Settled(-1.0)
    assert not Settled(float("inf"))(agent)


def test_until_hands_on_what_the_algorithm_has_and_ends_with_it():
    inner = Halving(4.0)
    until = Until(inner, Settled(1e-3), 2)
    assert until.x == 4.0
    with pytest.raises(AttributeError, match="nothing"):
        _ = until.nothing
    inner.done = True
    assert until.done


def test_until_needs_the_neighbors_of_an_asynchronous_agent():
    inner = Halving(1.0)
    inner.asynchronous = True
    with pytest.raises(ConfigError, match="Until: neighbors"):
        Until(inner, Settled(0.1), 2)


class Endless:
    done, k = False, 0

    def message(self):
        return self.k

    def step(self, heard):
        self.k += 1


@pytest.mark.parametrize(
    "graph", [path(5), ring(6, directed=True), complete(3), path(1)]
)
def test_an_agent_that_stops_ends_all_agents_in_one_round(graph):
    agents = {i: Stoppable(Endless(), graph.diameter()) for i in graph.ids}
    run_in_step(agents, graph, 7)
    agents[0].stop()
    run_in_step(agents, graph, 1)
    agents[graph.ids[-1]].stop()
    assert run_in_step(agents, graph) + 1 == max(graph.diameter(), 1)
    assert {agent.algorithm.k for agent in agents.values()} == {
        7 + max(graph.diameter(), 1)
    }


def test_an_agent_stopped_between_message_and_step_ends_all_in_one_round_too():
    graph = path(4)
    agents = {i: Stoppable(Endless(), 3) for i in graph.ids}

    def watch(team):
        if team[1].k == 10:
            team[1].stop()

    simulate(agents, graph, loss=0.4, record=(), watch=watch)
    assert {agent.algorithm.k for agent in agents.values()} == {13}


def test_an_asynchronous_agent_that_stops_ends_the_others_when_they_hear():
    class Awake(Endless):
        asynchronous = True

    graph = path(5)
    agents = {i: Stoppable(Awake(), 4) for i in graph.ids}

    def watch(team):
        if team[4].algorithm.k == 20:
            team[4].stop()

    simulate(agents, graph, loss=0.5, record=(), watch=watch, seed=1)
    assert 20 <= agents[4].algorithm.k <= 21
    assert all(agent.algorithm.k < 150 for agent in agents.values())


def test_a_flag_of_an_asynchronous_agent_that_was_up_once_counts():
    class Awake(Endless):
        asynchronous = True

    graph = path(4)
    agents = {
        i: Until(
            Awake(), lambda agent, i=i: agent.k == 10 + 5 * i, 3, graph.neighbors(i)
        )
        for i in graph.ids
    }
    simulate(agents, graph, loss=0.3, record=(), rounds=500)
    assert all(agent.done and 25 <= agent.k < 120 for agent in agents.values())


@pytest.mark.parametrize("loss", [0.0, 0.4, 0.9])
def test_an_agent_that_hears_nothing_has_not_settled(loss):
    graph = path(4)
    weights = metropolis(graph)
    for seed in range(4):
        agents = {
            i: Until(
                AsynchronousConsensus(i, float(i), weights[i]),
                Settled(1e-6),
                3,
                graph.in_neighbors(i),
            )
            for i in graph.ids
        }
        history = simulate(agents, graph, loss=loss, seed=seed, rounds=5000)
        assert history.rounds < 5000
        assert history.disagreement() < 1e-4
