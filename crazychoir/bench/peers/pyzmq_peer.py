"""ZeroMQ: each process has a ROUTER at a socket of the host, and a DEALER to each other process.

A message goes once to each process that reads the agent. `zmq.asyncio` reads on uvloop.
"""

import asyncio
import importlib
from typing import Any

from crazychoir.bench.peers.peers import report, say, specification, wait_for_go
from crazychoir.bench.peers.round_inbox import (
    MESSAGE_LAYOUT,
    RoundInbox,
    exchange_forever,
    find_readers,
)


class ZeroMqAgents:
    """The agents of one process, and its sockets to the others."""

    def __init__(self, spec: dict[str, Any]) -> None:
        zmq = importlib.import_module("zmq")
        context = zmq.Context()
        own = spec["number"]
        shares = spec["shares"]
        self.router = importlib.import_module("zmq.asyncio").Socket(context, zmq.ROUTER)
        self.router.bind(f"ipc://{spec['folder']}/{own}")
        self._dealers = {}
        for p in range(len(shares)):
            if p != own:
                self._dealers[p] = dealer = context.socket(zmq.DEALER)
                dealer.set_hwm(0)
                dealer.connect(f"ipc://{spec['folder']}/{p}")
        self.inboxes = {i: RoundInbox(len(spec["neighbors"][i])) for i in spec["mine"]}
        readers = find_readers(spec["neighbors"])
        holder = {i: p for p, ids in enumerate(shares) for i in ids}
        self._readers_here = {
            i: [self.inboxes[j] for j in readers[i] if j in self.inboxes]
            for i in spec["neighbors"]
        }
        self._dealers_of = {
            i: [
                self._dealers[p]
                for p in sorted({holder[j] for j in readers[i]} - {own})
            ]
            for i in spec["mine"]
        }

    async def meet(self) -> None:
        """Wait until a message of each other process has come: all sockets are connected."""
        for dealer in self._dealers.values():
            dealer.send(b"here")
        for _ in self._dealers:
            await self.router.recv_multipart()

    async def read(self) -> None:
        """Deliver what comes, for ever."""
        while True:
            _, data = await self.router.recv_multipart()
            self._deliver(data)

    def _deliver(self, data: bytes) -> None:
        source, k, *_ = MESSAGE_LAYOUT.unpack(data)
        for inbox in self._readers_here[source]:
            inbox.put(source, k)

    def publish(self, i: int, data: bytes) -> None:
        """Send a message of an agent to all that read it."""
        for dealer in self._dealers_of[i]:
            dealer.send(data)
        self._deliver(data)


async def main() -> None:
    """Find the others, wait for go, and exchange until killed."""
    spec = specification()
    agents = ZeroMqAgents(spec)
    await agents.meet()
    rounds = dict.fromkeys(spec["mine"], 0)
    say({"ready": True})
    await asyncio.to_thread(wait_for_go)
    report(rounds, spec)
    await asyncio.gather(
        agents.read(),
        *(
            exchange_forever(i, inbox, rounds, agents.publish)
            for i, inbox in agents.inboxes.items()
        ),
    )


if __name__ == "__main__":
    importlib.import_module("uvloop").run(main())
