"""Packets that are sent until their answers arrive."""

import asyncio
import math
from collections.abc import Callable

from crazychoir.radio.protocol.crtp import Packet

REQUEST_RETRY_PERIOD = 0.25
"""s: time after which an unanswered request is sent again."""


class PendingRequests:
    """Finds the answers to requests among the packets that arrive.

    Call its methods from the event loop.

    send: sends a packet
    heard: called with each packet that arrives
    """

    def __init__(
        self, send: Callable[[Packet], None], heard: Callable[[Packet], None]
    ) -> None:
        self._send = send
        self._heard = heard
        self._pending: list[
            tuple[Callable[[Packet], bool], asyncio.Future[Packet]]
        ] = []

    async def ask(
        self,
        packet: Packet,
        answers: Callable[[Packet], bool],
        seconds: float,
        again: float = REQUEST_RETRY_PERIOD,
    ) -> Packet:
        """Send a packet until the answer arrives; return the answer.

        answers: returns whether a packet is the answer
        seconds: s: deadline
        again: s between two sends; infinite for a packet that must not be sent twice
        Raises TimeoutError at the deadline.
        """
        waiting: asyncio.Future[Packet] = asyncio.get_running_loop().create_future()
        entry = (answers, waiting)
        self._pending.append(entry)
        pause = None if math.isinf(again) else again
        try:
            async with asyncio.timeout(seconds):
                while not waiting.done():
                    self._send(packet)
                    await asyncio.wait([waiting], timeout=pause)
                return waiting.result()
        finally:
            self._pending.remove(entry)

    def take(self, packet: Packet) -> None:
        """Take a packet that has arrived: it may be an answer."""
        for answers, waiting in list(self._pending):
            if not waiting.done() and answers(packet):
                waiting.set_result(packet)
        self._heard(packet)

    def cancel(self) -> None:
        """Cancel all requests: no answer will arrive any more."""
        for _, waiting in self._pending:
            waiting.cancel()
