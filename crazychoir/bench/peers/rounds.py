"""Our program: agents of a process run a distributed algorithm; Zenoh connects the processes."""

import asyncio
from collections.abc import Mapping
from typing import Any

from crazychoir.bench.peers.crazychoir_peer import start
from crazychoir.bench.peers.optimization import algorithm
from crazychoir.bench.peers.peers import specification
from crazychoir.bus.port import Bus
from crazychoir.runtime.clock import Clock, run_wall
from crazychoir.team.algorithm_run import run_algorithm
from crazychoir.team.communicator import Communicator
from crazychoir.team.graph import Graph


class CountedAlgorithm:
    """An algorithm that counts its rounds and never ends."""

    done = False

    def __init__(self, agent: Any, i: int, rounds: dict[int, int]) -> None:
        self.agent = agent
        self.i = i
        self.rounds = rounds
        self.heavy = getattr(agent, "heavy", False)
        self.message = agent.message

    def step(self, heard: Mapping[int, Any]) -> None:
        """Run one round and count it."""
        self.agent.step(heard)
        self.rounds[self.i] += 1


async def main(clock: Clock) -> None:
    """Join, wait for go, and run until killed."""
    spec: dict[str, Any] = specification()
    neighbors = spec["neighbors"]
    bus = Bus(clock, process=spec["process"], host="bench")
    team = Graph.from_neighbors(neighbors)
    rounds = dict.fromkeys(spec["mine"], 0)
    agents = {
        i: CountedAlgorithm(algorithm(spec["algorithm"], neighbors, i), i, rounds)
        for i in spec["mine"]
    }
    members = {i: Communicator(bus.port(i), team) for i in spec["mine"]}
    async with asyncio.TaskGroup() as group:
        await start(group, bus, team, spec, rounds)
        for i, agent in agents.items():
            group.create_task(run_algorithm(members[i], agent))


if __name__ == "__main__":
    run_wall(main)
