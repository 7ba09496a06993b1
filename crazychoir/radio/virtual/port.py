"""The UDP port of one virtual drone.

The last sender is its client. A closed port looks like a missing drone.
"""

import asyncio
import contextlib
import socket
from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial

from crazychoir.errors import CodecError, ConfigError
from crazychoir.firmware.requests import LINK_CHANNELS, POWER_PACKETS
from crazychoir.radio.protocol.crtp import CrtpPort, Packet, parse_packet
from crazychoir.radio.protocol.packed_poses import is_packed
from crazychoir.radio.virtual.air import Air
from crazychoir.radio.virtual.drone import VirtualCrazyflie

SCAN_PROBE = b"\xff"
"""Packet of a scan.

Any reply means that the port is in use; a scan does not make the sender the client.
"""


@dataclass(frozen=True, slots=True)
class SocketLimits:
    """Sizes of the buffers and reads of a drone's socket."""

    buffer_size: int = 1 << 20
    """Bytes that the system buffers for a socket, so that a late server loses nothing."""
    datagrams_per_pass: int = 200
    """Datagrams that are read in one pass of the loop."""
    datagram_size: int = 65_536
    """Most bytes of a datagram."""


SOCKET_LIMITS = SocketLimits()


Address = tuple[str, int]
"""Host and port."""


def open_socket(at: Address) -> socket.socket:
    """Return a socket at this address. Raises ConfigError if it is taken."""
    found = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    found.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, SOCKET_LIMITS.buffer_size)
    found.setblocking(False)
    try:
        found.bind(at)
    except OSError as error:
        found.close()
        where = f"virtual Crazyflies: UDP port {at[1]} of {at[0]}"
        raise ConfigError(where, str(error.strerror), "a port that is free") from error
    return found


def receive_waiting(at: socket.socket | None) -> Iterator[tuple[bytes, Address]]:
    """Return the datagrams that wait at a socket, with their senders.

    There are at most `SOCKET_LIMITS.datagrams_per_pass`, and none once the socket is closed.
    """
    for _ in range(SOCKET_LIMITS.datagrams_per_pass):
        if at is None or at.fileno() < 0:
            return
        try:
            yield at.recvfrom(SOCKET_LIMITS.datagram_size)
        except BlockingIOError:
            return
        except OSError:  # a client has gone, which does not matter here
            continue


class DronePort:
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
            self._socket = open_socket(self.at)
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
        for data, sender in receive_waiting(self._socket):
            self._received(data, sender)

    def _received(self, data: bytes, sender: Address) -> None:
        if data == SCAN_PROBE:
            if not self.air.faults.silent:
                self._leave(Packet(CrtpPort.LINK, LINK_CHANNELS.null), sender)
            return
        try:
            packet = parse_packet(data)
        except CodecError:
            self.malformed += 1
            return
        self.client = sender
        if is_packed(packet):
            self.air.spread(data, partial(self._arrive, packet))
        else:
            self.air.rise(partial(self._arrive, packet))

    def _arrive(self, packet: Packet) -> None:
        is_null = packet[:2] == (CrtpPort.LINK, LINK_CHANNELS.null)
        if is_null and packet.data[:1] == bytes([POWER_PACKETS.mark]):
            self._switch(packet.data[1:2])
            return
        for answer in self.drone.take(packet):
            self.say(answer)

    def _switch(self, command: bytes) -> None:
        """Switch the drone off for good, or restart it; the chip of its radio confirms.

        A virtual drone starts at once when its main processor is switched off; switching it on then
        changes nothing.
        """
        self.say(Packet(CrtpPort.LINK, LINK_CHANNELS.null))
        if command == bytes([POWER_PACKETS.all_off]):
            self.air.faults.off = True
            self.drone.restart("switched off")
        elif command == bytes([POWER_PACKETS.system_off]):
            self.drone.restart("its main processor was switched off")

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
