"""What arrives from other processes waits here for the event loop.

Zenoh's threads hand bytes to the event loop through one deque, with one wake-up for each burst.
"""

import asyncio
import logging
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass

from crazychoir.bus.network.link_counters import LinkCounters
from crazychoir.runtime.clock import NS_PER_SECOND

log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class FrameReading:
    """How many received frames wait, and how long the event loop reads them in one pass."""

    backlog: int = 10_000
    """Frames that may wait for the event loop; if it hangs, the oldest are dropped."""
    slice_frames: int = 64
    """Most frames that are read in one pass of the event loop, so that ticks need not wait for
    more.
    """
    least_slice_ns: int = NS_PER_SECOND // 500
    """ns: least time for reading frames in one pass of the event loop.

    If frames were left unread, the time is as long as the loop was busy elsewhere since then, so that
    reading gets half of the loop's time. A frame that is being read is always finished.
    """
    longest_slice_ns: int = NS_PER_SECOND // 50
    """ns: most time for reading frames in one pass."""


FRAME_READING = FrameReading()


ArrivalHandler = Callable[[str, bytes, int], None]
"""Callable that gets (sender or key, bytes, time of arrival in ns)."""


class ArrivalQueue:
    """The frames and tokens that have arrived, and wait for the event loop.

    counters: gets the numbers of arrivals that are dropped, and of handlers that fail
    now_ns: returns the time in ns
    """

    def __init__(self, counters: LinkCounters, now_ns: Callable[[], int]) -> None:
        self._counters = counters
        self._now_ns = now_ns
        self._loop = asyncio.get_running_loop()
        self._waiting: deque[tuple[ArrivalHandler, str, bytes, int]] = deque(
            maxlen=FRAME_READING.backlog
        )
        self._is_woken = False
        self._behind_ns = 0

    def add(self, handler: ArrivalHandler, key: str, data: bytes) -> None:
        """Let `handler` take `data` in the event loop; may be called from any thread."""
        waiting = self._waiting
        if len(waiting) == FRAME_READING.backlog:
            self._counters.overflowed += 1
        waiting.append((handler, key, data, self._now_ns()))
        if not self._is_woken:
            self._is_woken = True
            if not self.call_on_loop(self._drain):
                waiting.clear()

    def call_on_loop(self, call: Callable[[], None]) -> bool:
        """Call in the event loop; return False if it is closed. May be called from any thread."""
        try:
            self._loop.call_soon_threadsafe(call)
        except RuntimeError:  # the event loop is closed: no work is left
            return False
        return True

    def _drain(self) -> None:
        """Handle what waits in the event loop, for a limited number and time."""
        self._is_woken = False  # before reading, otherwise a wake-up is lost
        waiting = self._waiting
        now = self._now_ns()
        busy = now - self._behind_ns if self._behind_ns else 0
        ends_ns = now + max(
            FRAME_READING.least_slice_ns, min(busy, FRAME_READING.longest_slice_ns)
        )
        for _ in range(min(len(waiting), FRAME_READING.slice_frames)):
            handler, sender, data, arrived_ns = waiting.popleft()
            try:
                handler(sender, data, arrived_ns)
            except Exception as error:  # noqa: BLE001 - the next frame is read all the same
                self.note_failure(sender, error)
            if self._now_ns() > ends_ns:
                break
        self._behind_ns = self._now_ns() if waiting else 0
        if waiting and not self._is_woken:
            self._is_woken = True
            self._loop.call_soon(self._drain)

    def note_failure(self, sender: str, error: Exception) -> None:
        """Count a frame or a token with a handler that raised an error, and log it now and then."""
        self._counters.failed += 1
        if self._counters.failed.bit_count() == 1:
            # Log the first, the second, the fourth, ...
            log.error("a frame of %s was not taken: %s", sender, error, exc_info=error)
