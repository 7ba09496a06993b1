"""Round-trip times of a link, and the share of its echoes that come back, for any kind of link."""

import math
import struct
import threading
from bisect import bisect_left, insort
from collections import OrderedDict, deque
from collections.abc import Callable
from dataclasses import dataclass

from crazychoir.firmware.requests import LINK_CHANNELS
from crazychoir.radio.protocol.crtp import CrtpPort, Packet
from crazychoir.runtime.clock import Clock

ECHO_FORMAT = struct.Struct("<Bd")
"""Format of cflib's own echoes: other listeners take ours for cflib's."""


@dataclass(frozen=True, slots=True)
class EchoStatistics:
    """How the latency and the answered share are computed from echoes."""

    share_window: int = 20
    """Echoes in the answered share."""
    latency_window: int = 100
    """Echoes in the latency."""
    latency_quantile: float = 0.95
    """Share of the round trips that are not longer than the latency."""


ECHO_STATISTICS = EchoStatistics()


class RoundTrips:
    """The echoes of one link; its methods may be called from any thread.

    Times are s of one clock.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._number = 0
        self._answered: OrderedDict[bytes, float | None] = OrderedDict()
        self._took: deque[float] = deque()
        self._sorted: list[float] = []

    def echo(self) -> Packet:
        """Return the next echo to send."""
        self._number += 1
        return Packet(
            CrtpPort.LINK, LINK_CHANNELS.echo, ECHO_FORMAT.pack(0, self._number)
        )

    def left(self, echo: Packet, now: float) -> None:
        """Note that an echo is being sent."""
        with self._lock:
            self._answered[echo.data] = now
            if len(self._answered) > ECHO_STATISTICS.share_window + 1:
                self._answered.popitem(last=False)

    def stayed(self, echo: Packet) -> None:
        """Forget an echo that found no room."""
        with self._lock:
            self._answered.pop(echo.data, None)

    def came(self, data: bytes, now: float) -> None:
        """Note an echo that came back. A repeated or unknown echo does not count."""
        with self._lock:
            if (sent := self._answered.get(data)) is not None:
                self._answered[data] = None
                self._took.append(now - sent)
                insort(self._sorted, now - sent)
                if len(self._took) > ECHO_STATISTICS.latency_window:
                    del self._sorted[bisect_left(self._sorted, self._took.popleft())]

    @property
    def latency(self) -> float:
        """Round trip in s that 95 of 100 echoes do not exceed; NaN before the first."""
        with self._lock:
            took = self._sorted
            return (
                took[math.ceil(ECHO_STATISTICS.latency_quantile * len(took)) - 1]
                if took
                else math.nan
            )

    @property
    def answered(self) -> float:
        """Share of the last echoes that came back; NaN before there are two."""
        with self._lock:
            # Without the last echo, which may be on its way.
            back = [sent is None for sent in self._answered.values()][:-1]
        return sum(back) / len(back) if back else math.nan


async def send_echoes(
    clock: Clock, rate: float, trips: RoundTrips, newest: Callable[[str, Packet], None]
) -> None:
    """Send echoes as ordinary packets.

    cflib's own thread for echoes competes with other packets, and hangs when the air is full.

    rate: Hz
    trips: the echoes of the link
    newest: sends a packet in place of the waiting one of the same kind
    """
    async for _ in clock.ticks(rate):
        newest("echo", trips.echo())
