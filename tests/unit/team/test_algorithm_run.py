"""An algorithm that cannot go on at one agent soon ends at all agents; each names that agent and the reason."""

import asyncio

import numpy as np
import pytest

from crazychoir.bus import codec
from crazychoir.bus.impairment.model import Impairment
from crazychoir.bus.impairment.rules import ImpairmentRule
from crazychoir.bus.port import Bus
from crazychoir.errors import (
    AgentFailed,
    ChannelEnded,
    CodecError,
    PeerLost,
    SolverError,
)
from crazychoir.optimization.algorithms import asymm
from crazychoir.optimization.algorithms.asymm import ASYMM
from crazychoir.optimization.algorithms.resilient.trimming import WMSR
from crazychoir.optimization.problems.smooth import SmoothFunction, SmoothProblem
from crazychoir.runtime.clock import run_virtual
from crazychoir.team.algorithm_run import WakingTimes, run_algorithm
from crazychoir.team.communicator import Communicator
from crazychoir.team.graph import complete, path, ring
from crazychoir.types import Failure

GIBBERISH = object()
"""Stands for a message with bytes that do not decode."""


class Counting:
    """So many rounds; in one of them it may fail."""

    def __init__(self, rounds, fails_at=-1, asynchronous=False):
        self.rounds, self.fails_at, self.asynchronous, self.k = (
            rounds,
            fails_at,
            asynchronous,
            0,
        )

    @property
    def done(self):
        return self.k >= self.rounds

    def message(self):
        return self.k

    def step(self, heard):
        if self.k == self.fails_at:
            raise SolverError("its local problem, row 1", "infeasible, b = -1")
        self.k += 1


class Missing:
    """The membership after some s: these are lost."""

    def __init__(self, clock, ids, since):
        self.clock, self.ids, self.since = clock, ids, since

    def is_lost(self, j):
        return j in self.ids and self.clock.now() > self.since


def endings(agents, graph, loss=0.0, lost=(), seed=1, pace=None, **options):
    """What each of `agents` ends with, None if with nothing, and the s until the last has; others never begin."""

    async def part(communicator, algorithm, ends):
        try:
            await run_algorithm(communicator, algorithm, pace=pace, **options)
            if not getattr(algorithm, "asynchronous", False):
                await communicator.close()
        except Exception as error:  # noqa: BLE001 - what it is is what the tests look at
            ends[communicator.id] = error

    async def main(clock):
        bus, ends = (
            Bus(
                clock,
                Impairment(seed, [ImpairmentRule({"loss": loss, "delay": 0.001})]),
            ),
            dict.fromkeys(agents),
        )
        membership = Missing(clock, lost, 1.0)
        members = {i: Communicator(bus.port(i), graph, membership) for i in graph.ids}
        await asyncio.gather(
            *(part(members[i], agent, ends) for i, agent in agents.items())
        )
        return ends, clock.now()

    return run_virtual(main)


@pytest.mark.parametrize("loss", [0.0, 0.4])
@pytest.mark.parametrize("graph", [path(6), ring(6, directed=True)])
def test_a_lost_agent_is_named_at_all_others_long_before_the_deadline(graph, loss):
    found, seconds = endings(
        {i: Counting(99) for i in range(5)}, graph, loss, lost=(5,)
    )
    assert isinstance(found.pop(graph.out_neighbors(5)[0]), PeerLost)
    assert {(type(error), error.agent) for error in found.values()} == {
        (AgentFailed, 5)
    }
    assert seconds < 8.0


def test_an_agent_that_ends_in_an_earlier_round_is_named_at_all_others():
    agents = {i: Counting(3 if i == 0 else 9) for i in range(5)}
    found, seconds = endings(agents, path(5), loss=0.3)
    assert found.pop(0) is None
    assert isinstance(found.pop(1), ChannelEnded)
    assert {(type(error), error.agent) for error in found.values()} == {
        (AgentFailed, 0)
    }
    assert seconds < 10.0


@pytest.mark.parametrize("loss", [0.0, 0.4])
def test_an_asynchronous_agent_that_fails_while_others_say_their_last_words_ends_these_too(
    loss,
):
    agents = {
        i: Counting(30, 29 if i == 2 else -1, asynchronous=True) for i in range(4)
    }
    found, _ = endings(agents, complete(4), loss, pace=WakingTimes((0.01, 0.02)))
    assert isinstance(found.pop(2), SolverError)
    assert {(type(error), error.agent) for error in found.values()} == {
        (AgentFailed, 2)
    }


class Gabbling(WMSR):
    """A liar with messages that do not decode."""

    def message(self):
        return GIBBERISH


def send_gibberish(monkeypatch):
    def encode(data):
        return b"\xff" if data is GIBBERISH else codec.encode(data)

    monkeypatch.setattr("crazychoir.team.round_sender.encode", encode)


@pytest.mark.parametrize("loss", [0.0, 0.4])
def test_honest_agents_agree_although_messages_of_a_liar_do_not_decode(
    loss, monkeypatch
):
    send_gibberish(monkeypatch)
    agents = {i: WMSR(i, [float(i)], 1, 40) for i in range(4)}
    agents[4] = Gabbling(4, [0.0], 1, 40)
    found, _ = endings(agents, complete(5), loss)
    assert set(found.values()) == {None}
    x = [float(agents[i].x[0]) for i in range(4)]
    assert max(x) - min(x) < 1e-9
    assert 0.0 <= min(x) <= max(x) <= 3.0


def test_a_message_that_does_not_decode_ends_an_algorithm_that_expects_no_liars(
    monkeypatch,
):
    send_gibberish(monkeypatch)
    agents = {i: Counting(9) for i in range(2)}
    agents[2] = Gabbling(2, [0.0], 0, 9)
    found, _ = endings(agents, complete(3))
    assert isinstance(found[0], CodecError)


# Coroutines that exchange by themselves ---------------------------------------------------------------------------


def exchanging(graph, loss, policy="raise"):
    """Return what each agent ends with, and the s until the last has ended.

    Each agent exchanges in a loop of its own. Agent 2 raises and says so; an agent that hears it hands it on.
    """

    async def part(communicator):
        try:
            for k in range(40):
                if communicator.id == 2 and k == 5:
                    raise ValueError("my own trouble")
                await communicator.neighbors_exchange(k, deadline=3.0, policy=policy)
        except Exception as error:  # noqa: BLE001 - what it is is what the tests look at
            word = (
                (error.agent, error.reason)
                if isinstance(error, AgentFailed)
                else (communicator.id, str(error))
            )
            await communicator.fail(Failure(*word))
            return error

    async def main(clock):
        bus = Bus(
            clock, Impairment(1, [ImpairmentRule({"loss": loss, "delay": 0.001})])
        )
        return await asyncio.gather(
            *(part(Communicator(bus.port(i), graph)) for i in graph.ids)
        ), clock.now()

    return run_virtual(main)


@pytest.mark.parametrize("loss", [0.0, 0.4])
@pytest.mark.parametrize("graph", [path(6), ring(6, directed=True), complete(6)])
def test_an_agent_that_reports_its_failure_is_not_waited_for(graph, loss):
    found, seconds = exchanging(graph, loss)
    assert isinstance(found.pop(2), ValueError)
    assert {(type(error), error.agent, error.reason) for error in found} == {
        (AgentFailed, 2, "my own trouble")
    }
    assert seconds < 2.5


def test_a_partial_exchange_goes_on_without_the_failed_agent():
    found, _ = exchanging(path(4), 0.0, policy="partial")
    assert [type(error) for error in found] == [
        type(None),
        type(None),
        ValueError,
        type(None),
    ]


# The asynchronous method of multipliers: its agents wait for each other -------------------------------------------


def contradictory(graph):
    """x <= -1 and x >= 1, at two agents."""
    rows = {
        2: SmoothFunction(lambda x: x + 1.0, lambda x: np.eye(1)),
        4: SmoothFunction(lambda x: 1.0 - x, lambda x: -np.eye(1)),
    }
    return {
        i: ASYMM(
            i,
            graph.neighbors(i),
            graph.diameter(),
            [1.0 * i],
            SmoothProblem(
                SmoothFunction(
                    lambda x, i=i: (x[0] - i) ** 2, lambda x, i=i: 2.0 * (x - i)
                ),
                inequalities=rows.get(i),
            ),
        )
        for i in graph.ids
    }


@pytest.mark.parametrize("seed", [0, pytest.param(1, marks=pytest.mark.slow)])
def test_no_agent_is_done_while_another_may_still_fail(seed):
    graph = path(5)
    found, seconds = endings(
        contradictory(graph), graph, loss=0.4, seed=seed, pace=WakingTimes(seed=seed)
    )
    assert None not in found.values()
    assert any(isinstance(error, SolverError) for error in found.values())
    for error in found.values():
        assert "from that of agent" in str(error)
        assert "after 25 epochs" in str(error)
    assert seconds < 300.0


BOWL = SmoothFunction(lambda x: x @ x, lambda x: 2 * x)


def multipliers(graph, function=BOWL):
    return {
        i: ASYMM(
            i, graph.neighbors(i), graph.diameter(), [1.0], SmoothProblem(function)
        )
        for i in graph.ids
    }


def test_an_agent_that_waits_for_a_lost_neighbour_ends_all():
    graph = path(4)
    agents = multipliers(graph)
    del agents[3]
    found, seconds = endings(agents, graph, loss=0.3, lost=(3,))
    assert isinstance(found.pop(2), PeerLost)
    assert {(type(error), error.agent) for error in found.values()} == {
        (AgentFailed, 3)
    }
    assert seconds < 8.0


def test_a_cost_without_a_minimum_is_named_after_so_many_steps(monkeypatch):
    """f_i(x) = -20 x: no coupling holds the team back."""
    monkeypatch.setattr(asymm, "MOST_STEPS", 200)
    graph = path(3)
    fall = SmoothFunction(lambda x: -20.0 * x[0], lambda x: np.array([-20.0]))
    found, _ = endings(multipliers(graph, fall), graph)
    assert any(isinstance(error, SolverError) for error in found.values())
    assert all(
        "epoch 0: |grad L| = " in str(error) and "steps, at x = [" in str(error)
        for error in found.values()
    )


class Hearing(Counting):
    """Fails as soon as it hears all, if it sends such; each sends what it is told to."""

    def __init__(self, sends, asynchronous):
        super().__init__(99, asynchronous=asynchronous)
        self.sends = sends

    def message(self):
        return self.sends

    def step(self, heard):
        if len(heard) == 7 and type(self.sends) in (int, list):
            raise KeyError("x")


@pytest.mark.parametrize("asynchronous", [False, True])
def test_what_a_failing_step_had_heard_is_told_the_rarest_first(asynchronous):
    sent = [0, np.zeros((2, 3)), np.zeros((2, 3)), *[np.zeros(2, bool)] * 3, None, 1.5]
    found, _ = endings(
        {i: Hearing(sends, asynchronous) for i, sends in enumerate(sent)}, complete(8)
    )
    said = "None from 6, float from 7, float64 (2, 3) from 1, 2, bool (2,) from 3, 4, 5"
    assert any(
        str(error).endswith(f"); it had heard {said}") for error in found.values()
    )


def test_some_of_many_senders_are_told():
    found, _ = endings({i: Hearing([[i]], False) for i in range(8)}, complete(8))
    assert str(found[0]).endswith("; it had heard list of 1 from 1, 2, 3, 4 and 3 more")
