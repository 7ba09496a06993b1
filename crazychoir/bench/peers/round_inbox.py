"""The parts that the plain programs of the exchange share: message, inboxes, and the run of the agents."""

import asyncio
import struct
from collections.abc import Awaitable, Callable
from typing import Any

from crazychoir.bench.peers.peers import report, say, wait_for_go

MESSAGE_LAYOUT = struct.Struct("<II6d")
"""Source, round, and six numbers."""
STATE_NUMBERS = (0.0,) * 6


class RoundInbox:
    """The sources of the messages of one agent, by round.

    size: number of its neighbours
    """

    def __init__(self, size: int) -> None:
        self._size = size
        self._k = -1
        self._rounds: dict[int, set[int]] = {}
        self._waiter: asyncio.Future[None] | None = None

    def put(self, source: int, k: int) -> None:
        """Take a message of round k, and wake the agent if its round is complete."""
        box = self._rounds.setdefault(k, set())
        box.add(source)
        if (
            k == self._k
            and len(box) == self._size
            and self._waiter is not None
            and not self._waiter.done()
        ):
            self._waiter.set_result(None)

    async def get(self, k: int) -> None:
        """Wait for all messages of round k."""
        self._k = k
        if len(self._rounds.setdefault(k, set())) < self._size:
            self._waiter = asyncio.get_running_loop().create_future()
            await self._waiter
        del self._rounds[k]


class AgentPlaces:
    """The process of each agent, and the inboxes of the agents of this process.

    spec: argument of the program

    Attributes:
    inboxes: {agent of this process: its inbox}
    processes: {agent of this process: other processes with agents that read it}
    """

    def __init__(self, spec: dict[str, Any]) -> None:
        neighbors = spec["neighbors"]
        readers = find_readers(neighbors)
        holder = {i: p for p, ids in enumerate(spec["shares"]) for i in ids}
        own = spec["number"]
        self.inboxes = {i: RoundInbox(len(neighbors[i])) for i in spec["mine"]}
        self.processes = {
            i: sorted({holder[j] for j in readers[i]} - {own}) for i in spec["mine"]
        }
        self._readers_here = {
            i: [self.inboxes[j] for j in readers[i] if j in self.inboxes]
            for i in neighbors
        }

    def deliver(self, data: bytes) -> None:
        """Put a message into the inboxes of the agents of this process that read its source."""
        source, k, *_ = MESSAGE_LAYOUT.unpack(data)
        for inbox in self._readers_here[source]:
            inbox.put(source, k)


def find_readers(neighbors: dict[int, tuple[int, ...]]) -> dict[int, list[int]]:
    """Return {agent: agents that read it}."""
    return {i: [j for j in neighbors if i in neighbors[j]] for i in neighbors}


async def exchange_forever(
    i: int,
    inbox: RoundInbox,
    rounds: dict[int, int],
    publish: Callable[[int, bytes], None],
) -> None:
    """Send a message of each round, and wait for those of the neighbours.

    publish: sends bytes of an agent to all that read it
    """
    while True:
        publish(i, MESSAGE_LAYOUT.pack(i, rounds[i], *STATE_NUMBERS))
        await inbox.get(rounds[i])
        rounds[i] += 1


async def run_agents(
    spec: dict[str, Any],
    inboxes: dict[int, RoundInbox],
    publish: Callable[[int, bytes], None],
    *beside: Awaitable[None],
) -> None:
    """Wait for go, and let the agents of this process exchange until the process is killed.

    spec: argument of the program
    inboxes: {agent of this process: its inbox}
    publish: sends bytes of an agent to all that read it
    beside: further work of the process
    """
    rounds = dict.fromkeys(spec["mine"], 0)
    say({"ready": True})
    await asyncio.to_thread(wait_for_go)
    report(rounds, spec)
    exchanges = [
        exchange_forever(i, inbox, rounds, publish) for i, inbox in inboxes.items()
    ]
    await asyncio.gather(*beside, *exchanges)
