"""How long a wait for a round takes, and when the round is sent again."""

import asyncio

import numpy as np
import pytest

from crazychoir.bus.impairment.model import Impairment
from crazychoir.bus.impairment.rules import ImpairmentRule
from crazychoir.bus.port import Bus
from crazychoir.runtime.clock import Clock, run_virtual
from crazychoir.team import graph as graphs
from crazychoir.team.communicator import Communicator
from crazychoir.team.expected_wait import RESEND_TIMES, ExpectedWait
from crazychoir.team.graph import Graph
from crazychoir.team.message_kind import (
    LATENESS_UNIT,
    MOST_LATENESS,
    flag_lateness,
    read_lateness,
)


def test_a_new_channel_resends_after_the_shortest_time():
    assert ExpectedWait().find_first_resend() == RESEND_TIMES.shortest


def test_long_rounds_are_learned():
    expected = ExpectedWait()
    for _ in range(30):
        expected.learn(0.3)
    assert 0.3 < expected.find_first_resend() < 0.4


def test_one_long_wait_is_not_learned():
    expected = ExpectedWait()
    expected.learn(60.0)
    assert expected.find_first_resend() < 5 * RESEND_TIMES.shortest


def test_resends_never_wait_longer_than_the_longest_time():
    expected = ExpectedWait()
    for _ in range(200):
        expected.learn(50.0)
    assert expected.find_first_resend() == RESEND_TIMES.longest_first
    assert expected.find_next_resend(1) == RESEND_TIMES.longest


def test_the_time_between_resends_doubles():
    expected = ExpectedWait()
    times = [expected.find_next_resend(attempt) for attempt in range(40)]
    assert times[0] == RESEND_TIMES.shortest
    assert times[RESEND_TIMES.attempts_a_time] == 2 * RESEND_TIMES.shortest
    assert times[-1] == RESEND_TIMES.longest


def test_losses_shorten_the_time_before_a_resend():
    expected = ExpectedWait()
    for _ in range(30):
        expected.learn(0.3)
    calm = expected.find_first_resend()
    expected.note_repeat(True)
    disturbed = expected.find_first_resend()
    for _ in range(3):
        expected.note_repeat(True)
    assert RESEND_TIMES.shortest == expected.find_first_resend() < disturbed < calm
    for _ in range(500):
        expected.note_repeat(False)
    assert expected.lost_share == 0.0
    assert expected.find_first_resend() == calm


@pytest.mark.parametrize("seconds", [0.0, 0.0039, 0.1, 0.777, 50.0])
def test_the_lateness_of_a_message_is_in_its_flags(seconds):
    read = read_lateness(flag_lateness(seconds))
    most = MOST_LATENESS * LATENESS_UNIT
    assert read == pytest.approx(min(seconds, most), abs=LATENESS_UNIT)


def exchange_rounds(
    graph: Graph, rule: dict[str, float], rounds: int, computation: float
) -> list[Communicator]:
    """Return the communicators of a team after so many rounds; a computation takes s, and varies."""

    async def agent(clock: Clock, c: Communicator) -> None:
        draws = np.random.default_rng(c.id)
        for _ in range(rounds):
            if computation > 0.0:
                await clock.sleep(computation * draws.gamma(10.0, 0.1))
            await c.neighbors_exchange(c.id)
        await c.close()

    async def main(clock: Clock) -> list[Communicator]:
        bus = Bus(clock, Impairment(1, [ImpairmentRule(rule)]))
        bus.impairment.begin(clock.now())
        team = [Communicator(bus.port(i), graph) for i in graph.ids]
        await asyncio.gather(*(agent(clock, c) for c in team))
        return team

    return run_virtual(main)


@pytest.mark.parametrize(
    ("delay", "computation"), [(0.002, 0.03), (0.002, 0.12), (0.02, 0.0)]
)
def test_a_network_without_losses_needs_hardly_a_repeat(delay, computation):
    graph = graphs.ring(6)
    rounds = 500
    team = exchange_rounds(graph, {"delay": delay}, rounds, computation)
    repeats = sum(c.port.counters.resent for c in team)
    assert repeats < 0.03 * rounds * 2 * 6


def test_waits_for_lost_messages_of_others_are_not_learned():
    """With few losses, nearly each wait contains the wait of another drone for a lost message."""
    team = exchange_rounds(
        graphs.ring(20), {"loss": 0.02, "delay": 0.001}, 300, computation=0.0
    )
    means = [c.open("main").wait.expected.mean for c in team]
    assert max(means) < 0.004
