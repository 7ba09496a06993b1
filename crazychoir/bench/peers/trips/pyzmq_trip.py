"""ZeroMQ: a PAIR of sockets of the host, with `zmq.asyncio` on uvloop."""

import asyncio
import importlib

from crazychoir.bench.peers.peers import say, specification, wait_for_go
from crazychoir.bench.peers.trips.trip import (
    TRIP_BYTES,
    answer_later,
    ask_for_window,
    is_asking,
)


async def main() -> None:
    """Connect, wait for go, and send bytes there and back until killed."""
    spec = specification()
    zmq = importlib.import_module("zmq")
    pair = importlib.import_module("zmq.asyncio").Context().socket(zmq.PAIR)
    place = f"ipc://{spec['folder']}/pair"

    async def go_and_return() -> None:
        await pair.send(TRIP_BYTES)
        await pair.recv()

    if is_asking(spec):
        pair.connect(place)
        await go_and_return()
    else:
        pair.bind(place)
        await pair.send(await pair.recv())
    say({"ready": True})
    await asyncio.to_thread(wait_for_go)
    if is_asking(spec):
        await ask_for_window(spec, go_and_return)
    answer_later(spec)
    while True:
        await pair.send(await pair.recv())


if __name__ == "__main__":
    importlib.import_module("uvloop").run(main())
