"""The connection to one drone through cflib: opening, closing, sending and asking.

Each ends by a deadline. The threads of cflib end here: all other code runs in the event loop.
"""

import asyncio
import contextlib
import logging
import math
import threading
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import partial

from cflib.crtp.crtpstack import CRTPPacket

from crazychoir.config.dongle_plan import RADIO_TRAFFIC
from crazychoir.errors import LinkFailed, error_text
from crazychoir.firmware.requests import LINK_CHANNELS, LOG_CHANNELS
from crazychoir.radio.link import drivers
from crazychoir.radio.link.dongles import PROCESS_DONGLES, DongleFailed
from crazychoir.radio.link.driver_link import DriverLink
from crazychoir.radio.link.log_blocks import LogBlocks, LogCallback
from crazychoir.radio.link.loop_caller import LoopCaller, resolve_waiting
from crazychoir.radio.link.pending_requests import REQUEST_RETRY_PERIOD, PendingRequests
from crazychoir.radio.link.quiet_crazyflie import make_quiet_crazyflie
from crazychoir.radio.link.round_trips import RoundTrips, send_echoes
from crazychoir.radio.link.toc_cache import TableOfContents
from crazychoir.radio.link.writer import PacketWriter
from crazychoir.radio.protocol.crtp import CrtpPort, Packet
from crazychoir.runtime.clock import NS_PER_SECOND, Clock

log = logging.getLogger(__name__)
VERSION_REQUEST = Packet(CrtpPort.LINK, LINK_CHANNELS.source, b"\x00")
"""Packet that makes the drone tell its protocol version to cflib."""
LEAST_VERSION = 0
"""Least protocol version; cflib gives a negative number before the drone has told its version."""


@dataclass(frozen=True, slots=True)
class LinkTiming:
    """Times of the threads and the closing of a connection."""

    thread_deadline: float = 0.5
    """s: time in which a thread may end."""
    close_deadline: float = 3.0
    """s: longest time to close a link; threads of cflib that hang in a driver are left behind.
    """


LINK_TIMING = LinkTiming()


CONNECTION_REFUSED = "Connection refused"
"""Text of the operating system for a port without a listener."""
AWAITING_LOG = "no word of itself"
"""Stage of an open connection that has not yet delivered a log."""


class Connection:
    """One link to a drone. Call its methods from the event loop; none of them blocks it.

    uri: address as cflib takes it
    contents: tables of contents, shared by all links of the process
    lost: called with a reason when an open link has failed
    heard: called with each packet except logs and echoes
    turn: waits until a packet may be sent
    echo_rate: Hz of echoes
    """

    def __init__(
        self,
        clock: Clock,
        uri: str,
        contents: TableOfContents,
        lost: Callable[[str], None] = lambda reason: None,
        heard: Callable[[Packet], None] = lambda packet: None,
        turn: Callable[[], None] = lambda: None,
        echo_rate: float = RADIO_TRAFFIC.echo_rate,
    ) -> None:
        drivers.register_drivers()
        self.clock = clock
        self.uri = uri
        self.cf = make_quiet_crazyflie(contents)
        """Object of cflib."""
        self.rssi = math.nan
        """dBm: signal strength of a radio; NaN if unknown."""
        self._lost = lost
        self._turn = turn
        self._echo_rate = echo_rate
        self._loop = asyncio.get_running_loop()
        self._contents = contents
        self._calls = LoopCaller(self._loop)
        self._requests = PendingRequests(self.send, heard)
        self._logs = LogBlocks(uri, self.cf, self._calls, self._requests)
        self._opened: asyncio.Future[None] = self._loop.create_future()
        self._writer: PacketWriter | None = None
        self._heard_ns: int | None = None
        self._echoing: asyncio.Task[None] | None = None
        self._trips = RoundTrips()
        self._driver = DriverLink(clock, uri, self.cf, self._trips)
        self._add_callbacks()

    def _add_callbacks(self) -> None:
        """Let cflib's threads call the event loop."""
        cf = self.cf
        cf.connected.add_callback(
            lambda uri: self._calls.call(resolve_waiting, self._opened)
        )
        cf.connection_failed.add_callback(
            lambda uri, message: self._calls.call(self._failed, message)
        )
        cf.connection_lost.add_callback(
            lambda uri, message: self._calls.call(self._failed, message)
        )
        cf.packet_received.add_callback(self._received)
        cf.link_statistics.uplink_rssi_updated.add_callback(self._set_rssi)

    # Open and close -------------------------------------------------------------------------------

    async def open(self, seconds: float, tables: float = 0.0) -> None:
        """Open the link, and return when its tables of contents are known.

        seconds: s in which the drone must answer
        tables: s more for its tables once it has answered
        Raises LinkFailed, with the stage that was reached, if a deadline passes.
        """
        threading.Thread(
            target=self._open, name=f"{self.uri} opening", daemon=True
        ).start()
        if not await self._opens_within(seconds):
            if self._heard_ns is None or not tables:
                raise LinkFailed(self.uri, f"{self.stage} within {seconds:.3g} s")
            if not await self._opens_within(tables):
                longest = seconds + tables
                raise LinkFailed(self.uri, f"{self.stage} within {longest:.3g} s")
        self._writer = PacketWriter(
            self.uri, self._driver.put, self._turn, partial(drivers.has_room, self.cf)
        )
        self._echoing = self._loop.create_task(
            send_echoes(self.clock, self._echo_rate, self._trips, self.newest)
        )

    async def _opens_within(self, seconds: float) -> bool:
        """Return whether the link opens in time; ask for the protocol version meanwhile.

        seconds: s
        Raises LinkFailed if the opening fails.
        """
        try:
            async with asyncio.timeout(seconds):
                while not self._opened.done():
                    await asyncio.wait([self._opened], timeout=REQUEST_RETRY_PERIOD)
                    self._ask_version()
                self._opened.result()
        except TimeoutError:
            return False
        return True

    def _ask_version(self) -> None:
        """Ask an opening link for its protocol version: cflib itself asks only once.

        Raises DongleFailed if the dongle cannot be used.
        """
        if self._opened.done() or self.cf.link is None:
            return
        if gone := self.dongle_failure:
            raise DongleFailed(self.uri, gone)
        if self.version < LEAST_VERSION:
            self._driver.put_in_thread(VERSION_REQUEST)

    def _open(self) -> None:
        """Open the link with cflib, which may never return."""
        try:
            self.cf.open_link(self.uri)
        except Exception as error:  # noqa: BLE001 - whatever it is, a waiting task is told
            self._calls.call(self._failed, error_text(error))
        if self._calls.is_closed:
            self._driver.close()  # `close` was called before the link was open

    @property
    def version(self) -> int:
        """Protocol version of the drone; negative while unknown."""
        version: int = self.cf.platform.get_protocol_version()
        return version

    @property
    def stage(self) -> str:
        """The data still missing until the connection is usable."""
        if self._opened.done():
            return AWAITING_LOG
        if self._heard_ns is None:
            return "no answer"
        if self.version < LEAST_VERSION:
            return "it does not say its protocol's version"
        table = self.cf.log.toc  # None until the drone has confirmed the reset of logs
        missing = "parameters" if table is not None and table.toc else "log variables"
        return f"its table of {missing} is not complete"

    async def close(self) -> None:
        """Close the link without a set-point, so that a flying drone notices only silence."""
        self._calls.close()
        if self.cf.incoming.ident is not None:
            self._contents.forget(self.cf.incoming.ident)
        if not self._opened.done():
            self._opened.cancel()
        self._requests.cancel()
        if self._echoing is not None:
            self._echoing.cancel()
        if self._writer is not None:
            self._writer.end()
        closed: asyncio.Future[None] = self._loop.create_future()
        threading.Thread(
            target=self._close, args=(closed,), name=f"{self.uri} closing", daemon=True
        ).start()
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(LINK_TIMING.close_deadline):
                await closed

    def _close(self, closed: "asyncio.Future[None]") -> None:
        cf = self.cf
        if self._writer is not None:
            self._writer.join(LINK_TIMING.thread_deadline)
        self._driver.close()
        cf.incoming.stop()
        for timer in list(cf._answer_patterns.values()):
            timer.cancel()
        cf._answer_patterns = {}
        cf.disconnected.call(self.uri)
        if cf.incoming.is_alive():
            cf.incoming.join(LINK_TIMING.thread_deadline)
        self._calls.call_after_close(resolve_waiting, closed)

    # Packets --------------------------------------------------------------------------------------

    def send(self, packet: Packet) -> None:
        """Send a packet after all earlier ones."""
        if self._writer is not None:
            self._writer.put(packet)

    def urgent(self, packets: Iterable[Packet]) -> None:
        """Send packets before all waiting ones, also while the link is being opened.

        Earlier urgent packets are dropped.
        """
        if self._writer is not None:
            self._writer.urgent(packets)
        elif self.cf.link is not None:
            for packet in packets:
                self._driver.put_in_thread(packet)

    def newest(self, kind: str, packet: Packet) -> None:
        """Send a packet in place of the waiting one of the same kind."""
        if self._writer is not None:
            self._writer.newest(kind, packet)

    def send_at_once(self, packets: Iterable[Packet]) -> None:
        """Put packets on the link without waiting for a turn; for drivers that do not block."""
        self._driver.try_all(packets)

    def forget(self, kind: str) -> None:
        """Drop the waiting packet of this kind."""
        if self._writer is not None:
            self._writer.forget(kind)

    async def ask(
        self,
        packet: Packet,
        answers: Callable[[Packet], bool],
        seconds: float,
        again: float = REQUEST_RETRY_PERIOD,
    ) -> Packet:
        """Send a packet until the answer arrives; `PendingRequests.ask` explains the arguments."""
        return await self._requests.ask(packet, answers, seconds, again)

    @property
    def silence(self) -> float:
        """Seconds since the last packet from the drone; infinite before the first."""
        if self._heard_ns is None:
            return math.inf
        return (self.clock.now_ns() - self._heard_ns) / NS_PER_SECOND

    @property
    def latency(self) -> float:
        """Round trip in s that 95 of 100 echoes do not exceed; NaN before the first."""
        return self._trips.latency

    @property
    def answered(self) -> float:
        """Share of the last echoes that came back; NaN if unknown."""
        return self._trips.answered

    @property
    def dongle_failure(self) -> str:
        """Reason why the dongle cannot be used; empty if it can."""
        return PROCESS_DONGLES.failure(self.uri)

    async def log(
        self,
        name: str,
        variables: Iterable[str],
        period: float,
        data: LogCallback,
        seconds: float,
    ) -> None:
        """Let the drone send log variables; `LogBlocks.begin` explains the arguments.

        Raises LinkFailed if the link is not open, or the drone does not start in time.
        """
        if self._writer is None:
            raise LinkFailed(self.uri, f"log {name}: its link is not open")
        await self._logs.begin(name, variables, period, data, seconds)

    @property
    def failure(self) -> str:
        """Error of a packet that could not be sent; empty if there was none.

        Reading this property clears it.
        """
        return "" if self._writer is None else self._writer.failed()

    async def reset_logs(self, seconds: float) -> None:
        """Let the drone drop all its log blocks.

        Raises LinkFailed if it does not confirm in time.
        """
        await self._logs.reset(seconds)

    # From cflib's threads -------------------------------------------------------------------------

    def _received(self, packet: CRTPPacket) -> None:
        self._heard_ns = self.clock.now_ns()
        port = packet.port
        channel = packet.channel
        if port == CrtpPort.LINK and channel == LINK_CHANNELS.echo:
            self._trips.came(bytes(packet.data), self.clock.now())
        elif not (port == CrtpPort.LOG and channel == LOG_CHANNELS.values):
            self._calls.call(
                self._requests.take, Packet(port, channel, bytes(packet.data))
            )

    def _set_rssi(self, rssi: float) -> None:
        self.rssi = -float(rssi)

    # In the loop ----------------------------------------------------------------------------------

    def _failed(self, message: str) -> None:
        lines = message.strip().splitlines()
        reason = lines[-1] if lines else "no reason is known"
        if CONNECTION_REFUSED in reason and self.uri.startswith("udp"):
            reason = "no virtual drone is there: start `crazychoir virtual` with this swarm file"
        if not self._opened.done():
            gone = self.dongle_failure
            self._opened.set_exception(
                DongleFailed(self.uri, gone) if gone else LinkFailed(self.uri, reason)
            )
        elif self._writer is not None:
            self._lost(reason)
