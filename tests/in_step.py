"""All agents of an algorithm in one plain loop: the same messages as over a network, without any."""

from crazychoir.types import PerNeighbor


def run_in_step(agents, graph, rounds=10_000):
    """Until all are done, at most so many rounds; returns how many. All must be done in the same one."""
    for k in range(rounds):
        if any(agent.done for agent in agents.values()):
            assert all(agent.done for agent in agents.values())
            return k
        sent = {i: agent.message() for i, agent in agents.items()}
        for i, agent in agents.items():
            agent.step({j: _for(i, sent[j]) for j in graph.at(k).in_neighbors(i)})
    return rounds


def _for(i, message):
    return message[i] if isinstance(message, PerNeighbor) else message
