"""The UDP port of one virtual drone.

The last sender is its client. A closed port looks like a missing drone.
"""

import asyncio
import contextlib
import socket
from collections.abc import Iterator
from functools import partial

from crazychoir.errors import CodecError, ConfigError
from crazychoir.radio.protocol.crtp import LINK, Packet, parse
from crazychoir.radio.virtual.air import Air
from crazychoir.radio.virtual.drone import VirtualCrazyflie

PROBE = b"\xff"
"""Packet of a scan.

Any reply means that the port is in use; a scan does not make the sender the client.
"""
BUFFER = 1 << 20
"""Bytes that the system buffers for a socket, so that a late server loses nothing."""
NULL = 3
"""Channel of the link's port for empty packets."""
AT_ONCE = 200
"""Datagrams that are read in one pass of the loop."""
LONGEST = 65_536
"""Most bytes of a datagram."""
Address = tuple[str, int]
"""Host and port."""


def opened(at: Address) -> socket.socket:
    """Return a socket at this address. Raises ConfigError if it is taken."""
    found = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    found.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, BUFFER)
    found.setblocking(False)
    try:
        found.bind(at)
    except OSError as error:
        found.close()
        where = f"virtual Crazyflies: UDP port {at[1]} of {at[0]}"
        raise ConfigError(where, str(error.strerror), "a port that is free") from error
    return found


def waiting(at: socket.socket | None) -> Iterator[tuple[bytes, Address]]:
    """Return the datagrams that wait at a socket, with their senders.

    There are at most AT_ONCE, and none once the socket is closed.
    """
    for _ in range(AT_ONCE):
        if at is None or at.fileno() < 0:
            return
        try:
            yield at.recvfrom(LONGEST)
        except BlockingIOError:
            return
        except OSError:  # a client has gone, which does not matter here
            continue


class Port:
    """The port at which clients reach a drone.

    drone: the drone
    air: the air between client and drone
    at: host and port
    """

    def __init__(self, drone: VirtualCrazyflie, air: Air, at: Address) -> None:
        self.drone = drone
        self.air = air
        self.at = at
        self.malformed = 0
        """Datagrams that are no packets."""
        self.client: Address | None = None
        """Address of the last sender."""
        self._socket: socket.socket | None = None
        self._unheard: list[Packet] = []

    def open(self) -> None:
        """Open the port. Raises ConfigError if it is taken."""
        if self._socket is None:
            self._socket = opened(self.at)
            asyncio.get_running_loop().add_reader(self._socket, self._readable)

    def close(self) -> None:
        """Close the port; a client that sends then gets an error from its system."""
        if self._socket is not None:
            asyncio.get_running_loop().remove_reader(self._socket)
            self._socket.close()
            self._socket = None
            self.client = None

    def look(self) -> None:
        """Open the port if the drone is on and has started; close it otherwise."""
        if self.drone.booting or self.air.faults.off:
            self.close()
        elif self._socket is None:
            with contextlib.suppress(ConfigError):  # another program has it now
                self.open()

    def _readable(self) -> None:
        for data, sender in waiting(self._socket):
            self._received(data, sender)

    def _received(self, data: bytes, sender: Address) -> None:
        if data == PROBE:
            if not self.air.faults.silent:
                self._leave(Packet(LINK, NULL), sender)
            return
        try:
            packet = parse(data)
        except CodecError:
            self.malformed += 1
            return
        self.client = sender
        self.air.rise(partial(self._arrive, packet))

    def _arrive(self, packet: Packet) -> None:
        for answer in self.drone.take(packet):
            self.say(answer)

    def say(self, packet: Packet) -> None:
        """Send a packet to the client; until there is a client, it waits on board."""
        if self.client is None:
            self._unheard = [*self._unheard[-99:], packet]
            return
        unheard = self._unheard
        self._unheard = []
        for one in (*unheard, packet):
            self.air.sink(partial(self._leave, one, self.client))

    def _leave(self, packet: Packet, to: Address) -> None:
        if self._socket is not None:
            # The system has no room, or the client is gone: the packet is lost, as on the air.
            with contextlib.suppress(OSError):
                self._socket.sendto(packet.framed(), to)
