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
from types import MethodType
from typing import Any

from cflib.crazyflie import Crazyflie
from cflib.crazyflie.log import LogConfig
from cflib.crazyflie.param import ParamTocElement
from cflib.crazyflie.toc import TocFetcher
from cflib.crtp.crtpstack import CRTPPacket

from crazychoir.config.radio_checks import RADIO_TRAFFIC
from crazychoir.errors import LinkFailed, error_text
from crazychoir.radio.link import drivers
from crazychoir.radio.link.dongles import PROCESS_DONGLES, DongleFailed
from crazychoir.radio.link.round_trips import ECHO_CHANNEL, RoundTrips
from crazychoir.radio.link.toc_cache import TableOfContents
from crazychoir.radio.link.writer import PacketWriter
from crazychoir.radio.protocol.crtp import CrtpPort, Packet
from crazychoir.runtime.clock import NS_PER_SECOND, Clock

log = logging.getLogger(__name__)
VERSION_REQUEST = Packet(CrtpPort.LINK, 1, b"\x00")
"""Packet that makes the drone tell its protocol version to cflib."""
LEAST_VERSION = 0
"""Least protocol version; cflib gives a negative number before the drone has told its version."""


@dataclass(frozen=True, slots=True)
class LinkTiming:
    """Times of the requests, threads and closing of a connection."""

    retry_period: float = 0.25
    """s: time after which an unanswered request is sent again."""
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
LOG_DATA_CHANNEL = 2
"""Channel of log data."""
RESET_LOGS = Packet(CrtpPort.LOG, 1, b"\x05")
"""Packet that makes the drone drop its log blocks."""

LogCallback = Callable[[dict[str, float], int], None]
"""Callback: called with log variables, and ms since the drone's start at which they were taken."""


class Connection:
    """One link to a drone. Call its methods from the event loop; none of them blocks it.

    uri: address as cflib takes it
    contents: tables of contents, shared by all links of the process
    lost: called with a reason when an open link has failed
    heard: called with each packet except logs and echoes
    turn: waits until a packet may be sent
    """

    def __init__(
        self,
        clock: Clock,
        uri: str,
        contents: TableOfContents,
        lost: Callable[[str], None] = lambda reason: None,
        heard: Callable[[Packet], None] = lambda packet: None,
        turn: Callable[[], None] = lambda: None,
    ) -> None:
        drivers.register_drivers()
        self.clock = clock
        self.uri = uri
        self._lost = lost
        self._heard = heard
        self._turn = turn
        self._loop = asyncio.get_running_loop()
        self._contents = contents
        self._asked: list[tuple[Callable[[Packet], bool], asyncio.Future[Packet]]] = []
        self._opened: asyncio.Future[None] = self._loop.create_future()
        self._over = False
        self._writer: PacketWriter | None = None
        self._heard_ns: int | None = None
        self._echoing: asyncio.Task[None] | None = None
        self._trips = RoundTrips()
        self.rssi = math.nan
        """dBm: signal strength of a radio; NaN if unknown."""
        self.cf = self._crazyflie(contents)

    def _crazyflie(self, contents: TableOfContents) -> Crazyflie:
        """Return cflib's object with our callbacks.

        It takes its tables from the cache, and reads a parameter only on request.
        """
        cf = Crazyflie()
        cf._toc_cache = contents
        # cflib's own refresh also reads the memories of decks, and never ends if one fails.
        cf.mem.refresh = _skip_memories
        cf.remove_port_callback(CrtpPort.MEMORY, cf.mem._new_packet_cb)
        cf.param.request_update_of_all_params = _do_nothing
        cf.param.refresh_toc = MethodType(_load_parameter_table, cf.param)
        cf.connected.add_callback(lambda uri: self._from_thread(self._is_open))
        cf.connection_failed.add_callback(
            lambda uri, message: self._from_thread(self._failed, message)
        )
        cf.connection_lost.add_callback(
            lambda uri, message: self._from_thread(self._failed, message)
        )
        cf.packet_received.add_callback(self._received)
        _disable_echoes(cf)
        cf.link_statistics.uplink_rssi_updated.add_callback(self._set_rssi)
        return cf

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
        try:
            await self._until_open(seconds)
        except TimeoutError:
            if self._heard_ns is None or not tables:
                raise LinkFailed(
                    self.uri, f"{self.stage} within {seconds:.3g} s"
                ) from None
            await self._until_told(seconds, tables)
        self._writer = PacketWriter(
            self.uri, self._put, self._turn, partial(drivers.has_room, self.cf)
        )
        self._echoing = self._loop.create_task(self._echo())

    async def _until_told(self, seconds: float, tables: float) -> None:
        try:
            await self._until_open(tables)
        except TimeoutError:
            raise LinkFailed(
                self.uri, f"{self.stage} within {seconds + tables:.3g} s"
            ) from None

    async def _until_open(self, seconds: float) -> None:
        async with asyncio.timeout(seconds):
            while not self._opened.done():
                await asyncio.wait([self._opened], timeout=LINK_TIMING.retry_period)
                if not self._opened.done() and self.cf.link is not None:
                    if gone := self.dongle_failure:
                        raise DongleFailed(self.uri, gone)
                    if self.version < LEAST_VERSION:
                        self._to_thread(VERSION_REQUEST)  # cflib itself asks only once
            self._opened.result()

    async def _echo(self) -> None:
        """Send echoes as ordinary packets.

        cflib's own thread for echoes competes with other packets, and hangs when the air is full.
        """
        async for _ in self.clock.ticks(RADIO_TRAFFIC.echo_rate):
            self.newest("echo", self._trips.echo())

    def _open(self) -> None:
        """Open the link with cflib, which may never return."""
        try:
            self.cf.open_link(self.uri)
        except Exception as error:  # noqa: BLE001 - whatever it is, whoever waits is told
            self._from_thread(self._failed, error_text(error))
        if self._over:
            self._close_link()  # `close` was called before the link was open

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
        self._over = True
        if self.cf.incoming.ident is not None:
            self._contents.forget(self.cf.incoming.ident)
        if not self._opened.done():
            self._opened.cancel()
        for _, waiting in self._asked:
            waiting.cancel()
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
        self._close_link()
        cf.incoming.stop()
        for timer in list(cf._answer_patterns.values()):
            timer.cancel()
        cf._answer_patterns = {}
        cf.disconnected.call(self.uri)
        if cf.incoming.is_alive():
            cf.incoming.join(LINK_TIMING.thread_deadline)
        self._quietly(_resolve_waiting, closed)

    def _close_link(self) -> None:
        link = self.cf.link
        self.cf.link = None
        if link is not None:
            link.close()

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
                self._to_thread(packet)

    def newest(self, kind: str, packet: Packet) -> None:
        """Send a packet in place of the waiting one of the same kind."""
        if self._writer is not None:
            self._writer.newest(kind, packet)

    def forget(self, kind: str) -> None:
        """Drop the waiting packet of this kind."""
        if self._writer is not None:
            self._writer.forget(kind)

    async def ask(
        self,
        packet: Packet,
        answers: Callable[[Packet], bool],
        seconds: float,
        again: float = LINK_TIMING.retry_period,
    ) -> Packet:
        """Send a packet until the answer arrives; return the answer.

        answers: returns whether a packet is the answer
        seconds: s: deadline
        again: s between two sends; infinite for a packet that must not be sent twice
        Raises TimeoutError at the deadline.
        """
        waiting: asyncio.Future[Packet] = self._loop.create_future()
        entry = (answers, waiting)
        self._asked.append(entry)
        try:
            async with asyncio.timeout(seconds):
                while not waiting.done():
                    self.send(packet)
                    await asyncio.wait(
                        [waiting], timeout=None if math.isinf(again) else again
                    )
                return waiting.result()
        finally:
            self._asked.remove(entry)

    @property
    def silence(self) -> float:
        """Seconds since the last packet from the drone; infinite before the first."""
        return (
            math.inf
            if self._heard_ns is None
            else (self.clock.now_ns() - self._heard_ns) / NS_PER_SECOND
        )

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
        """Let the drone send log variables.

        name: name of the log block
        period: s, a multiple of 0.01
        data: called with each set of values
        seconds: s: deadline for the drone to start
        Raises LinkFailed if the drone does not start in time.
        """
        if self._writer is None:
            raise LinkFailed(self.uri, f"log {name}: its link is not open")
        config = LogConfig(name, round(1000.0 * period))
        for variable in variables:
            config.add_variable(variable)
        started = self._loop.create_future()
        config.data_received_cb.add_callback(
            lambda at, values, block: self._from_thread(data, values, at)
        )
        config.started_cb.add_callback(partial(self._begun, started))
        config.error_cb.add_callback(
            lambda block, message: self._from_thread(
                _fail_waiting, started, str(message)
            )
        )
        try:
            self.cf.log.add_config(config)
        except (KeyError, AttributeError) as error:
            raise LinkFailed(self.uri, f"log {name}: {error}") from error
        threading.Thread(
            target=config.start, name=f"{self.uri} log", daemon=True
        ).start()
        try:
            async with asyncio.timeout(seconds):
                await started
        except TimeoutError:
            raise LinkFailed(
                self.uri, f"log {name} was not begun within {seconds:g} s"
            ) from None

    @property
    def failure(self) -> str:
        """Error of a packet that could not be sent; empty if there was none.

        Reading this property clears it.
        """
        return "" if self._writer is None else self._writer.failed()

    def _begun(self, started: "asyncio.Future[None]", block: Any, on: bool) -> None:
        """Note that a log block has started; called from a thread of cflib.

        cflib also calls it for a block that the drone refuses to start; `on` is then false.
        """
        if on:
            self._from_thread(_resolve_waiting, started)
        else:
            self._from_thread(_fail_waiting, started, "the drone does not begin it")

    async def reset_logs(self, seconds: float) -> None:
        """Let the drone drop all its log blocks.

        Raises LinkFailed if it does not confirm in time.
        """
        try:
            await self.ask(
                RESET_LOGS,
                lambda p: p[:2] == RESET_LOGS[:2] and p.data[:1] == RESET_LOGS.data,
                seconds,
            )
        except TimeoutError:
            raise LinkFailed(
                self.uri, f"its logs were not reset within {seconds:g} s"
            ) from None
        self.cf.log.log_blocks = []

    def _to_thread(self, packet: Packet) -> None:
        threading.Thread(target=self._try, args=(packet,), daemon=True).start()

    def _try(self, packet: Packet) -> None:
        with contextlib.suppress(LinkFailed):
            self._put(packet)

    def _put(self, packet: Packet) -> bool:
        """Put a packet on the link; return False if there is no room.

        Called from the writer's thread. It bypasses cflib's send lock, which a blocked sender would
        hold.
        """
        out = CRTPPacket()
        out.set_header(packet.port, packet.channel)
        out.data = packet.data
        if (link := self.cf.link) is None:
            raise LinkFailed(self.uri, "its link is closed")
        echoes = packet[:2] == (CrtpPort.LINK, ECHO_CHANNEL)
        if echoes:
            self._trips.left(packet, self.clock.now())  # note it before it can return
        went = link.send_packet(out) is not False
        if echoes and not went:
            self._trips.stayed(packet)
        return went

    # From cflib's threads -------------------------------------------------------------------------

    def _from_thread(self, function: Callable[..., None], *arguments: Any) -> None:
        if not self._over:
            self._quietly(function, *arguments)

    def _quietly(self, function: Callable[..., None], *arguments: Any) -> None:
        with contextlib.suppress(RuntimeError):  # the loop has ended
            self._loop.call_soon_threadsafe(function, *arguments)

    def _received(self, packet: CRTPPacket) -> None:
        self._heard_ns = self.clock.now_ns()
        port = packet.port
        channel = packet.channel
        if port == CrtpPort.LINK and channel == ECHO_CHANNEL:
            self._trips.came(bytes(packet.data), self.clock.now())
        elif not (port == CrtpPort.LOG and channel == LOG_DATA_CHANNEL):
            self._from_thread(self._arrived, Packet(port, channel, bytes(packet.data)))

    def _set_rssi(self, rssi: float) -> None:
        self.rssi = -float(rssi)

    # In the loop ----------------------------------------------------------------------------------

    def _is_open(self) -> None:
        if not self._opened.done():
            self._opened.set_result(None)

    def _failed(self, message: str) -> None:
        reason = (
            message.strip().splitlines()[-1]
            if message.strip()
            else "no reason is known"
        )
        if CONNECTION_REFUSED in reason and self.uri.startswith("udp"):
            reason = "no virtual drone is there: start `crazychoir virtual` with this swarm file"
        if not self._opened.done():
            gone = self.dongle_failure
            self._opened.set_exception(
                DongleFailed(self.uri, gone) if gone else LinkFailed(self.uri, reason)
            )
        elif self._writer is not None:
            self._lost(reason)

    def _arrived(self, packet: Packet) -> None:
        for answers, waiting in list(self._asked):
            if not waiting.done() and answers(packet):
                waiting.set_result(packet)
        self._heard(packet)


def _resolve_waiting(waiting: "asyncio.Future[None]") -> None:
    if not waiting.done():
        waiting.set_result(None)


def _fail_waiting(waiting: "asyncio.Future[None]", message: str) -> None:
    if not waiting.done():
        waiting.set_exception(LinkFailed("log", message))


def _skip_memories(done: Callable[[], None]) -> None:
    """Replace cflib's reading of all memories at each connection."""
    done()


def _do_nothing() -> None:
    """Replace cflib's reading of all parameters at each connection, and its thread of echoes."""


def _disable_echoes(cf: Crazyflie) -> None:
    """Keep cflib's thread of echoes from starting. Signal strength of a radio is still reported."""
    latency = cf.link_statistics.latency
    latency.start = latency.stop = _do_nothing
    cf.remove_header_callback(latency._ping_response, CrtpPort.LINK, ECHO_CHANNEL)


def _load_parameter_table(
    param: Any, done: Callable[[], None], contents: TableOfContents
) -> None:
    """Replace cflib's loading of the parameter table.

    cflib's own asks for each parameter, one after the other, whether it is persistent.
    """
    TocFetcher(
        param.cf, ParamTocElement, CrtpPort.PARAMETERS, param.toc, done, contents
    ).start()
