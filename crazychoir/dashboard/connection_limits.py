"""Connection limits: idle connections are closed, and no address may hold many of them."""

import asyncio
from typing import Any

from uvicorn.protocols.http.h11_impl import H11Protocol

from crazychoir.dashboard.access import network_of

IDLE_CHECK_PERIOD = 5.0
"""Seconds between two checks of a connection.

A request must arrive, and the next one follow an answer, within one to two such intervals.
"""
MOST_CONNECTIONS_PER_ADDRESS = 64
"""Largest number of connections of one address, WebSockets included; a browser has some six."""


class GuestConnection(H11Protocol):  # type: ignore[misc]
    """One HTTP connection; it is no longer checked once it has become a WebSocket."""

    _answered: Any = None  # the request that had been answered at the last check
    _timer: asyncio.TimerHandle | None = None

    def connection_made(self, transport: asyncio.Transport) -> None:
        """Accept the connection, or close it if its address has too many."""
        super().connection_made(transport)
        mine = _network_of_connection(self)
        if (
            sum(_network_of_connection(one) == mine for one in self.connections)
            > MOST_CONNECTIONS_PER_ADDRESS
        ):
            transport.close()
            return
        self._timer = self.loop.call_later(IDLE_CHECK_PERIOD, self._look)

    def connection_lost(self, exc: Exception | None) -> None:
        """Stop the checks."""
        if self._timer is not None:
            self._timer.cancel()
        super().connection_lost(exc)

    def _look(self) -> None:
        """Close the connection if no request has been active since the last check."""
        if self not in self.connections:  # it has become a WebSocket
            return
        idle = self.cycle is None or self.cycle.response_complete
        if idle and self.cycle is self._answered:
            self.transport.close()
            return
        self._answered = self.cycle
        self._timer = self.loop.call_later(IDLE_CHECK_PERIOD, self._look)


def _network_of_connection(connection: Any) -> str:
    return network_of(connection.client[0]) if connection.client else ""
