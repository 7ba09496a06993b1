"""mango-agents: an agent in a TCP container of each process; its sockets need asyncio's own loop."""

import asyncio
import importlib
from typing import Any

from crazychoir.bench.peers.peers import specification
from crazychoir.bench.peers.trips.trip import TRIP_BYTES, run_drone

AGENT_NAME = "drone"
TRIP_TEXT = TRIP_BYTES.decode()
"""Its codec is JSON, which takes texts."""


def make_agent() -> Any:
    """Return an agent that puts what it receives into its queue `received`."""
    mango = importlib.import_module("mango")

    def handle_message(agent: Any, content: Any, meta: dict[str, Any]) -> None:
        agent.received.put_nowait(content)

    agent = type("Drone", (mango.Agent,), {"handle_message": handle_message})()
    agent.received = asyncio.Queue()
    return agent


def read_address(endpoint: str) -> tuple[str, int]:
    """Return the host and the port of an endpoint of the benchmark."""
    host, _, port = endpoint.removeprefix("tcp/").rpartition(":")
    return host, int(port)


async def main() -> None:
    """Open a container, wait for go, and send messages there and back until killed."""
    spec = specification()
    mango = importlib.import_module("mango")
    container = mango.create_tcp_container(addr=read_address(spec["listen"][0]))
    agent = make_agent()
    container.register(agent, suggested_aid=AGENT_NAME)
    there = mango.addr(read_address(spec["connect"][0]), AGENT_NAME)

    async def go_and_return() -> None:
        await agent.send_message(TRIP_TEXT, receiver_addr=there)
        await agent.received.get()

    async def answer() -> None:
        content = await agent.received.get()
        await agent.send_message(content, receiver_addr=there)

    async with mango.activate(container):
        await run_drone(spec, go_and_return, answer)


if __name__ == "__main__":
    asyncio.run(main())
