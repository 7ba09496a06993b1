"""Ctrl-C during a solution: the team ends with its best plan."""

import contextlib
import signal
import threading
from collections.abc import Callable, Iterator
from types import FrameType


class Interruption:
    """Calls listeners at the first Ctrl-C; the second Ctrl-C is a KeyboardInterrupt as usual.

    A Ctrl-C without a listener is a KeyboardInterrupt too.
    """

    def __init__(self) -> None:
        self._listeners: list[Callable[[], None]] = []

    @contextlib.contextmanager
    def telling(self, listener: Callable[[], None]) -> Iterator[None]:
        """Call the listener at a Ctrl-C inside the block."""
        self._listeners.append(listener)
        try:
            yield
        finally:
            self._listeners.remove(listener)

    @contextlib.contextmanager
    def caught(self) -> Iterator[None]:
        """Handle Ctrl-C inside the block. Outside the main thread this does nothing."""
        if threading.current_thread() is not threading.main_thread():
            yield
            return
        before = signal.signal(signal.SIGINT, self._handle)
        try:
            yield
        finally:
            signal.signal(signal.SIGINT, before)

    def _handle(self, number: int, frame: FrameType | None) -> None:
        signal.signal(number, signal.default_int_handler)
        if not self._listeners:
            raise KeyboardInterrupt
        for listener in self._listeners:
            listener()
