"""The recorder of a flight: an actor that writes the messages of a bus into a file.

It never delays the flight. Messages are packed when they come, written in batches outside the
event loop, and dropped when the disk is too slow. A failure ends the recording, with the reason
in the log, and nothing else.
"""

import asyncio
import logging
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from typing import Any

from crazychoir.bus.message import Message
from crazychoir.bus.port import Bus
from crazychoir.bus.topics import (
    MESSAGE_TOPICS,
    OBSERVABLE_TOPICS,
    TOPIC_BY_NAME,
    Topic,
)
from crazychoir.errors import error_text
from crazychoir.recording.mcap.file import RecordingEntry, RecordingFile, Series
from crazychoir.recording.mcap.messages import (
    FORM_BY_VALUE_TYPE,
    Exchanged,
    Pack,
    make_packer,
    usual_type,
)
from crazychoir.runtime.actor import Actor
from crazychoir.runtime.clock import NS_PER_SECOND
from crazychoir.runtime.mailbox import Call

log = logging.getLogger(__name__)
BATCH_RATE = 4.0
"""Batches a second; a program that is killed loses the messages since its last batch."""
MOST_WAITING = 64 << 20
"""Largest number of bytes that wait for the disk; further messages are lost."""


@dataclass
class RecordingOutcome:
    """Outcome of a recording."""

    file: str
    """Path of the file."""
    messages: int
    """Messages in the file."""
    lost: int
    """Messages that came but are not in the file.

    Reasons: the disk was slow or full, or no field of a message can hold a value.
    """
    missed: int
    """Messages that were published for the recorder but did not come.

    The network lost them, or too many came at once.
    """
    error: str
    """Why the recording ended before the flight; empty if it did not."""


class Recorder(Actor):
    """Records observable topics of drones.

    bus: the bus of the drones, or a bus without drones that observes them over the network
    ids: the drones
    file: the file to write
    observer: address of the recorder on a bus without drones; it subscribes to the topics over the
        network. None on the bus of the drones: then each drone reads its own topics, so the
        recorder changes no other drone and no count of messages
    source: returns the address that publishes a topic of drone i
    topics: the topics to record
    leaves_open: whether its maker ends the file, after the recorder has ended
    ended: why the recording ended, for the end of the file
    """

    name = "recorder"

    def __init__(
        self,
        bus: Bus,
        ids: Sequence[int],
        file: RecordingFile,
        observer: int | None = None,
        source: Callable[[Topic, int], int] = lambda topic, i: i,
        topics: Sequence[str] = OBSERVABLE_TOPICS,
        leaves_open: bool = False,
    ) -> None:
        self.bus = bus
        self.clock = bus.clock
        self.file = file
        self.ended = "its flight has ended"
        self._leaves_open = leaves_open
        self._series: dict[tuple[int, str, Any], tuple[Series, Pack]] = {}
        self._waiting: list[RecordingEntry] = []
        self._bytes = 0
        self._said = False
        self._numbers: dict[tuple[int, int], int] = {}
        for i in ids:
            for topic in map(TOPIC_BY_NAME.__getitem__, topics):
                take = partial(self._take, i, topic)
                bus.subscribe(
                    topic,
                    source(topic, i),
                    i if observer is None else observer,
                    Call(self.clock, take),
                )
        self._next = bus.tap
        bus.tap = self._rounds if observer is None else self._count

    async def run(self) -> None:
        """Write the messages that have come, a few times a second, until the recording ends."""
        async for _ in self.clock.ticks(BATCH_RATE):
            batch = self._waiting
            self._waiting = []
            self._bytes = 0
            # A cancellation of this task loses no batch.
            await asyncio.shield(self.clock.compute(self.file.write, batch))
            if self.file.error:
                log.warning(
                    "recording %s: %s: it ends here, the flight goes on",
                    self.file.path,
                    self.file.error,
                )
                return

    async def on_stop(self) -> None:
        """Write the remaining messages, and the index unless the maker of the file does."""
        await self.clock.compute(self._finish, self._waiting)

    def _finish(self, batch: list[RecordingEntry]) -> None:
        self.file.write(batch)
        self.file.note({"ended": self.ended})
        if not self._leaves_open:
            self.file.close()

    def result(self) -> dict[str, Any]:
        """Return the outcome of the recording as a dictionary."""
        file = self.file
        return asdict(
            RecordingOutcome(
                str(file.path), file.written, file.lost, file.missed, file.error
            )
        )

    def _open(self, drone: int, topic: Topic, kind: Any) -> tuple[Series, Pack]:
        """Open the series of one type of messages under one topic.

        Each type has a series of its own.
        """
        name = (
            topic.name
            if kind in (usual_type(topic), Exchanged)
            else f"{topic.name}/{kind.__name__.lower()}"
        )
        message = FORM_BY_VALUE_TYPE.get(kind, FORM_BY_VALUE_TYPE[dict])
        opened = self._series[drone, topic.name, kind] = (
            Series(drone, name, message),
            make_packer(message, drone),
        )
        return opened

    def _take(self, drone: int, topic: Topic, value: Any, age: float) -> None:
        """Pack a value that has come. An error here must not reach the publisher of the value."""
        if self.file.error:
            self.file.lost += 1
            return
        came_ns = self.clock.now_ns() + self.clock.epoch_ns
        kind = type(value)
        try:
            series, pack = self._series.get((drone, topic.name, kind)) or self._open(
                drone, topic, kind
            )
            born_ns = max(0, came_ns - round(age * NS_PER_SECOND)) if age else came_ns
            data = pack(value, born_ns)
        except Exception as error:  # noqa: BLE001 - see above
            self._lose(f"{topic.name} of drone {drone}: {error_text(error)}")
            return
        self._bytes += len(data)
        if self._bytes > MOST_WAITING:
            self._lose("the disk is too slow")
            return
        self._waiting.append(RecordingEntry(series, came_ns, born_ns, data))

    def _lose(self, why: str) -> None:
        self.file.lost += 1
        if not self._said:
            self._said = True
            log.warning(
                "recording %s: a message is lost: %s; further ones are counted",
                self.file.path,
                why,
            )

    def _rounds(self, to: int, message: Message, age: float) -> None:
        """Record a message of a round under its sender; other messages are recorded elsewhere."""
        if self._next is not None:
            self._next(to, message, age)
        if message.topic is MESSAGE_TOPICS.rounds:
            exchanged = Exchanged(
                to, message.number, message.flags, message.channel, message.payload
            )
            self._take(message.source, MESSAGE_TOPICS.rounds, exchanged, age)

    def _count(self, to: int, message: Message, age: float) -> None:
        """Count the messages of a topic that are missing before the message that has arrived.

        A latched value has no number. A number that begins anew is of an agent that was restarted.
        """
        if self._next is not None:
            self._next(to, message, age)
        number = message.number
        if number:
            series = (message.source, message.topic.number)
            before = self._numbers.get(series, number)
            self._numbers[series] = number
            self.file.missed += max(0, number - before - 1)
