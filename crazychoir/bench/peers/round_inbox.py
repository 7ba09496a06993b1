"""What the plain programs of the exchange share: the message, and the messages of an agent by round."""

import asyncio
import struct
from collections.abc import Callable

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
