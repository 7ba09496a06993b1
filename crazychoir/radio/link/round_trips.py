"""How long the way to a drone and back takes, and how many echoes come back: counted here, of any link."""

import math
import struct
import threading
from bisect import bisect_left, insort
from collections import OrderedDict, deque

from crazychoir.radio.protocol.crtp import LINK, Packet

ECHO = 0
"""Channel of the link's port that gives back what it gets."""
FORM = struct.Struct("<Bd")
"""Of cflib's own echoes: who listens beside us takes each for one of them."""
SHARED, TIMED = 20, 100
"""Echoes of which the answered share is told, and the latency."""
WORST = 0.95
"""Of the round trips, that are not longer than the latency."""


class RoundTrips:
    """Echoes of one link; from any thread, times in s of one clock."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._number = 0
        self._answered: OrderedDict[bytes, float | None] = OrderedDict()
        self._took: deque[float] = deque()
        self._sorted: list[float] = []

    def echo(self) -> Packet:
        """The next one to send."""
        self._number += 1
        return Packet(LINK, ECHO, FORM.pack(0, self._number))

    def left(self, echo: Packet, now: float) -> None:
        """It is being sent."""
        with self._lock:
            self._answered[echo.data] = now
            if len(self._answered) > SHARED + 1:
                self._answered.popitem(last=False)

    def stayed(self, echo: Packet) -> None:
        """There was no room for it."""
        with self._lock:
            self._answered.pop(echo.data, None)

    def came(self, data: bytes, now: float) -> None:
        """One has come back; a second time it counts no more, and neither does one that nobody knows."""
        with self._lock:
            if (sent := self._answered.get(data)) is not None:
                self._answered[data] = None
                self._took.append(now - sent)
                insort(self._sorted, now - sent)
                if len(self._took) > TIMED:
                    del self._sorted[bisect_left(self._sorted, self._took.popleft())]

    @property
    def latency(self) -> float:
        """s, there and back, 95 of 100 echoes; NaN before the first."""
        with self._lock:
            took = self._sorted
            return took[math.ceil(WORST * len(took)) - 1] if took else math.nan

    @property
    def answered(self) -> float:
        """Share of the last echoes that came back; NaN before there are two."""
        with self._lock:
            back = [sent is None for sent in self._answered.values()][
                :-1
            ]  # the last may be on its way
        return sum(back) / len(back) if back else math.nan
