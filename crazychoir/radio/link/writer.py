"""The only thread that sends to a drone.

A driver may block the sender for seconds when the air is full.
"""

import threading
from collections import deque
from collections.abc import Callable, Iterable

from crazychoir.errors import error_text
from crazychoir.radio.protocol.crtp import Packet
from crazychoir.runtime.clock import NS_PER_SECOND, Clock


class SendPacer:
    """Turns of the drones that share a dongle: as many a second as the dongle carries.

    The driver of a radio blocks the sender until the air is free. A network does not, and packets
    that wait there for a slower dongle become old. A sender that waits here sends its newest
    packet.

    capacity: packets a second
    """

    def __init__(self, clock: Clock, capacity: float) -> None:
        self._clock = clock
        self._period_ns = round(NS_PER_SECOND / capacity)
        self._free_ns = 0
        self._lock = threading.Lock()
        self._never = threading.Event()

    def turn(self) -> None:
        """Wait for a turn; callable from any thread."""
        with self._lock:
            now_ns = self._clock.now_ns()
            start_ns = max(now_ns, self._free_ns)
            self._free_ns = start_ns + self._period_ns
        if start_ns > now_ns:
            self._never.wait((start_ns - now_ns) / NS_PER_SECOND)


LONGEST_QUEUE = 1000
"""Most packets that wait in order; beyond that the link counts as lost."""


class PacketWriter:
    """Sends packets in order, and between them the newest of each kind, in turn.

    Urgent packets go before all others.

    send: puts a packet on the link; False: no room. Then it is tried again, unless a more urgent or
      newer packet has come.
    turn: waits until a packet may be sent
    room: waits a short time for room on the link, so that the newest packet is sent; False: no room
      yet
    """

    def __init__(
        self,
        name: str,
        send: Callable[[Packet], bool],
        turn: Callable[[], None] = lambda: None,
        room: Callable[[], bool] = lambda: True,
    ) -> None:
        self._send = send
        self._turn = turn
        self._room = room
        self._work = threading.Condition()
        self._urgent: deque[Packet] = deque()
        self._ordered: deque[Packet] = deque()
        self._newest: dict[str, Packet] = {}
        self._ends = False
        self.sent = self.refused = 0
        """Packets that were sent, and packets refused because too many waited."""
        self.failure = ""
        """Error of the last send that failed."""
        self._thread = threading.Thread(
            target=self._run, name=f"{name} writer", daemon=True
        )
        self._thread.start()

    def put(self, packet: Packet) -> bool:
        """Queue a packet after all earlier ones; return False if too many wait."""
        with self._work:
            if len(self._ordered) >= LONGEST_QUEUE:
                self.refused += 1
                return False
            self._ordered.append(packet)
            self._work.notify()
        return True

    def urgent(self, packets: Iterable[Packet]) -> None:
        """Send packets before all waiting ones; earlier urgent packets are dropped."""
        with self._work:
            self._urgent = deque(packets)
            self._work.notify()

    def newest(self, kind: str, packet: Packet) -> None:
        """Send a packet in place of the waiting one of the same kind."""
        with self._work:
            self._newest[kind] = packet
            self._work.notify()

    def forget(self, kind: str) -> None:
        """Drop the waiting packet of this kind."""
        with self._work:
            self._newest.pop(kind, None)

    def failed(self) -> str:
        """Return the error of a failed send since the last call; empty if there was none."""
        failure = self.failure
        self.failure = ""
        return failure

    def end(self) -> None:
        """Send the packets that wait in order, then end."""
        with self._work:
            self._ends = True
            self._newest.clear()
            self._work.notify()

    def join(self, seconds: float) -> bool:
        """Wait for the thread to end; return False if it still sends."""
        self._thread.join(seconds)
        return not self._thread.is_alive()

    def _run(self) -> None:
        while self._waits():
            self._turn()
            while not (self._room() and self._has_sent()):
                pass  # the turn remains: send whatever packet is next by then

    def _waits(self) -> bool:
        """Wait until there is a packet to send; return False at the end."""
        with self._work:
            while not (self._urgent or self._ordered or self._newest or self._ends):
                self._work.wait()
            return bool(self._urgent or self._ordered or self._newest)

    def _has_sent(self) -> bool:
        """Return whether the next packet was sent, has failed for good, or no longer waits."""
        with self._work:
            packet = self._next()
        if packet is None:
            return True
        try:
            if not self._send(packet):
                return False
            self.sent += 1
        except Exception as error:  # noqa: BLE001 - whatever a driver raises, the next packet may get through
            self.failure = error_text(error)
        with self._work:
            self._remove(packet)
        return True

    def _next(self) -> Packet | None:
        for waiting in (self._urgent, self._ordered, list(self._newest.values())):
            if waiting:
                return waiting[0]
        return None

    def _remove(self, packet: Packet) -> None:
        """Remove a packet from its queue, unless it was replaced meanwhile."""
        for waiting in (self._urgent, self._ordered):
            if waiting and waiting[0] is packet:
                waiting.popleft()
                return
        self._newest = {
            kind: other for kind, other in self._newest.items() if other is not packet
        }
