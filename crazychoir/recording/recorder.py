"""The recorder of a flight: an actor that writes what the drones of a bus say into a file.

It never holds the flight up: messages are packed as they come, written in batches away from the event loop, and let go
when the disk cannot keep up. What fails in it ends the recording, with the reason, and nothing else.
"""

import asyncio
import logging
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from typing import Any

from crazychoir.bus.port import Bus
from crazychoir.bus.topics import BY_NAME, OBSERVABLE, ROUND, Topic
from crazychoir.errors import error_text
from crazychoir.recording.mcap.file import Entry, RecordingFile, Series
from crazychoir.recording.mcap.messages import MESSAGES, Exchanged, Pack, packer, usual
from crazychoir.runtime.actor import Actor
from crazychoir.runtime.clock import SECOND
from crazychoir.runtime.mailbox import Call

log = logging.getLogger(__name__)
BATCHES = 4.0
"""Hz: a program that is killed loses what came since the last batch."""
MOST_WAITING = 64 << 20
"""Bytes that wait for the disk; what comes then is lost."""


@dataclass
class Recorded:
    """What came of a recording: messages in the file, and those that are not, as the disk was slow or full or no field
    of a message holds them; missed: that were said to who looks on, and that the network did not bring, or too many at
    once; error: why it ended before the flight, empty if it did not.
    """

    file: str
    messages: int
    lost: int
    missed: int
    error: str


class Recorder(Actor):
    """Records observable topics of the drones `ids`, all if not said otherwise.

    observer: an address on a bus without drones, which asks for everything over the network; None on the bus of the
    drones themselves: then each drone reads its own topics, which no other drone and no count of messages notices.
    source: the address that says a topic of drone i.  outcome: what the file says at its end of what came of it, beside
    how many messages were lost, and why it ended: `ended`.
    """

    name = "recorder"

    def __init__(
        self,
        bus: Bus,
        ids: Sequence[int],
        file: RecordingFile,
        observer: int | None = None,
        source: Callable[[Topic, int], int] = lambda topic, i: i,
        outcome: Callable[[], Mapping[str, str]] = dict,
        topics: Sequence[str] = OBSERVABLE,
    ) -> None:
        self.bus = bus
        self.clock = bus.clock
        self.file = file
        self.ended = "its flight has ended"
        self._outcome = outcome
        self._series: dict[tuple[int, str, Any], tuple[Series, Pack]] = {}
        self._waiting: list[Entry] = []
        self._bytes = 0
        self._said = False
        self._numbers: dict[tuple[int, int], int] = {}
        for i in ids:
            for topic in map(BY_NAME.__getitem__, topics):
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
        """Write what has come, a few times a second, until the recording ends."""
        async for _ in self.clock.ticks(BATCHES):
            batch = self._waiting
            self._waiting = []
            self._bytes = 0
            await asyncio.shield(
                self.clock.compute(self.file.write, batch)
            )  # who stops us loses no batch
            if self.file.error:
                log.warning(
                    "recording %s: %s: it ends here, the flight goes on",
                    self.file.path,
                    self.file.error,
                )
                return

    async def on_stop(self) -> None:
        """Write the rest and the index."""
        await self.clock.compute(
            self._finish, self._waiting, {"ended": self.ended, **self._outcome()}
        )

    def _finish(self, batch: list[Entry], outcome: Mapping[str, str]) -> None:
        self.file.write(batch)
        self.file.close(outcome)

    def result(self) -> dict[str, Any]:
        """What came of it."""
        file = self.file
        return asdict(
            Recorded(str(file.path), file.written, file.lost, file.missed, file.error)
        )

    def _open(self, drone: int, topic: Topic, kind: Any) -> tuple[Series, Pack]:
        """The messages of one type under one topic: each type has a series of its own."""
        name = (
            topic.name
            if kind in (usual(topic), Exchanged)
            else f"{topic.name}/{kind.__name__.lower()}"
        )
        message = MESSAGES.get(kind, MESSAGES[dict])
        opened = self._series[drone, topic.name, kind] = (
            Series(drone, name, message),
            packer(message, drone),
        )
        return opened

    def _take(self, drone: int, topic: Topic, value: Any, age: float) -> None:
        """A value has come. Who publishes it must not suffer from what is wrong here."""
        if self.file.error:
            self.file.lost += 1
            return
        came_ns = self.clock.now_ns() + self.clock.epoch_ns
        kind = type(value)
        try:
            series, pack = self._series.get((drone, topic.name, kind)) or self._open(
                drone, topic, kind
            )
            born_ns = max(0, came_ns - round(age * SECOND)) if age else came_ns
            data = pack(value, born_ns)
        except Exception as error:  # noqa: BLE001 - see above
            self._lose(f"{topic.name} of drone {drone}: {error_text(error)}")
            return
        self._bytes += len(data)
        if self._bytes > MOST_WAITING:
            self._lose("the disk is too slow")
            return
        self._waiting.append(Entry(series, came_ns, born_ns, data))

    def _lose(self, why: str) -> None:
        self.file.lost += 1
        if not self._said:
            self._said = True
            log.warning(
                "recording %s: a message is lost: %s; further ones are counted",
                self.file.path,
                why,
            )

    def _rounds(
        self,
        to: int,
        topic: int,
        source: int,
        number: int,
        payload: bytes,
        channel: str,
        flags: int,
        age: float,
    ) -> None:
        """A message has arrived: one of a round is recorded under its sender."""
        if self._next is not None:
            self._next(to, topic, source, number, payload, channel, flags, age)
        if topic == ROUND.number:
            self._take(
                source, ROUND, Exchanged(to, number, flags, channel, payload), age
            )

    def _count(
        self,
        to: int,
        topic: int,
        source: int,
        number: int,
        payload: bytes,
        channel: str,
        flags: int,
        age: float,
    ) -> None:
        """A message has arrived: those of a topic that came between it and the one before have not.

        A latched value has no number, and one that begins anew is of an agent that was started again.
        """
        if self._next is not None:
            self._next(to, topic, source, number, payload, channel, flags, age)
        if number:
            before = self._numbers.get((source, topic), number)
            self._numbers[source, topic] = number
            self.file.missed += max(0, number - before - 1)
