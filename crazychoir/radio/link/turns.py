"""The turns of the links that share a dongle.

To change to another drone, a dongle needs more time than for a packet. So a link that may have more to
exchange keeps its turn for a few packets: this is a visit.
"""

import contextlib
import threading
from collections import deque
from collections.abc import Iterator

from crazychoir.config.dongle_plan import RADIO_TRAFFIC

HOLDING_TIME = 1e-3
"""s for which the dongle waits for the next packet of the visited link."""


class _Place:
    """The place of a link in the queue."""

    def __init__(self, link: object, lock: threading.Lock, first: bool) -> None:
        self.link = link
        self.first = first
        self.called = threading.Condition(lock)


class DongleTurns:
    """Gives a dongle to one link at a time: first come, first served, but visits are not interrupted.

    longest_visit: most packets of a visit
    """

    def __init__(self, longest_visit: int = RADIO_TRAFFIC.longest_visit) -> None:
        self.longest_visit = longest_visit
        self._lock = threading.Lock()
        self._waiting: deque[_Place] = deque()
        self._busy = False
        self._visited: object = None
        self._visit = 0
        self._held = False

    @contextlib.contextmanager
    def take(self, link: object, first: bool = False) -> Iterator[None]:
        """Wait for the dongle, and have it.

        link: the link that waits
        first: True to go before all links that wait, and before the end of a visit
        """
        with self._lock:
            place = _Place(link, self._lock, first)
            if first:
                self._held = False
                self._waiting.appendleft(place)
            else:
                self._waiting.append(place)
            self._wait(place)
            self._waiting.remove(place)
            self._busy = True
            self._visit = self._visit + 1 if link is self._visited else 1
            self._visited = link
            self._held = False
        try:
            yield
        finally:
            with self._lock:
                self._busy = False
                if self._waiting:
                    (self._next() or self._waiting[0]).called.notify()

    def _wait(self, place: _Place) -> None:
        """Wait until it is the turn of this place."""
        while self._busy or self._next() is not place:
            is_patient = self._busy or place is not self._waiting[0]
            was_called = place.called.wait(None if is_patient else HOLDING_TIME)
            if not (was_called or self._busy):
                self._held = False  # the visited link has nothing more

    def _next(self) -> _Place | None:
        """Return the next place in turn; None while the dongle is kept for another link."""
        if self._held:
            return next(
                (place for place in self._waiting if place.link is self._visited), None
            )
        return self._waiting[0]

    def hold(self, link: object) -> None:
        """Keep the dongle for this link, which has it, until its next packet.

        The next link waits for it for HOLDING_TIME at most. The dongle is not kept while a link waits
        that goes first.
        """
        with self._lock:
            is_urgent = bool(self._waiting) and self._waiting[0].first
            may_go_on = self._visit < self.longest_visit and not is_urgent
            self._held = link is self._visited and may_go_on

    def is_visiting(self, link: object) -> bool:
        """Return whether the dongle is kept for this link."""
        with self._lock:
            return self._held and link is self._visited
