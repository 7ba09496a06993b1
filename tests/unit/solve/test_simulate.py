"""Any algorithm on simulated agents: the network decides when, never what."""

import asyncio
import json
import time
from types import SimpleNamespace

import numpy as np
import pytest

from crazychoir.bus.impairment.model import Impairment
from crazychoir.bus.impairment.rules import ImpairmentRule
from crazychoir.bus.port import Bus
from crazychoir.errors import (
    AgentFailed,
    CodecError,
    ConfigError,
    RoundTimeout,
    SolverError,
)
from crazychoir.optimization.algorithms.consensus import Consensus
from crazychoir.optimization.algorithms.max_consensus import MaxConsensus
from crazychoir.optimization.assignment.bundles import SequentialAuction
from crazychoir.optimization.rounds.mixing import team
from crazychoir.optimization.rounds.stopping import LogicAnd, Settled, Until
from crazychoir.runtime.clock import run_virtual, run_wall
from crazychoir.solve.simulate import simulate
from crazychoir.team.algorithm_run import WakingTimes, run_algorithm
from crazychoir.team.communicator import Communicator
from crazychoir.team.graph import (
    Graph,
    GraphSequence,
    complete,
    erdos_renyi_connected,
    metropolis,
    path,
    ring,
    row_stochastic,
)
from crazychoir.types import PerNeighbor


class Counting:
    """Counts rounds; what it hears is the others' count."""

    def __init__(self, rounds):
        self.rounds, self.x, self.heard = rounds, 0, []

    @property
    def done(self):
        return self.x == self.rounds

    def message(self):
        return self.x

    def step(self, heard):
        self.heard.append(heard)
        self.x += 1


class Wakeful(Counting):
    """The same, whenever it wakes."""

    asynchronous = True


class Failing(Counting):
    """One of them cannot go on in round `at`, in `message` or in `step`."""

    def __init__(self, error, at, where, asynchronous=False):
        super().__init__(1000)
        self.error, self.at, self.where, self.asynchronous = (
            error,
            at,
            where,
            asynchronous,
        )

    def message(self):
        self._fail("message")
        return self.x

    def step(self, heard):
        self._fail("step")
        super().step(heard)

    def _fail(self, where):
        if where == self.where and self.x >= self.at:
            raise self.error


def averaging(graph, rounds=30):
    return team(graph, lambda i, w: Consensus(i, [i, 0.5 * i**2], w, rounds))


@pytest.mark.parametrize(
    "graph", [ring(6), GraphSequence.draw(erdos_renyi_connected(6, 0.6, 1), 0.4, 5, 2)]
)
def test_the_history_is_the_same_to_the_last_bit_at_40_percent_loss(graph):
    calm, lossy = (
        simulate(averaging(graph), graph, loss=loss, seed=3) for loss in (0.0, 0.4)
    )
    assert calm.of().shape == (6, 31, 2)
    assert calm.of().tobytes() == lossy.of().tobytes()
    assert (calm.lost, calm.resent) == (0, 0)
    assert lossy.lost == pytest.approx(0.4 * lossy.messages, rel=0.2)


def test_bursts_lose_other_messages_and_change_no_value():
    def run(**network):
        agents = {i: MaxConsensus(i, float(i), 40) for i in range(6)}
        return simulate(agents, ring(6), loss=0.3, network=network, seed=1)

    alone = run()
    bursts = run(burst=4.0)
    assert bursts.lost != alone.lost
    assert bursts.results == alone.results
    agents = {i: MaxConsensus(i, float(i), 2) for i in range(2)}
    with pytest.raises(ConfigError, match="burst: found 4 with loss 0"):
        simulate(agents, path(2), network={"burst": 4.0})


def test_it_repeats_with_the_same_seed():
    first, again, other = (
        simulate(averaging(ring(5)), ring(5), loss=0.4, seed=seed) for seed in (1, 1, 2)
    )
    timed = {"wall_s": 0.0, "critical_path_s": 0.0}
    assert first.to_json() | timed == again.to_json() | timed
    assert first.messages != other.messages


def test_endless_algorithms_stop_after_the_given_number_of_rounds():
    history = simulate(averaging(ring(4), None), ring(4), rounds=7)
    assert history.rounds == 7
    assert history.of().shape == (4, 8, 2)
    assert history.spread()[0] == pytest.approx(9 / 2 - 7 / 4)
    assert [len(history.times[i]) for i in range(4)] == [8] * 4


def test_it_counts_messages_bytes_and_computing():
    seen = []
    history = simulate(
        averaging(ring(4), 5),
        ring(4),
        watch=lambda agents: seen.append([a.k for a in agents.values()]),
    )
    assert seen[-1] == [5] * 4
    assert len(seen) == 4 * 5
    assert history.messages >= 4 * 2 * 5
    assert history.bytes >= 4 * 2 * 5 * 16
    assert 0.0 < history.critical_path_s < history.wall_s
    assert history.critical_path_s == pytest.approx(
        sum(max(history.cpu[i][k] for i in range(4)) for k in range(5))
    )


@pytest.mark.parametrize("loss", [0.0, 0.4])
def test_a_history_says_what_each_agent_had_sent_at_each_value(loss):
    links = path(3)
    history = simulate(averaging(links, 5), links, loss=loss)
    plain = simulate(averaging(links, 5), links).traffic
    for i, sent in history.traffic.items():
        assert sent.shape == (6, 2)
        rounds = np.arange(6)
        assert (plain[i][:, 0] == len(links.neighbors(i)) * rounds).all()
        assert (sent >= plain[i])[1:].all()
        assert (np.diff(sent, axis=0) >= 0).all()
    last = sum(sent[-1] for sent in history.traffic.values())
    assert last[0] <= history.messages
    assert last[1] <= history.bytes


def test_a_history_is_written_and_read(tmp_path):
    history = simulate(averaging(path(3), 4), path(3))
    for suffix in (".csv", ".json", ".npz"):
        history.save(tmp_path / f"out/history{suffix}")
    with np.load(tmp_path / "out/history.npz") as arrays:
        assert arrays["x_2"].tobytes() == history.values[2]["x"].tobytes()
        assert arrays["time_1"].shape == (5,)
    written = json.loads((tmp_path / "out/history.json").read_text())
    assert written["values"]["1"]["x"] == history.values[1]["x"].tolist()
    lines = (tmp_path / "out/history.csv").read_text().splitlines()
    assert lines[0] == "agent,round,time_s,x[0],x[1]"
    assert len(lines) == 1 + 3 * 5
    assert [float(v) for v in lines[-1].split(",")[3:]] == history.values[2]["x"][
        -1
    ].tolist()
    assert history.to_json()["agents"][2] == {"x": history.values[2]["x"][-1].tolist()}
    with pytest.raises(
        ConfigError,
        match=r"history.txt; allowed: a file that ends in .csv, .json, .npz",
    ):
        history.save(tmp_path / "history.txt")


def test_what_changes_its_shape_is_kept_as_a_list():
    class Growing(Counting):
        def step(self, heard):
            super().step(heard)
            self.basis = list(range(self.x))

    agents = {i: Growing(3) for i in range(2)}
    for agent in agents.values():
        agent.basis = []
    assert simulate(agents, path(2), record=("basis",)).values[0]["basis"] == [
        [],
        [0],
        [0, 1],
        [0, 1, 2],
    ]


def test_asynchronous_agents_wake_by_themselves_and_hear_what_has_come():
    agents = {i: Wakeful(40) for i in range(3)}
    history = simulate(
        agents, ring(3), loss=0.4, seed=5, sleep=(0.01, 0.03), compute=(0.002, 0.004)
    )
    gaps = np.diff(history.times[1])
    assert 0.0119 < gaps.min() < gaps.max() < 0.0341
    assert {len(heard) for agent in agents.values() for heard in agent.heard} == {
        0,
        1,
        2,
    }
    newest = [heard[1] for heard in agents[0].heard if 1 in heard]
    assert newest == sorted(newest)
    assert len(set(newest)) < 40
    assert history.rounds == 40
    assert history.resent == 0


def test_their_draws_are_their_own_and_repeat():
    runs = [
        simulate({i: Wakeful(9) for i in range(3)}, ring(3), seed=seed).times
        for seed in (1, 1, 2)
    ]
    assert runs[0][0].tolist() == runs[1][0].tolist() != runs[2][0].tolist()
    assert runs[0][0].tolist() != runs[0][1].tolist()


@pytest.mark.parametrize(
    "pace", [{"sleep": (0.0, 0.0)}, {"sleep": (0.02, 0.01)}, {"compute": (-1.0, 0.0)}]
)
def test_a_pace_that_is_none(pace):
    with pytest.raises(ConfigError, match=f"pace: {next(iter(pace))}"):
        WakingTimes(**pace)


@pytest.mark.real_time
def test_in_real_time_the_iterates_are_the_same():
    jumps, ticks = (
        simulate(averaging(ring(5)), ring(5), loss=0.3, run=run)
        for run in (run_virtual, run_wall)
    )
    assert jumps.of().tobytes() == ticks.of().tobytes()
    assert 0.03 <= jumps.times[0][-1] <= jumps.simulated_s < 5.0
    assert 0.03 <= ticks.times[0][-1] <= ticks.simulated_s < 60.0
    awake = {i: Wakeful(20) for i in range(3)}
    simulate(awake, ring(3), loss=0.3, run=run_wall)
    assert [agent.x for agent in awake.values()] == [20] * 3


# Failures -----------------------------------------------------------------------------------------------------------


def ends(graph, error, where, loss, asynchronous=False, run=run_virtual):
    """What each agent ends with if agent 2 fails, the s until the last has ended, and the steps that each made."""
    steps = {}

    async def part(communicator):
        algorithm = steps[communicator.id] = Failing(
            error, 5 if communicator.id == 2 else 2000, where, asynchronous
        )
        try:
            await run_algorithm(communicator, algorithm)
        except Exception as raised:  # noqa: BLE001 - what it is is what the test looks at
            return raised

    async def main(clock):
        bus = Bus(clock, Impairment(1, [ImpairmentRule({"loss": loss})]))
        team = [Communicator(bus.port(i), graph) for i in graph.ids]
        return await asyncio.gather(*map(part, team)), clock.now()

    found, seconds = run(main)
    return (
        dict(zip(graph.ids, found, strict=True)),
        seconds,
        {i: algorithm.x for i, algorithm in steps.items()},
    )


SEQUENCE = GraphSequence.draw(ring(6), 0.3, 7, 4)


@pytest.mark.parametrize("where", ["message", "step"])
@pytest.mark.parametrize("loss", [0.0, 0.5])
@pytest.mark.parametrize(
    "graph", [path(6), ring(6), ring(6, directed=True), complete(6), SEQUENCE]
)
def test_where_one_agent_fails_all_end_with_its_reason(graph, loss, where):
    error = SolverError("agent 2: local problem, row 3", "infeasible, b = -1")
    found, seconds, steps = ends(graph, error, where, loss)
    assert found.pop(2) is error
    for other in found.values():
        assert type(other) is AgentFailed
        assert other.agent == 2
        assert (
            "SolverError: agent 2: local problem, row 3: the solver ended with status infeasible"
            in str(other)
        )
    assert seconds < 12.0
    assert max(steps.values()) <= 6 + (
        graph.diameter() if graph is not SEQUENCE else 7 * 3
    )


@pytest.mark.parametrize("loss", [0.0, 0.5])
def test_where_an_asynchronous_agent_fails_all_end_with_its_reason(loss):
    error = ConfigError("agent 2: gradient[0]", "nan", "finite numbers")
    found, seconds, _ = ends(ring(6), error, "step", loss, asynchronous=True)
    assert found.pop(2) is error
    assert {(type(other), other.agent) for other in found.values()} == {
        (AgentFailed, 2)
    }
    assert all("gradient[0]" in str(other) for other in found.values())
    assert seconds < 5.0


def test_an_error_that_is_none_of_ours_is_named_and_chained():
    found, _, _ = ends(path(4), KeyError("weights"), "step", 0.3)
    assert {type(error) for error in found.values()} == {AgentFailed}
    assert found[0].args == found[2].args
    assert "KeyError: 'weights'" in str(found[0])
    assert type(found[2].__cause__) is KeyError


@pytest.mark.parametrize("asynchronous", [False, True])
@pytest.mark.parametrize(
    ("message", "error"),
    [
        (object(), "value: found a object"),
        (PerNeighbor({1: 0}), r"a PerNeighbor of \[1\] has nothing for drone\(s\) \["),
    ],
)
def test_a_message_that_cannot_be_sent_ends_all_too(message, error, asynchronous):
    class Mute(Counting):
        def message(self):
            return message if self.x >= 3 else self.x

    agents = {i: Mute(1000) if i == 2 else Counting(1000) for i in range(5)}
    for agent in agents.values():
        agent.asynchronous = asynchronous
    with pytest.raises(
        CodecError, match=rf"^agent 2: message\(\), round [23]: .*{error}"
    ):
        simulate(agents, path(5), loss=0.3)
    assert all(agent.x < 50 for agent in agents.values())


@pytest.mark.real_time
def test_they_end_in_real_time_too():
    began = time.perf_counter()
    found, _, _ = ends(
        ring(6), SolverError("agent 2", "unbounded"), "step", 0.3, run=run_wall
    )
    assert [type(found[i]) for i in range(6)] == [
        AgentFailed,
        AgentFailed,
        SolverError,
        *[AgentFailed] * 3,
    ]
    assert time.perf_counter() - began < 10.0


class Spoilt(Counting):
    """Agent 2 sends a nan in round 4, and is one from step 6 on; `deep` as a part of a message."""

    def __init__(self, i, where, deep=False):
        super().__init__(50)
        self.i, self.where, self.deep, self.y = i, where, deep, np.zeros(2)

    def message(self):
        y = (
            np.array([0.0, np.nan])
            if self.where == "message" and (self.i, self.x) == (2, 4)
            else self.y
        )
        return {"k": self.x, "more": [None, (1, y)]} if self.deep else y

    def step(self, heard):
        super().step(heard)
        if self.where == "step" and (self.i, self.x) == (2, 7):
            self.y = np.array([np.inf, np.nan])


@pytest.mark.parametrize("asynchronous", [False, True])
@pytest.mark.parametrize(
    ("where", "deep", "said"),
    [
        ("message", False, r"round 4: nan in message\(\)\[1\]\."),
        ("message", True, r"round 4: nan in message\(\)\['more'\]\[1\]\[1\]\[1\]\."),
        ("step", True, r"round 6: nan in y\[1\]\."),
    ],
)
def test_an_agent_with_invalid_numbers_has_failed(where, deep, said, asynchronous):
    agents = {i: Spoilt(i, where, deep) for i in range(5)}
    for agent in agents.values():
        agent.asynchronous = asynchronous
    with pytest.raises(
        AgentFailed, match=rf"^agent 2 has failed, and with it the team: {said}"
    ) as caught:
        simulate(agents, ring(5), loss=0.3, record=("y",))
    assert caught.value.agent == 2


def test_an_infinity_may_be_meant():
    class Most(Counting):
        def step(self, heard):
            self.most = max(self.most, *heard.values())
            super().step(heard)

        def message(self):
            return self.most

    agents = {i: Most(3) for i in range(5)}
    for i, agent in agents.items():
        agent.most = float(i) if i == 3 else -np.inf
    history = simulate(agents, ring(5), rounds=1, record=("most",))
    assert history.last("most") == {0: -np.inf, 1: -np.inf, 2: 3.0, 3: 3.0, 4: 3.0}
    assert history.disagreement("most") == np.inf


def test_numbers_however_large_are_numbers():
    huge = {
        i: Consensus(i, [1e300 * (i + 1), -1e308], row, 20)
        for i, row in metropolis(ring(5)).items()
    }
    assert np.isfinite(simulate(huge, ring(5)).of()).all()


def test_a_simulation_names_no_command_that_looks_at_flights():
    with pytest.raises(
        RoundTimeout, match="Lower the loss of the simulated network"
    ) as caught:
        simulate(averaging(ring(5)), ring(5), loss=1.0)
    assert "status" not in str(caught.value)
    assert caught.value.missing == (1, 4)


def test_a_simulation_raises_what_the_failing_agent_raised():
    agents = {
        i: Failing(
            SolverError("agent 2: row 1", "b = nan"), 3 if i == 2 else 99, "step"
        )
        for i in range(5)
    }
    with pytest.raises(SolverError, match="agent 2: row 1"):
        simulate(agents, ring(5), loss=0.4)


# What does not fit --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("change", "error"),
    [
        (
            {"graph": ring(7)},
            r"team: found agents 0 to 4; allowed: one for each node of the graph, 0 to 6",
        ),
        (
            {"graph": path(5)},
            r"agent 0: weights, round 0: found of \[1, 4\]; allowed: of the agents it hears, \[1\]",
        ),
        ({"loss": 1.5}, "loss"),
        ({"network": {"los": 0.1}}, "los"),
        (
            {"record": ("x", "y")},
            "record: found y; allowed: attributes of agent 0, a Consensus",
        ),
    ],
)
def test_what_does_not_fit_is_refused(change, error):
    with pytest.raises(ConfigError, match=error):
        simulate(averaging(ring(5)), **({"graph": ring(5)} | change))


def test_a_team_in_two_parts_is_refused():
    parts = Graph.from_edges(5, [(0, 1), (1, 2), (3, 4)])
    with pytest.raises(
        ConfigError, match=r"graph of Consensus: found no path from agent 0 to \[3, 4\]"
    ):
        simulate(averaging(parts), parts)
    one_way = Graph.from_edges(3, [(0, 1), (1, 2)], directed=True)
    with pytest.raises(ConfigError, match=r"no path from \[1, 2\] to agent 0"):
        simulate(
            team(one_way, lambda i, w: Consensus(i, [1.0], w, 3), row_stochastic),
            one_way,
        )


def test_agents_of_two_shapes_are_refused():
    agents = team(ring(3), lambda i, w: Consensus(i, np.ones(2 + (i == 1)), w, 3))
    with pytest.raises(
        ConfigError,
        match=r"agent 1: x: found shape \(3,\); allowed: shape \(2,\), as agent 0's",
    ):
        simulate(agents, ring(3))


def test_until_stops_all_in_one_round_with_any_kind_of_message():
    class ToEach(Counting):
        def message(self):
            return PerNeighbor({j: [j, self.x] for j in ring(6).neighbors(self.i)})

        def step(self, heard):
            assert all(mine == self.i for mine, _ in heard.values())
            super().step(heard)

    agents = {}
    for i in range(6):
        inner = ToEach(1000)
        inner.i = i
        agents[i] = Until(
            inner, lambda agent: agent.x >= 10 + agent.i, ring(6).diameter()
        )
    history = simulate(agents, ring(6), loss=0.4)
    assert history.last() == dict.fromkeys(range(6), 15 + 3)


def test_until_stops_asynchronous_agents_when_each_was_ready():
    graph = path(4)
    agents = {
        i: Until(Wakeful(10_000), lambda agent: agent.x > 20, 3, graph.neighbors(i))
        for i in graph.ids
    }
    history = simulate(agents, graph, loss=0.4, seed=2)
    assert all(21 < last < 200 for last in history.last().values())


def test_settled_consensus_ends_near_the_mean():
    graph = ring(6)
    agents = team(
        graph, lambda i, w: Until(Consensus(i, i, w), Settled(1e-9), graph.diameter())
    )
    history = simulate(agents, graph, loss=0.3)
    assert history.of()[:, -1] == pytest.approx(2.5, abs=1e-7)
    assert history.spread()[-1] > 0.0


def test_the_end_of_a_channel_costs_each_edge_some_messages_however_dense_the_graph():
    graph, rounds = complete(20), 5
    rows = row_stochastic(graph)
    agents = {i: Consensus(i, [float(i)], rows[i], rounds=rounds) for i in graph.ids}
    history = simulate(agents, graph, loss=0.1, seed=1)
    assert history.messages - history.resent < (rounds + 12) * len(graph.arcs)


@pytest.mark.parametrize(
    "make",
    [
        lambda i: MaxConsensus(i, float(i), 2),
        lambda i: LogicAnd(2, flag=i > 0),
        lambda i: Until(Counting(9), Settled(0.0), 2),
        lambda i: SequentialAuction(
            i, SimpleNamespace(start=(), scores=lambda path: []), 0, 2
        ),
    ],
)
@pytest.mark.parametrize(
    "graph",
    [ring(6), GraphSequence((path(6), path(6), complete(6)))],
    ids=["ring", "sequence"],
)
def test_a_diameter_below_the_graphs_is_refused(make, graph):
    # as such agents would stop before they have heard of all, and hold different values
    with pytest.raises(ConfigError, match=r"diameter: found 2; allowed: at least 3"):
        simulate({i: make(i) for i in graph.ids}, graph)


def test_a_flag_of_a_team_in_two_parts_is_refused():
    with pytest.raises(ConfigError, match="no path from agent 0 to"):
        simulate(
            {i: LogicAnd(5, flag=i < 2) for i in range(4)},
            Graph.from_edges(4, [(0, 1), (2, 3)]),
        )


class Growing(Counting):
    """Has `one` more entry each round, and `own` entries as many as its id says."""

    def __init__(self, i):
        super().__init__(2)
        self.own, self.one = np.ones(i + 1), np.zeros(0)

    def step(self, heard):
        super().step(heard)
        self.one = np.arange(self.x)


@pytest.mark.parametrize(
    ("violations", "largest"),
    [
        ((0.5, 2.0), 2.0),
        ((np.array([0.1, 3.0]), 0), 3.0),
        ((None, 0.2), 0.2),
        ((np.zeros(0), "no"), 0.0),
        ((max, ""), None),
    ],
)
def test_the_largest_violation_ignores_agents_without_a_number(violations, largest):
    agents = {i: Counting(1) for i in range(2)}
    for i, violation in enumerate(violations):
        agents[i].violation, agents[i].common = violation, False
    history = simulate(agents, ring(2))
    assert history.violation == largest
    assert history.disagreement() is None


def test_what_differs_in_shape_has_its_columns_and_no_npz(tmp_path):
    history = simulate(
        {i: Growing(i) for i in range(2)}, ring(2), record=("one", "own")
    )
    history.save(tmp_path / "h.csv")
    lines = [line.split(",") for line in (tmp_path / "h.csv").read_text().splitlines()]
    assert lines[0] == [
        "agent",
        "round",
        "time_s",
        "one[0]",
        "one[1]",
        "own[0]",
        "own[1]",
    ]
    assert [line[3:] for line in lines[1:4]] == [
        ["", "", "1.0", ""],
        ["0", "", "1.0", ""],
        ["0", "1", "1.0", ""],
    ]
    assert lines[-1][3:] == ["0", "1", "1.0", "1.0"]
    with pytest.raises(
        ConfigError, match=r"history: one_0: found a shape that changes"
    ):
        history.save(tmp_path / "h.npz")


def test_what_is_no_array_cannot_be_recorded():
    agents = {0: Counting(1)}
    agents[0].x = [[1.0], [1.0, 2.0]]
    with pytest.raises(ConfigError, match=r"record = x: .*of agent 0, a Counting"):
        simulate(agents, Graph.from_edges(1, []))
