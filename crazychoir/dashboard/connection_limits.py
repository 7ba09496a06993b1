"""Connections to the page's server: one on which nothing is asked is closed, and no address holds many of them."""

import asyncio
from typing import Any

from uvicorn.protocols.http.h11_impl import H11Protocol

from crazychoir.dashboard.access import network_of

IDLE = 5.0
"""s for a request to come whole, and after an answer for the next one; see `_look`: at most twice as long."""
MOST = 64
"""Connections of one address, lines of pages included: a browser has some six."""


class Guest(H11Protocol):  # type: ignore[misc]
    """One connection; its lines, once they are WebSockets, are no concern of this."""

    _answered: Any = None  # the request that was answered at the last look
    _timer: asyncio.TimerHandle | None = None

    def connection_made(self, transport: asyncio.Transport) -> None:
        """Somebody has come."""
        super().connection_made(transport)
        mine = _network(self)
        if sum(_network(one) == mine for one in self.connections) > MOST:
            transport.close()
            return
        self._timer = self.loop.call_later(IDLE, self._look)

    def connection_lost(self, exc: Exception | None) -> None:
        """He has gone."""
        if self._timer is not None:
            self._timer.cancel()
        super().connection_lost(exc)

    def _look(self) -> None:
        """Whether a request has been answered, or is being so, since the last look."""
        if self not in self.connections:  # it is a WebSocket now
            return
        idle = self.cycle is None or self.cycle.response_complete
        if idle and self.cycle is self._answered:
            self.transport.close()
            return
        self._answered = self.cycle
        self._timer = self.loop.call_later(IDLE, self._look)


def _network(connection: Any) -> str:
    return network_of(connection.client[0]) if connection.client else ""
