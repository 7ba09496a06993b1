import numpy as np
import pytest

from crazychoir.optimization.rounds.stillness import Stillness
from crazychoir.team.graph import GraphSequence, complete, graph_from_name, ring


def ends(graph, diameter, changes):
    """The rounds in which each agent ends; changes: {(agent, round)}."""
    agents, found = {i: Stillness(diameter) for i in graph.ids}, {}
    for k in range(60):
        told = {i: agent.message() for i, agent in agents.items()}
        for i, agent in agents.items():
            agent.step(
                (i, k) in changes, {j: told[j] for j in graph.at(k).in_neighbors(i)}
            )
            if agent.reached:
                found.setdefault(i, k)
    return found


@pytest.mark.parametrize(
    "graph",
    [
        graph_from_name("ring", 5),
        graph_from_name("path", 6),
        graph_from_name("star", 4),
        ring(6, directed=True),
    ],
)
@pytest.mark.parametrize("last", [0, 7, 19])
def test_all_end_together_2_d_plus_1_rounds_after_the_last_change(graph, last):
    changer = np.random.default_rng(last).choice(graph.ids, last)
    changes = {(i, k) for k, i in enumerate(changer)} | {(graph.ids[-1], last)}
    d = graph.diameter()
    assert ends(graph, d, changes) == dict.fromkeys(graph.ids, last + 2 * d + 1)


def test_all_end_together_where_the_graph_changes():
    graph = GraphSequence.draw(complete(6), 0.1, 3, seed=4)
    assert ends(graph, 12, {(2, 5), (4, 11)}) == dict.fromkeys(graph.ids, 11 + 25)


def test_too_small_a_diameter_ends_agents_apart():
    assert (
        len(
            set(
                ends(
                    graph_from_name("path", 12), 1, {(11, k) for k in range(9)}
                ).values()
            )
        )
        > 1
    )
