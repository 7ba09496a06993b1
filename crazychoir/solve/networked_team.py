"""A simulated team that exchanges its messages over the communicator and a simulated network."""

import asyncio
from collections.abc import Callable, Mapping
from typing import Any

from crazychoir.bus.impairment.model import Impairment
from crazychoir.bus.port import Bus, Counters
from crazychoir.errors import CrazyChoirError
from crazychoir.runtime.clock import Clock
from crazychoir.solve.followed_agent import FollowedAgent
from crazychoir.team.algorithm_run import WakingTimes, run_algorithm
from crazychoir.team.communicator import Communicator
from crazychoir.team.graph import Graph, GraphSequence

Run = Callable[[Callable[[Clock], Any]], Any]
"""run_virtual or run_wall."""


class NetworkedTeam:
    """Agents that run their algorithm over a bus of their own.

    agents: {id: agent}
    graph: communication graph, or a sequence of graphs
    channel: name of the channel of the messages
    pace: times at which asynchronous agents wake
    network: the simulated network
    run: runs a coroutine to its end, in virtual or in real time

    Attributes:
    errors: {id: error} of the agents that have failed or have ended with another
    """

    def __init__(
        self,
        agents: Mapping[int, FollowedAgent],
        graph: Graph | GraphSequence,
        channel: str,
        pace: WakingTimes,
        network: Impairment,
        run: Run,
    ) -> None:
        self._agents = agents
        self._graph = graph
        self._channel = channel
        self._pace = pace
        self._network = network
        self._run = run
        self._bus: Bus | None = None
        self.errors: dict[int, CrazyChoirError] = {}

    @property
    def has_begun(self) -> bool:
        """True when all agents have their first values."""
        return self._bus is not None

    @property
    def counters(self) -> list[Counters]:
        """Counts of the messages of each agent."""
        return (
            [] if self._bus is None else [p.counters for p in self._bus.ports.values()]
        )

    def run(self) -> float:
        """Run all agents until each is done; return the time of the simulation, s.

        Raises the first error of an agent that is not a CrazyChoirError.
        """
        try:
            return float(self._run(self._main))
        except BaseExceptionGroup as errors:
            raise errors.exceptions[0] from errors

    async def _main(self, clock: Clock) -> float:
        bus = Bus(clock, self._network)
        start = clock.now()
        ports = {i: bus.port(i) for i in self._agents}
        for i, agent in self._agents.items():
            agent.begin(clock.now, ports[i].counters)
        self._bus = bus
        communicators = {i: Communicator(ports[i], self._graph) for i in self._agents}
        async with asyncio.TaskGroup() as group:
            for i, agent in self._agents.items():
                group.create_task(
                    self._run_agent(communicators[i], agent), name=f"agent {i}"
                )
        return clock.now() - start

    async def _run_agent(
        self, communicator: Communicator, agent: FollowedAgent
    ) -> None:
        channel = self._channel
        try:
            await run_algorithm(communicator, agent, channel=channel, pace=self._pace)
            if not agent.asynchronous:
                await communicator.close(channel)
        except CrazyChoirError as error:  # the other agents are informed, and end too
            self.errors[communicator.id] = error
