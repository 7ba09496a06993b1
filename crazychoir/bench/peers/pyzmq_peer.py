"""ZeroMQ: each process has a ROUTER at a socket of the host, and a DEALER to each other process.

A message goes once to each process that reads the agent. `zmq.asyncio` reads on uvloop.
"""

import importlib
from typing import Any

from crazychoir.bench.peers.peers import specification
from crazychoir.bench.peers.round_inbox import AgentPlaces, run_agents


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
        self.places = AgentPlaces(spec)

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
            self.places.deliver(data)

    def publish(self, i: int, data: bytes) -> None:
        """Send a message of an agent to all that read it."""
        for p in self.places.processes[i]:
            self._dealers[p].send(data)
        self.places.deliver(data)


async def main() -> None:
    """Find the others, wait for go, and exchange until killed."""
    spec = specification()
    agents = ZeroMqAgents(spec)
    await agents.meet()
    await run_agents(spec, agents.places.inboxes, agents.publish, agents.read())


if __name__ == "__main__":
    importlib.import_module("uvloop").run(main())
