"""asyncio-for-robotics: its subscribers of Zenoh on uvloop; Zenoh's publishers send, as its manual says."""

import importlib

from crazychoir.bench.peers.peers import specification
from crazychoir.bench.peers.trips.trip import TRIP_BYTES, run_drone
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
    _tokens = meet(session, spec, 2)  # they disappear when they are not kept

    async def go_and_return() -> None:
        publisher.put(TRIP_BYTES)
        await anext(arriving)

    async def answer() -> None:
        sample = await anext(arriving)
        publisher.put(sample.payload)

    await run_drone(spec, go_and_return, answer)


if __name__ == "__main__":
    importlib.import_module("uvloop").run(main())
