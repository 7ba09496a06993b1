"""Rounds on links that lose nothing: one loop, with the results of the protocol."""

import sys

import numpy as np
import pytest

from crazychoir.errors import AgentFailed, ChannelEnded, ConfigError
from crazychoir.optimization.algorithms.consensus import Consensus
from crazychoir.optimization.algorithms.gradient_tracking import GradientTracking
from crazychoir.optimization.algorithms.max_consensus import MaxConsensus
from crazychoir.optimization.rounds.mixing import team
from crazychoir.runtime.clock import run_virtual
from crazychoir.solve import simulate as simulation
from crazychoir.solve.simulate import simulate
from crazychoir.team.graph import Graph, metropolis, path, ring
from crazychoir.types import PerNeighbor

GRAPH = Graph.from_edges(7, [(0, 1), (1, 2), (2, 3), (3, 0), (3, 4), (4, 5), (3, 6)])
MOST_CALLS = 23
"""Most Python calls of a simulated round of an agent above those of its algorithm."""


def run_by_protocol(main):
    """Run the simulation over its network: only run_virtual itself allows the short way."""
    return run_virtual(main)


class Talking:
    """Sends a message of any kind, and keeps what it heard."""

    def __init__(self, i, say, rounds=5):
        self.i = i
        self.k = 0
        self.x = 0.0
        self.say = say
        self.rounds = rounds
        self.heard = []

    @property
    def done(self):
        return self.k >= self.rounds

    def message(self):
        return self.say(self.i, self.k)

    def step(self, heard):
        self.heard.append(repr(heard))
        for value in heard.values():
            if isinstance(value, list):
                value.append("changed by its reader")
        self.k += 1
        self.x = float(self.k)


class Failing(Talking):
    """Raises an error in one round."""

    def __init__(self, i, at, error):
        super().__init__(i, lambda i, k: k)
        self.at = at
        self.error = error

    def step(self, heard):
        if self.k == self.at:
            raise self.error
        super().step(heard)


def consensus():
    return team(GRAPH, lambda i, w: Consensus(i, [i, 0.1 * i**2, 3.0], w, 20))


def tracking():
    def make(i, weights):
        return GradientTracking(i, np.zeros(2), weights, lambda x: x - i, 0.05, 20)

    return team(GRAPH, make)


def largest():
    return {i: MaxConsensus(i, [float(i)], GRAPH.diameter()) for i in GRAPH.ids}


def talking(say):
    return {i: Talking(i, say) for i in GRAPH.ids}


def each_its_own(i, k):
    return PerNeighbor({j: [i, j, k] for j in GRAPH.neighbors(i)})


TEAMS = {
    "consensus": consensus,
    "gradient tracking": tracking,
    "maximum": largest,
    "nothing": lambda: talking(lambda i, k: None),
    "containers": lambda: talking(lambda i, k: [i, (k, "é"), {"x": np.arange(k)}]),
    "its own for each neighbour": lambda: talking(each_its_own),
    "no round": lambda: {i: Talking(i, lambda i, k: 0, 0) for i in GRAPH.ids},
}


def describe(history, agents):
    """Return all that a simulation tells, without its real times."""
    series = [
        (i, name, x.dtype.str, x.tobytes())
        for i, values in history.values.items()
        for name, x in values.items()
    ]
    times = [(i, times.tobytes()) for i, times in history.times.items()]
    traffic = (history.messages, history.lost, history.resent, history.bytes)
    heard = [getattr(agent, "heard", None) for agent in agents.values()]
    return series, times, traffic, history.simulated_s, heard


@pytest.mark.parametrize("name", TEAMS)
def test_the_short_way_tells_what_the_protocol_tells(name):
    short, long = TEAMS[name](), TEAMS[name]()
    found = describe(simulate(short, GRAPH), short)
    assert found == describe(simulate(long, GRAPH, run=run_by_protocol), long)


def fail_one(error):
    return {i: Failing(i, 2 if i == 5 else None, error) for i in GRAPH.ids}


def end_early():
    return {i: Talking(i, lambda i, k: k, 3 if i == 5 else 6) for i in GRAPH.ids}


ERRORS = {
    "an error of ours": (lambda: fail_one(ConfigError("a", 1, "b")), ConfigError),
    "any error": (lambda: fail_one(ValueError("broken")), AgentFailed),
    "sys.exit": (lambda: fail_one(SystemExit(3)), ConfigError),
    "an early end": (end_early, ChannelEnded),
    "nan": (lambda: talking(lambda i, k: float("nan") if i > 4 else k), AgentFailed),
    "no codec": (lambda: talking(lambda i, k: object() if i == 6 else k), ValueError),
    "a missing neighbour": (lambda: talking(lambda i, k: PerNeighbor({})), ValueError),
}


@pytest.mark.parametrize("name", ERRORS)
def test_the_short_way_fails_as_the_protocol_fails(name):
    make, kind = ERRORS[name]
    told = []
    made = []
    for run in (run_virtual, run_by_protocol):
        agents = make()
        with pytest.raises(kind) as caught:
            simulate(agents, GRAPH, run=run)
        told.append((type(caught.value), str(caught.value)))
        made.append([(agent.k, agent.heard) for agent in agents.values()])
    assert told[0] == told[1]
    assert made[0] == made[1]


def test_a_drone_alone_and_one_way_links_take_the_protocol(monkeypatch):
    monkeypatch.setattr(simulation, "LockstepTeam", None)
    one_way = Graph.from_edges(3, [(0, 1), (1, 2), (2, 0)], directed=True)
    for graph in (path(1), one_way):
        agents = {i: Talking(i, lambda i, k: k) for i in graph.ids}
        assert simulate(agents, graph).rounds == 5


def count_calls(function):
    """Return the number of calls of Python functions in a call of `function`."""
    calls = 0

    def note(frame, event, argument):
        nonlocal calls
        calls += event == "call"

    sys.setprofile(note)
    try:
        function()
    finally:
        sys.setprofile(None)
    return calls


def test_a_simulated_round_of_an_agent_takes_few_calls_above_its_algorithm():
    graph = ring(10)
    weights = metropolis(graph)

    def make(rounds):
        return {i: Consensus(i, [float(i)], weights[i], rounds) for i in graph.ids}

    def play(rounds):
        agents = make(rounds)
        return count_calls(lambda: simulate(agents, graph))

    def play_alone(rounds):
        agents = make(rounds)

        def loop():
            for _ in range(rounds):
                said = {i: agent.message() for i, agent in agents.items()}
                for i, agent in agents.items():
                    agent.step({j: said[j] for j in graph.neighbors(i)})

        return count_calls(loop)

    play(1)
    above = (play(60) - play(10)) - (play_alone(60) - play_alone(10))
    assert above / (50 * len(graph.ids)) <= MOST_CALLS
