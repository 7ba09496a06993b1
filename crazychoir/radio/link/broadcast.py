"""The way of broadcast packets to the drones of a dongle that share a channel and data rate."""

import threading
from collections import deque
from collections.abc import Callable, Sequence

from cflib.crtp.radiodriver import RadioDriver

from crazychoir.radio.link.dongles import PROCESS_DONGLES
from crazychoir.radio.protocol.crtp import Packet


class DongleBroadcast:
    """Broadcasts packets in a thread of its own, because a dongle blocks it.

    A newer broadcast replaces the waiting one: its poses are newer.

    uri: radio:// address of one of the drones
    sent: called from the thread once a broadcast has left, with the times given to `newest`
    """

    def __init__(self, uri: str, sent: Callable[[list[float]], None]) -> None:
        self._number, self._channel, self._rate, _, _ = RadioDriver.parse_uri(uri)
        self._sent = sent
        self._work = threading.Condition()
        self._waiting: deque[tuple[list[bytes], list[float]]] = deque(maxlen=1)
        self._ends = False
        self._thread = threading.Thread(
            target=self._run, name=f"dongle {self._number} broadcast", daemon=True
        )
        self._thread.start()

    def newest(self, packets: Sequence[Packet], times: list[float]) -> None:
        """Broadcast packets in place of the waiting ones.

        times: s: when their poses were seen; given to `sent`
        """
        with self._work:
            self._waiting.append(([packet.framed() for packet in packets], times))
            self._work.notify()

    def end(self) -> None:
        """End the thread."""
        with self._work:
            self._ends = True
            self._work.notify()

    def _run(self) -> None:
        while True:
            with self._work:
                self._work.wait_for(lambda: self._waiting or self._ends)
                if self._ends:
                    return
                packets, times = self._waiting.popleft()
            dongle = PROCESS_DONGLES.find(self._number)
            if dongle is not None:
                dongle.broadcast(self._channel, self._rate, packets)
                self._sent(times)
