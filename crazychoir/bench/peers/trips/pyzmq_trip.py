"""ZeroMQ: a PAIR of sockets of the host, with `zmq.asyncio` on uvloop."""

import importlib

from crazychoir.bench.peers.peers import specification
from crazychoir.bench.peers.trips.trip import TRIP_BYTES, is_asking, run_drone


async def main() -> None:
    """Connect, wait for go, and send bytes there and back until killed."""
    spec = specification()
    zmq = importlib.import_module("zmq")
    pair = importlib.import_module("zmq.asyncio").Context().socket(zmq.PAIR)
    place = f"ipc://{spec['folder']}/pair"

    async def go_and_return() -> None:
        await pair.send(TRIP_BYTES)
        await pair.recv()

    async def answer() -> None:
        await pair.send(await pair.recv())

    if is_asking(spec):
        pair.connect(place)
        await go_and_return()
    else:
        pair.bind(place)
        await answer()
    await run_drone(spec, go_and_return, answer)


if __name__ == "__main__":
    importlib.import_module("uvloop").run(main())
