"""Virtual Crazyflies on UDP, on the wall clock: one port a drone, one world for all of them."""

import asyncio
from collections.abc import Sequence
from typing import cast

from crazychoir.bus.local import Bus
from crazychoir.errors import CodecError, ConfigError
from crazychoir.radio.crtp import Packet, parse
from crazychoir.radio.virtual.drone import VirtualCrazyflie
from crazychoir.runtime.actor import Actor
from crazychoir.runtime.clock import Clock
from crazychoir.simulation.crazyflies import CrazyflieWorld

PROBE = b"\xff"
"""What a scan sends; whatever comes back says that somebody is there, and its sender is nobody's peer."""
BUFFER = 1 << 20
"""Bytes that the system keeps for a socket: a starved server loses nothing."""
RATE = 100.0
"""Hz, at which the world is stepped and logs are looked at."""
__all__ = ["Bus", "VirtualServer"]


class _Port(asyncio.DatagramProtocol):
    """The UDP port of one drone; who has sent last is its peer."""

    def __init__(self, drone: VirtualCrazyflie) -> None:
        self.drone, self.malformed = drone, 0
        self.transport: asyncio.DatagramTransport | None = None
        self.peer: tuple[str, int] | None = None

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self.transport = cast(asyncio.DatagramTransport, transport)

    def datagram_received(self, data: bytes, addr: tuple[str, int]) -> None:
        if data == PROBE:
            self.send(Packet(15, 3), addr)
            return
        try:
            packet = parse(data)
        except CodecError:
            self.malformed += 1
            return
        self.peer = addr
        for answer in self.drone.take(packet):
            self.send(answer, addr)

    def send(self, packet: Packet, to: tuple[str, int] | None) -> None:
        """Let a packet leave, if there is anybody."""
        if self.transport is not None and to is not None:
            self.transport.sendto(packet.framed(), to)
