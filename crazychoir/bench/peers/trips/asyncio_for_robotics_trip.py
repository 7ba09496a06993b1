"""asyncio-for-robotics: its subscribers of Zenoh on uvloop; Zenoh's publishers send, as its manual says."""

import asyncio
import importlib

from crazychoir.bench.peers.peers import say, specification, wait_for_go
from crazychoir.bench.peers.trips.trip import (
    TRIP_BYTES,
    answer_later,
    ask_for_window,
    is_asking,
)
from crazychoir.bench.peers.zenoh_peer import meet, open_session


async def main() -> None:
    """Meet the other, wait for go, and send bytes there and back until killed."""
    spec = specification()
    robotics = importlib.import_module("asyncio_for_robotics.zenoh")
    session = open_session(spec)
    own = spec["mine"][0]
    subscriber = robotics.Sub(f"{spec['swarm']}/{1 - own}", session, scope=None)
    publisher = session.declare_publisher(f"{spec['swarm']}/{own}")
    arriving = subscriber.listen_reliable()
    tokens = meet(session, spec, 2)
    say({"ready": True, "tokens": len(tokens)})
    await asyncio.to_thread(wait_for_go)

    async def go_and_return() -> None:
        publisher.put(TRIP_BYTES)
        await anext(arriving)

    if is_asking(spec):
        await ask_for_window(spec, go_and_return)
    answer_later(spec)
    async for sample in arriving:
        publisher.put(sample.payload)


if __name__ == "__main__":
    importlib.import_module("uvloop").run(main())
