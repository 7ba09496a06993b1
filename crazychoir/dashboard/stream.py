"""The WebSocket to each page: PAGE_DATA.state_rate frames a second, news as they come, and the page's requests."""

import asyncio
import logging
import math
from collections import deque
from collections.abc import Callable, Coroutine
from dataclasses import asdict, dataclass
from enum import IntEnum
from typing import Any, Protocol

import msgspec

from crazychoir.dashboard.commands import CommandDesk
from crazychoir.dashboard.event_log import EventLog
from crazychoir.dashboard.model import PAGE_DATA, SwarmModel
from crazychoir.dashboard.polling import Overview, TaskBoard
from crazychoir.dashboard.requests import Message, Stop, decode_page_message
from crazychoir.errors import CrazyChoirError, error_text
from crazychoir.files.path_texts import json_bytes
from crazychoir.runtime.actor import Actor
from crazychoir.runtime.clock import Clock

log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class StreamLimits:
    """Limits of the open pages and of their messages."""

    table_rate: float = 2.0
    """Hz: rate of the table of drones."""
    most_pages: int = 32
    """Largest number of open pages."""
    most_messages: int = 60
    """Messages of a page within STREAM_LIMITS.counting_time s; further ones are refused, except stops."""
    flood_messages: int = 600
    """Messages of a page within STREAM_LIMITS.counting_time s after which the page is closed."""
    counting_time: float = 2.0
    """Seconds over which messages of a page are counted."""
    notice_interval: float = 1.0
    """Least time in seconds between two notices that tell a page that it sends too much."""


STREAM_LIMITS = StreamLimits()


class CloseCode(IntEnum):
    """Codes with which the WebSocket of a page is closed (RFC 6455; IANA's registry)."""

    POLICY_VIOLATION = 1008
    """WebSocket close code: the page has broken a rule."""
    TRY_AGAIN_LATER = 1013
    """WebSocket close code: try again later."""


class Socket(Protocol):
    """The part of an accepted WebSocket that is needed here.

    All methods raise ConnectionError when the page is gone.
    """

    async def send_bytes(self, data: bytes) -> None:
        """Send one binary message."""
        ...

    async def send_text(self, data: str) -> None:
        """Send one text."""
        ...

    async def receive_text(self) -> str:
        """Return the next text."""
        ...

    async def close(self, code: int, reason: str | None = None) -> None:
        """Close the WebSocket."""
        ...


Work = Callable[[], Coroutine[Any, Any, dict[str, Any] | None]]
"""Work that takes a while; it returns the answer for the page that asked for it, or None."""


class RequestHandler(Protocol):
    """Carries out a page's requests."""

    def asked(self, message: Message) -> Work | None:
        """Carry out the message, or return the work if it takes a while.

        Both raise CrazyChoirError with the reason if it cannot be done.
        """
        ...


class _MessageRate:
    """Rate of the messages of one page."""

    def __init__(self, clock: Clock) -> None:
        self.clock = clock
        self._all, self._taken = (
            deque[float](maxlen=STREAM_LIMITS.flood_messages),
            deque[float](maxlen=STREAM_LIMITS.most_messages),
        )
        self._told = -math.inf

    def takes(self) -> bool:
        """Count one message and return whether it is accepted."""
        now = self.clock.now()
        self._all.append(now)
        if (
            len(self._taken) == STREAM_LIMITS.most_messages
            and now - self._taken[0] < STREAM_LIMITS.counting_time
        ):
            return False
        self._taken.append(now)
        return True

    def tells(self) -> bool:
        """Return whether it is time to tell the page that it sends too much."""
        now = self.clock.now()
        due = now - self._told >= STREAM_LIMITS.notice_interval
        self._told = now if due else self._told
        return due

    @property
    def flood(self) -> bool:
        """Whether the page sends so much that it must be closed."""
        return (
            len(self._all) == STREAM_LIMITS.flood_messages
            and self._all[-1] - self._all[0] < STREAM_LIMITS.counting_time
        )


class PageStream(Actor):
    """All open pages. A slow page gets fewer frames, and no other page waits for it."""

    name = "stream"

    def __init__(
        self,
        model: SwarmModel,
        desk: CommandDesk,
        watch: EventLog,
        overview: Overview,
        board: TaskBoard,
    ) -> None:
        self.overview = overview
        self.board = board
        self.model = model
        self.desk = desk
        self.watch = watch
        self.clock = model.bus.clock
        self.pages = 0
        self.frame = b""
        self.table = b""
        self.tables = 0  # number of tables made so far
        self._tick: asyncio.Future[None] = self.clock.future()

    async def run(self) -> None:
        """Make each frame once for all pages."""
        every = round(PAGE_DATA.state_rate / STREAM_LIMITS.table_rate)
        count = 0
        async for _ in self.clock.ticks(PAGE_DATA.state_rate):
            self.overview.watched = self.board.watched = self.pages > 0
            if not self.pages:
                continue
            self.frame = self.model.frame()
            if count % every == 0:
                self.table = json_bytes(self.news())
                self.tables = self.tables + 1
            count += 1
            self.wake()

    def wake(self) -> None:
        """Let every page check for news."""
        tick = self._tick
        self._tick = self.clock.future()
        tick.set_result(None)

    def news(self) -> dict[str, Any]:
        """Return the data that change slowly."""
        return {
            "ended": self.desk.ended(),
            "drones": self.model.table(),
            "costs": self.model.costs(),
            "tasks": self.board.tasks,
            **self.overview.news(),
        }

    async def serve(self, socket: Socket, answering: RequestHandler) -> None:
        """Serve one page until it is gone."""
        if self.pages >= STREAM_LIMITS.most_pages:
            await socket.close(
                CloseCode.TRY_AGAIN_LATER,
                f"{STREAM_LIMITS.most_pages} pages look on already",
            )
            return
        self.pages += 1
        telling = asyncio.create_task(self._tell(socket))
        hearing = asyncio.create_task(self._hear(socket, answering))
        try:
            await asyncio.wait([telling, hearing], return_when=asyncio.FIRST_COMPLETED)
        finally:
            self.pages -= 1
            for task in (telling, hearing):
                task.cancel()
            await asyncio.gather(telling, hearing, return_exceptions=True)
        for task in (telling, hearing):
            error = None if task.cancelled() else task.exception()
            if error is not None and not _is_gone(error):
                raise error

    async def _tell(self, socket: Socket) -> None:
        await socket.send_text(_json_text({"about": self.model.about()}))
        told = 0
        logs = {"log": self.watch, "console": self.model.console}
        lines = dict.fromkeys(logs, 0)
        version = 0
        frame = b""
        while True:
            await asyncio.shield(self._tick)
            if self.frame is not frame:
                frame = self.frame
                await socket.send_bytes(frame)
            if self.desk.book.version > version:
                receipts = self.desk.book.after(version)
                version = self.desk.book.version
                await socket.send_text(
                    _json_text({"receipts": [asdict(receipt) for receipt in receipts]})
                )
            for kind, watch in logs.items():
                if watch.count > lines[kind]:
                    fresh = watch.after(lines[kind])
                    lines[kind] = watch.count
                    await socket.send_text(
                        _json_text({kind: [asdict(one) for one in fresh]})
                    )
            if self.tables != told:
                told = self.tables
                await socket.send_text(self.table.decode())

    async def _hear(self, socket: Socket, answering: RequestHandler) -> None:
        """Receive the messages of a page.

        No request waits for an earlier one: a stop may come while a drawing is planned. Commands
        are given before the next message is read, even if the page has gone by then.
        """
        pace = _MessageRate(self.clock)
        async with asyncio.TaskGroup() as group:
            while True:
                text = await socket.receive_text()
                reply = self._asked(text, answering, pace)
                if pace.flood:
                    await socket.close(
                        CloseCode.POLICY_VIOLATION,
                        f"{STREAM_LIMITS.flood_messages} messages in {STREAM_LIMITS.counting_time:g} s",
                    )
                    raise ConnectionError("closed")
                if reply is not None:
                    group.create_task(self._reply(socket, reply))

    def _asked(
        self, text: str, answering: RequestHandler, pace: _MessageRate
    ) -> Work | dict[str, Any] | None:
        """Return the answer to the page, or the work that returns it."""
        message = _decode_message(text)
        if not isinstance(message, Stop) and not pace.takes():
            why = (
                f"what a page asks for beyond {STREAM_LIMITS.most_messages} messages in "
                f"{STREAM_LIMITS.counting_time:g} s"
            )
            return self._not_done(why) if pace.tells() else None
        if isinstance(message, Exception):
            return self._refused(message)
        try:
            return answering.asked(message)
        except Exception as error:  # noqa: BLE001 - the page is told; its line stays
            return self._refused(error)

    async def _reply(self, socket: Socket, reply: Work | dict[str, Any]) -> None:
        told = reply if isinstance(reply, dict) else await self._done(reply)
        if told is not None:
            await socket.send_text(_json_text(told))

    async def _done(self, work: Work) -> dict[str, Any] | None:
        try:
            return await work()
        except Exception as error:  # noqa: BLE001 - the page is told; its line stays
            return self._refused(error)

    def _refused(self, error: Exception) -> dict[str, Any]:
        """Return the reason for the page; log unexpected errors with their traceback."""
        why = str(error)
        if not isinstance(error, CrazyChoirError | msgspec.MsgspecError):
            why = error_text(error)
            log.error("what a page asked for failed: %s", why, exc_info=error)
        return self._not_done(why)

    def _not_done(self, why: str) -> dict[str, Any]:
        self.watch.add(f"not done: {why}", "warning")
        return {"refused": why}


def _decode_message(text: str) -> Message | Exception:
    """Return the message, or the error if the text is not a valid message."""
    try:
        return decode_page_message(text)
    except Exception as error:  # noqa: BLE001 - the page is told, whatever is wrong with its text
        return error


def _is_gone(error: BaseException) -> bool:
    """Return whether the error says only that the page is gone."""
    if isinstance(error, BaseExceptionGroup):
        return all(map(_is_gone, error.exceptions))
    return isinstance(error, ConnectionError)


def _json_text(value: Any) -> str:
    return json_bytes(value, enc_hook=str).decode()
