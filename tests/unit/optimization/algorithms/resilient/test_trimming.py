"""Consensus among liars: honest agents agree between the honest starts, up to the stated number of liars."""

import numpy as np
import pytest
from in_step import run_in_step

from crazychoir.errors import ConfigError
from crazychoir.optimization.algorithms.resilient.robustness import robustness
from crazychoir.optimization.algorithms.resilient.trimming import WMSR, TrimmedMean
from crazychoir.optimization.rounds.iteration import Iteration
from crazychoir.solve.simulate import simulate
from crazychoir.team.graph import complete, erdos_renyi_connected, k_regular, ring
from crazychoir.types import PerNeighbor

KINDS = (WMSR, TrimmedMean)


class Liar(Iteration):
    """An adversary: it sends what `say(k, j)` returns to neighbour j in round k."""

    connected = True

    def __init__(self, i, graph, say, rounds):
        super().__init__(i, rounds)
        self.graph, self.say, self.x = graph, say, np.zeros(2)

    def message(self):
        to = self.graph.out_neighbors(self.i)
        return PerNeighbor({j: self.say(self.k, j) for j in to})

    def update(self, heard):
        pass


LIES = {
    "constant": lambda k, j: np.array([100.0, -100.0]),
    "ramping": lambda k, j: np.array([0.1, -1.0]) * k,
    "different": lambda k, j: np.array([50.0, 50.0]) * (-1.0) ** j * np.sin(k + j),
    "plausible": lambda k, j: np.array([0.9, -0.9]) * (-1.0) ** j,
    "infinite": lambda k, j: np.array([np.inf, -np.inf]),
    "shapeless": lambda k, j: [None, "text", np.ones(3), {"x": 1.0}, b"1"][k % 5],
}


def mixed_team(kind, graph, liars, lie, guarded, rounds):
    """A team with liars, the others guarded against `guarded` of them; and the honest starts."""
    start = np.random.default_rng(4).uniform(-1.0, 1.0, (len(graph.ids), 2))
    honest = [i for i in graph.ids if i not in liars]
    agents = {
        i: kind(i, start[i], guarded, rounds)
        if i in honest
        else Liar(i, graph, lie, rounds)
        for i in graph.ids
    }
    return agents, honest, start[honest]


@pytest.mark.parametrize("lie", LIES)
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(
    ("graph", "liars"),
    [(complete(5), (3,)), (k_regular(8, 6), (2,)), (complete(9), (0, 5))],
)
def test_honest_agents_agree_between_the_honest_starts(kind, graph, liars, lie):
    F = len(liars)
    assert robustness(graph) >= 2 * F + 1
    agents, honest, start = mixed_team(kind, graph, liars, LIES[lie], F, 200)
    low, high = start.min(axis=0), start.max(axis=0)
    for _ in range(200):
        run_in_step(agents, graph, 1)
        x = np.array([agents[i].x for i in honest])
        assert np.all((low <= x) & (x <= high))
        low, high = x.min(axis=0), x.max(axis=0)  # the hull never grows
    assert np.ptp(x, axis=0).max() < 1e-6


@pytest.mark.parametrize("kind", KINDS)
def test_one_liar_too_many_leads_the_team_away(kind):
    agents, honest, start = mixed_team(
        kind, complete(7), (0, 1), LIES["constant"], 1, 200
    )
    run_in_step(agents, complete(7))
    x = np.array([agents[i].x for i in honest])
    assert np.abs(x - [100.0, -100.0]).max() < 1.0
    assert np.abs(start).max() < 1.0


@pytest.mark.parametrize("kind", KINDS)
def test_a_graph_that_is_not_robust_enough_may_stay_apart(kind):
    """Two groups of 4, a link from each agent to one of the other group: 2-robust at most."""
    links = {i: [j for j in range(4) if j != i] + [i + 4] for i in range(4)}
    links |= {i: [j for j in range(4, 8) if j != i] + [i - 4] for i in range(4, 8)}
    graph = type(complete(2)).from_neighbors(links)
    assert robustness(graph) < 3
    agents = {i: kind(i, [float(i >= 4)], 1, 100) for i in graph.ids}
    run_in_step(agents, graph)
    assert {float(agent.x[0]) for agent in agents.values()} == {0.0, 1.0}


@pytest.mark.parametrize("kind", KINDS)
def test_loss_changes_no_bit(kind):
    graph = complete(5)

    def made():
        return mixed_team(kind, graph, (3,), LIES["different"], 1, 40)

    (calm, honest, _), (lossy, _, _) = made(), made()
    run_in_step(calm, graph)
    history = simulate(lossy, graph, loss=0.4, seed=1)
    assert history.lost > 0.2 * history.messages
    for i in honest:
        assert lossy[i].x.tobytes() == calm[i].x.tobytes()
    assert np.ptp([lossy[i].x for i in honest], axis=0).max() < 1e-6


@pytest.mark.parametrize("kind", KINDS)
def test_without_liars_all_agree_on_directed_graphs_too(kind):
    graph = erdos_renyi_connected(6, 0.5, 1, directed=True)
    agents = {i: kind(i, [float(i)], 0, 300) for i in graph.ids}
    run_in_step(agents, graph)
    assert np.ptp([agent.x for agent in agents.values()]) < 1e-9


def test_too_few_neighbours_and_bad_arguments_are_named():
    agents = {i: WMSR(i, [1.0], 1, 5) for i in range(5)}
    error = "agent 0: found 2 agents that it hears; allowed: 3 or more for 1 liars"
    with pytest.raises(ConfigError, match=error):
        run_in_step(agents, ring(5))
    with pytest.raises(ConfigError, match="agent 0: liars: found -1"):
        TrimmedMean(0, [1.0], -1)
    with pytest.raises(ConfigError, match="robustness: found 21 agents"):
        robustness(ring(21))
