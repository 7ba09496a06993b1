"""TCP without asyncio: both drones block until the bytes are there."""

import socket
import threading
import time
from typing import Any

from crazychoir.bench.peers.peers import say, specification, wait_for_go
from crazychoir.bench.peers.trips.trip import (
    TRIP_BYTES,
    TripTimes,
    answer_later,
    is_asking,
)


def connect(spec: dict[str, Any]) -> socket.socket:
    """Return a connection of the two drones; that of the second process listens."""
    endpoint = spec["connect"][0] if is_asking(spec) else spec["listen"][0]
    host, _, port = endpoint.removeprefix("tcp/").rpartition(":")
    if not is_asking(spec):
        with socket.create_server((host, int(port))) as listening:
            made, _address = listening.accept()
    else:
        while True:
            try:
                made = socket.create_connection((host, int(port)))
                break
            except ConnectionRefusedError:
                time.sleep(0.01)
    made.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    return made


def receive(made: socket.socket) -> bytes:
    """Return the next bytes, all of them."""
    return made.recv(len(TRIP_BYTES), socket.MSG_WAITALL)


def main() -> None:
    """Connect, wait for go, and send bytes there and back until killed."""
    spec = specification()
    made = connect(spec)
    say({"ready": True})
    wait_for_go()
    if not is_asking(spec):
        answer_later(spec)
        while data := receive(made):
            made.sendall(data)
        return
    times = TripTimes(spec)
    while True:
        began_ns = time.perf_counter_ns()
        made.sendall(TRIP_BYTES)
        receive(made)
        if not times.add(began_ns):
            break
    times.say()
    threading.Event().wait()


if __name__ == "__main__":
    main()
