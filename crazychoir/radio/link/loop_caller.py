"""Calls into the event loop from the threads of a driver."""

import asyncio
import contextlib
from collections.abc import Callable
from typing import Any


class LoopCaller:
    """Calls functions in the event loop from any thread, until it is closed."""

    def __init__(self, loop: asyncio.AbstractEventLoop) -> None:
        self.is_closed = False
        """Whether calls are dropped."""
        self._loop = loop

    def call(self, function: Callable[..., None], *arguments: Any) -> None:
        """Call this function in the event loop, unless this is closed or the loop has ended."""
        if not self.is_closed:
            with contextlib.suppress(RuntimeError):  # the loop has ended
                self._loop.call_soon_threadsafe(function, *arguments)

    def call_after_close(self, function: Callable[..., None], *arguments: Any) -> None:
        """Call this function in the event loop even if this is closed."""
        with contextlib.suppress(RuntimeError):  # the loop has ended
            self._loop.call_soon_threadsafe(function, *arguments)

    def close(self) -> None:
        """Drop all further calls."""
        self.is_closed = True


def resolve_waiting(waiting: "asyncio.Future[None]") -> None:
    """Resolve a future that may have been cancelled."""
    if not waiting.done():
        waiting.set_result(None)
