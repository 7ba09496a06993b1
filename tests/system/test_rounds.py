"""Teams that form, exchange and change, on both clocks: the whole of bus and swarm in one process."""

import asyncio
from typing import Any

import numpy as np
import pytest

from crazychoir.bus.impairment.model import Impairment
from crazychoir.bus.impairment.rules import ImpairmentRule, NetworkPartition
from crazychoir.bus.port import Bus
from crazychoir.runtime.clock import Clock, run_virtual, run_wall
from crazychoir.team import graph as graphs
from crazychoir.team.algorithm_run import run_algorithm
from crazychoir.team.barrier import AgreedMission, Barrier
from crazychoir.team.communicator import Communicator
from crazychoir.team.graph import Graph, metropolis

pytestmark = pytest.mark.system
LOSSY = [
    ImpairmentRule(
        {
            "loss": 0.5,
            "delay": 0.001,
            "jitter": 0.004,
            "duplicate": 0.2,
            "reorder": 0.2,
            "reorder_delay": 0.01,
        }
    )
]


class Consensus:
    """x_i <- sum_j w_ij x_j, for K rounds."""

    heavy = True

    def __init__(self, i: int, graph: Graph, rounds: int) -> None:
        self.i, self.w, self.left = i, metropolis(graph)[i], rounds
        self.x = np.cos(np.arange(6.0) + i)

    @property
    def done(self) -> bool:
        return self.left == 0

    def message(self) -> Any:
        return self.x

    def step(self, heard: dict[int, Any]) -> None:
        self.x = self.w[self.i] * self.x + sum(self.w[j] * x for j, x in heard.items())
        self.left -= 1


def mission(graph: Graph, impairment: Impairment, rounds: int) -> Any:
    """Form the team, run consensus, close; returns the bytes of each drone's answer."""

    async def main(clock: Clock) -> list[bytes]:
        bus = Bus(clock, impairment)
        barriers = [
            Barrier(bus.port(i), graph, AgreedMission("m", "1")) for i in graph.ids
        ]
        watching = [
            asyncio.ensure_future(barrier.monitor.run()) for barrier in barriers
        ]

        async def agent(barrier: Barrier) -> bytes:
            communicator = Communicator(barrier.port, graph)
            communicator.exchange.follow(barrier)
            await barrier.go()
            algorithm = Consensus(barrier.id, graph, rounds)
            await run_algorithm(communicator, algorithm)
            await communicator.close()
            return algorithm.x.tobytes()

        try:
            roster, *answers = await asyncio.gather(
                barriers[0].go(), *map(agent, barriers)
            )
            assert roster.graph == graph
        finally:
            for task in watching:
                task.cancel()
        return answers

    return main


def in_a_loop(graph: Graph, rounds: int) -> list[bytes]:
    team = {i: Consensus(i, graph, rounds) for i in graph.ids}
    for _ in range(rounds):
        x = {i: agent.message() for i, agent in team.items()}
        for i, agent in team.items():
            agent.step({j: x[j] for j in graph.in_neighbors(i)})
    return [agent.x.tobytes() for agent in team.values()]


@pytest.mark.parametrize("n", [6, 30])
def test_a_bad_network_in_virtual_time(n):
    graph = graphs.k_regular(n, 4)
    impairment = Impairment(3, LOSSY, [NetworkPartition(4.0, 5.5, (0, 1, 2))])
    assert run_virtual(mission(graph, impairment, 100)) == in_a_loop(graph, 100)


@pytest.mark.real_time
def test_a_bad_network_in_real_time():
    graph = graphs.ring(6)
    assert run_wall(mission(graph, Impairment(3, LOSSY), 30)) == in_a_loop(graph, 30)


@pytest.mark.real_time
def test_a_good_network_in_real_time_needs_no_resends():
    graph, resent = graphs.ring(10), []

    async def main(clock: Clock) -> list[bytes]:
        bus = Bus(clock)
        team = [Communicator(bus.port(i), graph) for i in graph.ids]
        agents = [Consensus(i, graph, 200) for i in graph.ids]
        for agent in agents:
            agent.heavy = False  # type: ignore[misc]
        await asyncio.gather(
            *(run_algorithm(c, agent) for c, agent in zip(team, agents, strict=True))
        )
        resent.extend(c.port.counters.resent for c in team)
        return [agent.x.tobytes() for agent in agents]

    assert run_wall(main) == in_a_loop(graph, 200)
    assert sum(resent) < 200
