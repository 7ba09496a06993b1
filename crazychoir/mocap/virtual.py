"""The poses of virtual Crazyflies, which their server sends over UDP."""

import asyncio
from dataclasses import dataclass

from crazychoir.errors import CodecError
from crazychoir.mocap.frames import FRAME_PROTOCOL, PoseFrame, parse_frame
from crazychoir.mocap.source import (
    FRAME_TIMEOUT,
    ReportText,
    SourceComplaints,
    TakeFrame,
)
from crazychoir.runtime.clock import Clock


@dataclass(frozen=True, slots=True)
class RequestTiming:
    """How the server of virtual drones is found and asked for frames."""

    rate: float = 1.0
    """Hz of requests: the server forgets a client without a request for 3 s."""
    resolve_deadline: float = 5.0
    """s: time within which the address of the host must be found."""


REQUEST_TIMING = RequestTiming()


class _Client(asyncio.DatagramProtocol):
    """A connected UDP socket: the system passes only datagrams of its server."""

    def __init__(self, source: "VirtualSource", take: TakeFrame) -> None:
        self.source = source
        self.take = take

    def datagram_received(self, data: bytes, addr: tuple[str, int]) -> None:
        try:
            frame = parse_frame(data)
        except CodecError:
            self.source.malformed += 1
            return
        self.source.heard(frame)
        self.take(frame, 0.0)

    def error_received(self, exc: Exception) -> None:
        """Ignore that no server listens: the missing frames are reported elsewhere."""


class VirtualSource:
    """Asks a server of virtual Crazyflies for frames, once a second, without an end.

    Ages are 0: the sender has another clock.
    """

    live = False
    again = 0

    def __init__(
        self, clock: Clock, hostname: str, port: int, say: ReportText | None = None
    ) -> None:
        self.clock = clock
        self.address = (hostname, port)
        self.where = f"virtual at {hostname}:{port}"
        self.state = "asking"
        self.malformed = 0
        """Datagrams that were no frames."""
        self._complain = SourceComplaints(self.where, say)
        self._heard = clock.now()

    async def run(self, take: TakeFrame) -> None:
        """Ask for frames and receive them."""
        self._heard = self.clock.now()
        while True:
            transport = await self._opened(take)
            try:
                async for _ in self.clock.ticks(REQUEST_TIMING.rate):
                    if transport is None or transport.is_closing():
                        break
                    transport.sendto(FRAME_PROTOCOL.request)
                    self._look()
            finally:
                if transport is not None:
                    transport.close()

    async def _opened(self, take: TakeFrame) -> asyncio.DatagramTransport | None:
        """Return a socket; None if the host is unknown, or not found in time.

        The time is `REQUEST_TIMING.resolve_deadline`.
        """
        loop = asyncio.get_running_loop()
        try:
            async with asyncio.timeout(REQUEST_TIMING.resolve_deadline):
                found = await loop.create_datagram_endpoint(
                    lambda: _Client(self, take), remote_addr=self.address
                )
        except (OSError, TimeoutError) as error:
            self._complain(
                self.clock.now(),
                "address",
                f"{str(error) or 'its address is not found'}; trying again",
            )
            return None
        return found[0]

    def heard(self, frame: PoseFrame) -> None:
        """Note that a frame has arrived."""
        self._heard = self.clock.now()
        self.state = "connected"

    def _look(self) -> None:
        silence = self.clock.now() - self._heard
        if silence > FRAME_TIMEOUT:
            self.state = "silent"
            do = "Is `crazychoir virtual` running there, and does it tell poses at this port?"
            self._complain(
                self.clock.now(), "silent", f"no frame for {silence:.0f} s. {do}"
            )
