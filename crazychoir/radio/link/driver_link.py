"""The way of a packet onto the link of a driver of cflib."""

import contextlib
import threading
from collections.abc import Iterable

from cflib.crazyflie import Crazyflie
from cflib.crtp.crtpstack import CRTPPacket

from crazychoir.errors import LinkFailed
from crazychoir.firmware.requests import LINK_CHANNELS
from crazychoir.radio.link.round_trips import RoundTrips
from crazychoir.radio.protocol.crtp import CrtpPort, Packet
from crazychoir.runtime.clock import Clock


class DriverLink:
    """Puts packets on the link of a driver, and closes it.

    uri: address of the drone, for messages
    cf: object of cflib that holds the link
    trips: the echoes of this link
    """

    def __init__(
        self, clock: Clock, uri: str, cf: Crazyflie, trips: RoundTrips
    ) -> None:
        self._clock = clock
        self._uri = uri
        self._cf = cf
        self._trips = trips

    def put(self, packet: Packet) -> bool:
        """Put a packet on the link; return False if there is no room.

        Called from the writer's thread. It bypasses cflib's send lock, which a blocked sender would
        hold.
        Raises LinkFailed if the link is closed.
        """
        out = CRTPPacket()
        out.set_header(packet.port, packet.channel)
        out.data = packet.data
        if (link := self._cf.link) is None:
            raise LinkFailed(self._uri, "its link is closed")
        is_echo = packet[:2] == (CrtpPort.LINK, LINK_CHANNELS.echo)
        if is_echo:
            # Note it before it can return.
            self._trips.left(packet, self._clock.now())
        went = link.send_packet(out) is not False
        if is_echo and not went:
            self._trips.stayed(packet)
        return went

    def put_in_thread(self, packet: Packet) -> None:
        """Put a packet on the link in a thread of its own, because a driver may block."""
        threading.Thread(target=self._try, args=(packet,), daemon=True).start()

    def _try(self, packet: Packet) -> None:
        with contextlib.suppress(LinkFailed):
            self.put(packet)

    def try_all(self, packets: Iterable[Packet]) -> None:
        """Put packets on the link; drop them if it is closed or fails."""
        with contextlib.suppress(LinkFailed, OSError):
            for packet in packets:
                self.put(packet)

    def close(self) -> None:
        """Close the link if it is open."""
        link = self._cf.link
        self._cf.link = None
        if link is not None:
            link.close()
