"""Plain sockets: one AF_UNIX socket of the kind SEQPACKET a pair of processes, read by uvloop.

A packet goes once to each process that reads the agent.
"""

import asyncio
import contextlib
import importlib
import socket
import time
from collections import deque
from pathlib import Path
from typing import Any

from crazychoir.bench.peers.peers import specification
from crazychoir.bench.peers.round_inbox import (
    MESSAGE_LAYOUT,
    AgentPlaces,
    run_agents,
)

LOOK_INTERVAL = 0.01
"""Seconds between two tries to connect."""


def connect_all(folder: Path, own: int, processes: int) -> dict[int, socket.socket]:
    """Return a connected socket to each other process; the lesser number connects.

    folder: where the sockets of all processes lie
    own: number of this process
    """
    found: dict[int, socket.socket] = {}
    with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as listening:
        listening.bind(str(folder / str(own)))
        listening.listen(processes)
        for there in range(own + 1, processes):
            made = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
            while made.connect_ex(str(folder / str(there))):
                time.sleep(LOOK_INTERVAL)
            made.send(b"%d" % own)
            found[there] = made
        for _ in range(own):
            made, _address = listening.accept()
            found[int(made.recv(MESSAGE_LAYOUT.size))] = made
    return found


class SocketAgents:
    """The agents of one process, and its sockets to the others."""

    def __init__(self, spec: dict[str, Any], sockets: dict[int, socket.socket]) -> None:
        self._loop = asyncio.get_running_loop()
        self._sockets = sockets
        self._waiting: dict[int, deque[bytes]] = {p: deque() for p in sockets}
        self.places = AgentPlaces(spec)
        for made in sockets.values():
            made.setblocking(False)
            self._loop.add_reader(made.fileno(), self._read, made)

    def _read(self, made: socket.socket) -> None:
        with contextlib.suppress(BlockingIOError):
            while data := made.recv(MESSAGE_LAYOUT.size):
                self.places.deliver(data)

    def publish(self, i: int, data: bytes) -> None:
        """Send a message of an agent to all that read it."""
        for p in self.places.processes[i]:
            self._waiting[p].append(data)
            if len(self._waiting[p]) == 1:
                self._write(p)
        self.places.deliver(data)

    def _write(self, p: int) -> None:
        """Send what waits for a process, as much as has room."""
        made = self._sockets[p]
        waiting = self._waiting[p]
        try:
            while waiting:
                made.send(waiting[0])
                waiting.popleft()
        except BlockingIOError:
            self._loop.add_writer(made.fileno(), self._write, p)
            return
        self._loop.remove_writer(made.fileno())


async def main() -> None:
    """Find the others, wait for go, and exchange until killed."""
    spec = specification()
    processes = len(spec["shares"])
    sockets = connect_all(Path(spec["folder"]), spec["number"], processes)
    agents = SocketAgents(spec, sockets)
    await run_agents(spec, agents.places.inboxes, agents.publish)


if __name__ == "__main__":
    importlib.import_module("uvloop").run(main())
