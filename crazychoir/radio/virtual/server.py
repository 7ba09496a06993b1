"""Virtual Crazyflies on UDP, on the wall clock: one port a drone, one world for all of them."""

import asyncio
import socket
from collections.abc import Sequence
from functools import partial
from typing import Any, cast

from crazychoir.errors import CodecError, ConfigError
from crazychoir.radio.crtp import LINK, Packet, parse
from crazychoir.radio.virtual.air import Air, Dongle
from crazychoir.radio.virtual.bodies import world_of
from crazychoir.radio.virtual.drone import VirtualCrazyflie
from crazychoir.runtime.actor import Actor
from crazychoir.runtime.clock import SECOND, Clock
from crazychoir.simulation.crazyflies import CrazyflieWorld
from crazychoir.swarm.config import default_swarm

PROBE = b"\xff"
"""What a scan sends: whatever comes back says that somebody is there. Who scans is no client yet."""
BUFFER = 1 << 20
"""Bytes that the system keeps for a socket, so that a late server loses nothing."""
NULL = 3
"""Channel of the link's port for packets that say nothing."""
ADDRESS = 0xE7
"""Last byte of the address of drone 0; each next one has the next."""
MS = SECOND // 1000


class _Port(asyncio.DatagramProtocol):
    """The UDP port of one drone; who has sent last is its client."""

    def __init__(self, drone: VirtualCrazyflie, air: Air) -> None:
        self.drone, self.air, self.malformed = drone, air, 0
        self.refuses = False
        """Whether it behaves as one that is switched off."""
        self._transport: asyncio.DatagramTransport | None = None
        self._client: tuple[str, int] | None = None

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self._transport = cast(asyncio.DatagramTransport, transport)

    def datagram_received(self, data: bytes, addr: tuple[str, int]) -> None:
        if self.refuses:
            return
        if data == PROBE:
            self._leave(Packet(LINK, NULL), addr)
            return
        try:
            packet = parse(data)
        except CodecError:
            self.malformed += 1
            return
        self._client = addr
        self.air.up(partial(self._arrive, packet))

    def error_received(self, exc: Exception) -> None:
        """A client that is gone is nobody's business."""

    def _arrive(self, packet: Packet) -> None:
        for answer in self.drone.take(packet):
            self.say(answer)

    def say(self, packet: Packet) -> None:
        """Let a packet leave for the client, if there is one."""
        if self._client is not None:
            self.air.down(partial(self._leave, packet, self._client))

    def _leave(self, packet: Packet, to: tuple[str, int]) -> None:
        if self._transport is not None and not self._transport.is_closing():
            self._transport.sendto(packet.framed(), to)

    def close(self) -> None:
        """Nobody is served any more."""
        if self._transport is not None:
            self._transport.close()


class VirtualServer(Actor):
    """Serves the drones of a world, which it steps.

    port: of the first drone on `host`; each next one has the next;  dongles: groups of drones that share a radio.
    """

    name = "virtual"

    def __init__(
        self, clock: Clock, world: CrazyflieWorld, port: int, host: str = "127.0.0.1",
        dongles: Sequence[Sequence[int]] = (), capacity: float = 250.0, seed: int = 0,
    ) -> None:  # fmt: skip
        self.clock, self.world, self.host, self.port = clock, world, host, port
        shared = {i: dongle for group in dongles for dongle in (Dongle(clock, capacity),) for i in group}
        self.dongles = list({id(dongle): dongle for dongle in shared.values()}.values())
        self.ports = {
            i: _Port(self._drone(i, row), Air(clock, i, shared.get(i), seed)) for row, i in enumerate(world.ids)
        }

    def _drone(self, i: int, row: int) -> VirtualCrazyflie:
        onboard = self.world.onboard[i]
        log = {
            "pm.vbat": lambda: onboard.log("pm.vbat"), "pm.vbatMV": lambda: onboard.log("pm.vbatMV"),
            "pm.state": lambda: 0.0, "radio.isConnected": lambda: 1.0, "radio.rssi": lambda: 40.0,
        }  # fmt: skip
        return VirtualCrazyflie(onboard, (ADDRESS + row) % 256, log)

    async def listen(self) -> None:
        """Open the ports; ConfigError where one is taken."""
        loop = asyncio.get_running_loop()
        for k, found in enumerate(self.ports.values()):
            at = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
            at.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, BUFFER)
            at.setblocking(False)
            try:
                at.bind((self.host, self.port + k))
            except OSError as error:
                at.close()
                where, do = f"virtual Crazyflies: UDP port {self.port + k} of {self.host}", "Choose another --port."
                raise ConfigError(where, str(error.strerror), "a port that is free", do) from error
            await loop.create_datagram_endpoint(lambda found=found: found, sock=at)  # type: ignore[misc]

    async def run(self) -> None:
        """Step the world, and let each drone say what it has to."""
        began = self.clock.now_ns()
        async for _ in self.clock.ticks(1.0 / self.world.dt):
            self.world.step()
            uptime = (self.clock.now_ns() - began) // MS
            for found in self.ports.values():
                for packet in found.drone.pass_time(uptime):
                    found.say(packet)

    async def on_stop(self) -> None:
        """Close the ports."""
        for found in self.ports.values():
            found.close()

    def report(self) -> dict[str, Any]:
        """What became of each drone."""
        return {
            "success": True,
            "seconds": self.world.time,
            "crashed": self.world.crashed,
            "lost": {i: found.air.lost for i, found in self.ports.items()},
        }


def grid(clock: Clock, n: int, port: int, seed: int = 0) -> VirtualServer:
    """n drones on a square grid on the floor."""
    config = default_swarm(n)
    return VirtualServer(clock, world_of(config, config.drones, seed), port, seed=seed)
