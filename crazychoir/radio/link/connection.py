"""The way to one drone through cflib: opened and closed within deadlines, asked and answered; its threads end here."""

import asyncio
import contextlib
import logging
import math
import threading
from collections.abc import Callable, Iterable
from functools import partial
from types import MethodType
from typing import Any

from cflib.crazyflie import Crazyflie
from cflib.crazyflie.log import LogConfig
from cflib.crazyflie.param import ParamTocElement
from cflib.crazyflie.toc import TocFetcher
from cflib.crtp.crtpstack import CRTPPacket

from crazychoir.config.radio_checks import PINGS
from crazychoir.errors import LinkFailed, error_text
from crazychoir.radio.link import drivers
from crazychoir.radio.link.dongles import DONGLES, DongleFailed
from crazychoir.radio.link.round_trips import ECHO, RoundTrips
from crazychoir.radio.link.toc_cache import TableOfContents
from crazychoir.radio.link.writer import Writer
from crazychoir.radio.protocol.crtp import LINK, LOG, MEMORY, PARAM, Packet
from crazychoir.runtime.clock import SECOND, Clock

log = logging.getLogger(__name__)
SOURCE, VERSION_KNOWN = Packet(LINK, 1, b"\x00"), 0
AGAIN = 0.25
"""s after which what was not answered is asked again."""
ENDS = 0.5
"""s that a thread gets to end."""
CLOSES = 3.0
"""s that closing a link takes at most; threads of cflib that hang in a driver are left behind."""
NOBODY = "Connection refused"
"""Words of an operating system for a port at which nobody listens."""
WORDLESS = "no word of itself"
"""The stage of a connection that is open: what has not come then is a log."""
LOG_DATA = 2
RESET_LOGS = Packet(LOG, 1, b"\x05")

Data = Callable[[dict[str, float], int], None]
"""Called with log variables and the ms, of the drone's time since it was started, at which they were so."""


class Connection:
    """One link to a drone. Its methods are of the event loop; nothing in them waits for cflib.

    uri: as cflib takes it;  contents: shared by all links of the process;  lost: called with a reason when an open link
    has failed;  heard: called with each packet but logs and echoes;  turn: waits until a packet may be sent.
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
        drivers.ready()
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
        self._writer: Writer | None = None
        self._heard_ns: int | None = None
        self._echoing: asyncio.Task[None] | None = None
        self._trips = RoundTrips()
        self.rssi = math.nan
        """dBm, of a radio."""
        self.cf = self._crazyflie(contents)

    def _crazyflie(self, contents: TableOfContents) -> Crazyflie:
        """cflib's object, listened to; it gets its tables from the cache, and reads parameters when they are asked."""
        cf = Crazyflie()
        cf._toc_cache = contents
        cf.mem.refresh = (
            _unread  # it would read those of decks, too, and never end where one fails
        )
        cf.remove_port_callback(MEMORY, cf.mem._new_packet_cb)
        cf.param.request_update_of_all_params = _nothing
        cf.param.refresh_toc = MethodType(_only_contents, cf.param)
        cf.connected.add_callback(lambda uri: self._from_thread(self._is_open))
        cf.connection_failed.add_callback(
            lambda uri, message: self._from_thread(self._failed, message)
        )
        cf.connection_lost.add_callback(
            lambda uri, message: self._from_thread(self._failed, message)
        )
        cf.packet_received.add_callback(self._received)
        _without_echoes(cf)
        cf.link_statistics.uplink_rssi_updated.add_callback(self._set_rssi)
        return cf

    # Open and close ---------------------------------------------------------------------------------------------

    async def open(self, seconds: float, tables: float = 0.0) -> None:
        """Until tables of contents are known; raises LinkFailed, which says how far it came.

        seconds: that it gets to answer;  tables: s more for its tables, once it has.
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
        self._writer = Writer(
            self.uri, self._put, self._turn, partial(drivers.room, self.cf)
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
                await asyncio.wait([self._opened], timeout=AGAIN)
                if not self._opened.done() and self.cf.link is not None:
                    if gone := self.dongle_failure:
                        raise DongleFailed(self.uri, gone)
                    if self.version < VERSION_KNOWN:
                        self._to_thread(SOURCE)  # cflib asks once
            self._opened.result()

    async def _echo(self) -> None:
        """As packets like others: cflib's own thread would compete with them, and hang when the air is full."""
        async for _ in self.clock.ticks(PINGS):
            self.newest("echo", self._trips.echo())

    def _open(self) -> None:
        """cflib's opening, which may never come back."""
        try:
            self.cf.open_link(self.uri)
        except Exception as error:  # noqa: BLE001 - whatever it is, whoever waits is told
            self._from_thread(self._failed, error_text(error))
        if self._over:
            self._close_link()  # it was closed before it was open

    @property
    def version(self) -> int:
        """Of the protocol that the drone speaks; negative before it has said it."""
        version: int = self.cf.platform.get_protocol_version()
        return version

    @property
    def stage(self) -> str:
        """What has not come."""
        if self._opened.done():
            return WORDLESS
        if self._heard_ns is None:
            return "no answer"
        if self.version < VERSION_KNOWN:
            return "it does not say its protocol's version"
        table = self.cf.log.toc  # cflib has none before its answer to the reset of logs
        missing = "parameters" if table is not None and table.toc else "log variables"
        return f"its table of {missing} is not complete"

    async def close(self) -> None:
        """End it without any set-point, so that a drone in flight notices no more than silence."""
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
            async with asyncio.timeout(CLOSES):
                await closed

    def _close(self, closed: "asyncio.Future[None]") -> None:
        cf = self.cf
        if self._writer is not None:
            self._writer.join(ENDS)
        self._close_link()
        cf.incoming.stop()
        for timer in list(cf._answer_patterns.values()):
            timer.cancel()
        cf._answer_patterns = {}
        cf.disconnected.call(self.uri)
        if cf.incoming.is_alive():
            cf.incoming.join(ENDS)
        self._quietly(_resolve, closed)

    def _close_link(self) -> None:
        link = self.cf.link
        self.cf.link = None
        if link is not None:
            link.close()

    # Packets ----------------------------------------------------------------------------------------------------

    def send(self, packet: Packet) -> None:
        """Send this, after all that were sent before."""
        if self._writer is not None:
            self._writer.put(packet)

    def urgent(self, packets: Iterable[Packet]) -> None:
        """Send these before all that waits, also while it is being opened; earlier ones need not be sent any more."""
        if self._writer is not None:
            self._writer.urgent(packets)
        elif self.cf.link is not None:
            for packet in packets:
                self._to_thread(packet)

    def newest(self, kind: str, packet: Packet) -> None:
        """Send this instead of the one of its kind that has not gone yet."""
        if self._writer is not None:
            self._writer.newest(kind, packet)

    def forget(self, kind: str) -> None:
        """What has not gone of this kind does not go any more."""
        if self._writer is not None:
            self._writer.forget(kind)

    async def ask(
        self,
        packet: Packet,
        answers: Callable[[Packet], bool],
        seconds: float,
        again: float = AGAIN,
    ) -> Packet:
        """Send it until an answer comes; raises TimeoutError.

        answers: whether a packet is it;  again: s between two, infinite for what must not be said twice.
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
        """s since the last packet from the drone; infinite before the first."""
        return (
            math.inf
            if self._heard_ns is None
            else (self.clock.now_ns() - self._heard_ns) / SECOND
        )

    @property
    def latency(self) -> float:
        """s, there and back, 95 of 100 echoes; NaN before the first."""
        return self._trips.latency

    @property
    def answered(self) -> float:
        """Share of the last echoes that came back."""
        return self._trips.answered

    @property
    def dongle_failure(self) -> str:
        """Why its dongle cannot be used; empty if it can."""
        return DONGLES.failure(self.uri)

    async def log(
        self,
        name: str,
        variables: Iterable[str],
        period: float,
        data: Data,
        seconds: float,
    ) -> None:
        """Let the drone say variables every `period` s, a multiple of 0.01; LinkFailed if it does not in time."""
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
            lambda block, message: self._from_thread(_fail, started, str(message))
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
        """What a packet that could not be sent has raised since this was asked; empty if all could."""
        return "" if self._writer is None else self._writer.failed()

    def _begun(self, started: "asyncio.Future[None]", block: Any, on: bool) -> None:
        """From a thread of cflib, which says it too of one that the drone refuses to begin, with its whole log."""
        if on:
            self._from_thread(_resolve, started)
        else:
            self._from_thread(_fail, started, "the drone does not begin it")

    async def reset_logs(self, seconds: float) -> None:
        """Let the drone drop all its blocks; LinkFailed if it does not say so in time."""
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
        """From another thread: whether there was room for it. Past cflib's lock, which one that waits would keep."""
        out = CRTPPacket()
        out.set_header(packet.port, packet.channel)
        out.data = packet.data
        if (link := self.cf.link) is None:
            raise LinkFailed(self.uri, "its link is closed")
        echoes = packet[:2] == (LINK, ECHO)
        if echoes:
            self._trips.left(packet, self.clock.now())  # before it can come back
        went = link.send_packet(out) is not False
        if echoes and not went:
            self._trips.stayed(packet)
        return went

    # From cflib's threads -----------------------------------------------------------------------------------------

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
        if port == LINK and channel == ECHO:
            self._trips.came(bytes(packet.data), self.clock.now())
        elif not (port == LOG and channel == LOG_DATA):
            self._from_thread(self._arrived, Packet(port, channel, bytes(packet.data)))

    def _set_rssi(self, rssi: float) -> None:
        self.rssi = -float(rssi)

    # In the loop ----------------------------------------------------------------------------------------------------

    def _is_open(self) -> None:
        if not self._opened.done():
            self._opened.set_result(None)

    def _failed(self, message: str) -> None:
        reason = (
            message.strip().splitlines()[-1]
            if message.strip()
            else "no reason is known"
        )
        if NOBODY in reason and self.uri.startswith("udp"):
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


def _resolve(waiting: "asyncio.Future[None]") -> None:
    if not waiting.done():
        waiting.set_result(None)


def _fail(waiting: "asyncio.Future[None]", message: str) -> None:
    if not waiting.done():
        waiting.set_exception(LinkFailed("log", message))


def _unread(done: Callable[[], None]) -> None:
    """In place of reading memories at each connection."""
    done()


def _nothing() -> None:
    """In place of reading every parameter at each connection."""


def _without_echoes(cf: Crazyflie) -> None:
    """Its thread of echoes never begins, and nobody waits for its end; of a radio, signal strength is told as ever."""
    latency = cf.link_statistics.latency
    latency.start = latency.stop = _nothing
    cf.remove_header_callback(latency._ping_response, LINK, ECHO)


def _only_contents(
    param: Any, done: Callable[[], None], contents: TableOfContents
) -> None:
    """In place of cflib's, which asks of each parameter whether it is persistent, one after the other."""
    TocFetcher(param.cf, ParamTocElement, PARAM, param.toc, done, contents).start()
