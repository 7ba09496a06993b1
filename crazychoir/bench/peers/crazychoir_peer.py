"""Our program: drones of a process use `neighbors_exchange`; sockets connect the processes."""

import asyncio
from collections.abc import Callable
from typing import Any

import numpy as np

from crazychoir.bench.peers.peers import report, say, specification, wait_for_go
from crazychoir.bus.network.hello_review import Introduction
from crazychoir.bus.network.zenoh_link import ZenohLink
from crazychoir.bus.network.zenoh_session import SessionEndpoints
from crazychoir.bus.port import Bus
from crazychoir.launch.joining import wait_until_joined
from crazychoir.runtime.clock import Clock, run_wall
from crazychoir.team.communicator import Communicator
from crazychoir.team.graph import Graph

EXCHANGE_DEADLINE = 60.0  # s


async def exchange_forever(communicator: Communicator, rounds: dict[int, int]) -> None:
    """Exchange for ever."""
    x = np.zeros(6)
    i = communicator.id
    while True:
        await communicator.neighbors_exchange(x, deadline=EXCHANGE_DEADLINE)
        rounds[i] += 1


async def join_others(
    group: asyncio.TaskGroup, bus: Bus, team: Graph, spec: dict[str, Any]
) -> ZenohLink:
    """Open the link to the other processes, and return it when all have been found."""
    own = Introduction(spec["swarm"], incarnation=1, version="bench")
    link = ZenohLink(bus, own, SessionEndpoints(spec["listen"], spec["connect"]))
    link.open()
    group.create_task(link.run())
    await wait_until_joined(link, team)
    return link


async def start(
    group: asyncio.TaskGroup,
    bus: Bus,
    team: Graph,
    spec: dict[str, Any],
    rounds: dict[int, int],
    count_resent: Callable[[], int] | None = None,
) -> None:
    """Find the other processes, report ready, and wait for go; then start to count `rounds`."""
    if spec["connect"]:
        await join_others(group, bus, team, spec)
    say({"ready": True})
    await asyncio.to_thread(wait_for_go)
    report(rounds, spec, count_resent)


async def main(clock: Clock) -> None:
    """Join, wait for go, and exchange until killed."""
    spec: dict[str, Any] = specification()
    bus = Bus(clock, process=spec["process"], host="bench")
    team = Graph.from_neighbors(spec["neighbors"])
    members = [Communicator(bus.port(i), team) for i in spec["mine"]]
    rounds = dict.fromkeys(spec["mine"], 0)
    async with asyncio.TaskGroup() as group:
        await start(
            group,
            bus,
            team,
            spec,
            rounds,
            lambda: sum(c.port.counters.resent for c in members),
        )
        for member in members:
            group.create_task(exchange_forever(member, rounds))


if __name__ == "__main__":
    run_wall(main)
