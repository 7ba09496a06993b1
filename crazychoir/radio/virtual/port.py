"""The UDP port of one virtual drone: who has sent last is its client; a closed one is as nobody there."""

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
"""What a scan sends: whatever comes back says that somebody is there. Who scans is no client yet."""
BUFFER = 1 << 20
"""Bytes that the system keeps for a socket, so that a late server loses nothing."""
NULL = 3
"""Channel of the link's port for packets that say nothing."""
AT_ONCE, LONGEST = 200, 65_536
"""Datagrams that are read in one pass of the loop, and their bytes."""
Address = tuple[str, int]


def opened(at: Address) -> socket.socket:
    """A socket at this address; ConfigError where it is taken."""
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
    """The datagrams that wait at a socket, and who has sent them; so many at once, and none once it is closed."""
    for _ in range(AT_ONCE):
        if at is None or at.fileno() < 0:
            return
        try:
            yield at.recvfrom(LONGEST)
        except BlockingIOError:
            return
        except OSError:  # a client that is gone is nobody's business
            continue


class Port:
    """Where clients reach a drone. malformed: datagrams that are no packets;  client: who has sent last."""

    def __init__(self, drone: VirtualCrazyflie, air: Air, at: Address) -> None:
        self.drone = drone
        self.air = air
        self.at = at
        self.malformed = 0
        self.client: Address | None = None
        self._socket: socket.socket | None = None
        self._unheard: list[Packet] = []

    def open(self) -> None:
        """Serve clients; ConfigError where the port is taken."""
        if self._socket is None:
            self._socket = opened(self.at)
            asyncio.get_running_loop().add_reader(self._socket, self._readable)

    def close(self) -> None:
        """Nobody is served any more; a client is told by its system, if it asks."""
        if self._socket is not None:
            asyncio.get_running_loop().remove_reader(self._socket)
            self._socket.close()
            self._socket = None
            self.client = None

    def look(self) -> None:
        """Be open where the drone is on and has started, closed elsewhere."""
        if self.drone.booting or self.air.faults.off:
            self.close()
        elif self._socket is None:
            with contextlib.suppress(ConfigError):  # somebody else has it for now
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
        """Let a packet leave for the client; until there is one it waits on board."""
        if self.client is None:
            self._unheard = [*self._unheard[-99:], packet]
            return
        unheard = self._unheard
        self._unheard = []
        for one in (*unheard, packet):
            self.air.sink(partial(self._leave, one, self.client))

    def _leave(self, packet: Packet, to: Address) -> None:
        if self._socket is not None:
            with contextlib.suppress(
                OSError
            ):  # the system has no room, or nobody is there: lost, as on the air
                self._socket.sendto(packet.framed(), to)
