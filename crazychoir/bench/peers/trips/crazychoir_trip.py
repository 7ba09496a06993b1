"""Our program: each drone sends with its communicator, and receives."""

import asyncio
from typing import Any

from crazychoir.bench.peers.crazychoir_peer import EXCHANGE_DEADLINE, join_others
from crazychoir.bench.peers.peers import specification
from crazychoir.bench.peers.trips.trip import TRIP_BYTES, run_drone
from crazychoir.bus.port import Bus
from crazychoir.runtime.clock import Clock, run_wall
from crazychoir.team.communicator import Communicator
from crazychoir.team.graph import Graph


async def main(clock: Clock) -> None:
    """Join, wait for go, and send bytes there and back until killed."""
    spec: dict[str, Any] = specification()
    bus = Bus(clock, process=spec["process"], host="bench")
    team = Graph.from_neighbors(spec["neighbors"])
    communicator = Communicator(bus.port(spec["mine"][0]), team)

    async def go_and_return() -> None:
        await communicator.send(TRIP_BYTES)
        await communicator.receive(deadline=EXCHANGE_DEADLINE)

    async def answer() -> None:
        heard = await communicator.receive(deadline=EXCHANGE_DEADLINE)
        await communicator.send(next(iter(heard.values())))

    async with asyncio.TaskGroup() as group:
        await join_others(group, bus, team, spec)
        await run_drone(spec, go_and_return, answer)


if __name__ == "__main__":
    run_wall(main)
