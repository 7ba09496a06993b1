"""One MCAP file as it grows: what was written is whole chunks, so that it can be read whatever ends the program.

    magic, header, metadata, attachments (swarm file, mission), chunk, chunk, ..., metadata, index, footer, magic

A process that is killed leaves all chunks that it has written: they are the operating system's by then. A machine that
loses its power leaves those that are on the disk: in real time, all but those of the last second or two.
"""

import contextlib
import os
import threading
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from mcap.well_known import MessageEncoding, SchemaEncoding

from crazychoir.errors import ConfigError, error_text
from crazychoir.files.path_texts import readable_texts
from crazychoir.recording.mcap.messages import Message
from crazychoir.recording.mcap.writer import Timed, Writer
from crazychoir.runtime.clock import SECOND

ABOUT = "crazychoir"
"""Name of the record that says what was flown."""
OUTCOME = "crazychoir outcome"
"""Name of the record that says what came of it."""
UNKNOWN = "nobody has said why"
SWARM_FILE, MISSION_FILE = "swarm.json", "mission.py"
SUFFIX = ".mcap"
LARGEST = 4 << 20
"""Bytes of the messages of a chunk, before it is compressed."""


@dataclass(eq=False)
class Series:
    """The messages of one topic of one drone; id: of its MCAP channel, 0 before its first message is written."""

    drone: int
    topic: str
    message: Message
    id: int = 0

    @property
    def name(self) -> str:
        """As tools show it."""
        return f"/drone{self.drone}/{self.topic}"


@dataclass(slots=True)
class Entry:
    """One message on its way to the file: when it came and when it was born, in ns."""

    series: Series
    came_ns: int
    born_ns: int
    data: bytes


class RecordingFile:
    """A new file at `path`; raises ConfigError where there is one, or where none can be.

    about: what was flown, as texts;  swarm: the swarm file;  durable: on the disk within a second or two, which a
    thread should wait for;  mission: the text of its file. Later nothing raises: `error` says what ended the recording,
    and the file keeps what it has.
    `write` and `close` may be called from any thread.
    """

    def __init__(
        self,
        path: Path,
        about: Mapping[str, str],
        swarm: str,
        durable: bool,
        mission: str = "",
    ) -> None:
        self.path = path
        self.durable = durable
        self.written = 0
        """Messages in the file."""
        self.lost = 0
        """Messages that are not: what could not be written, and what who records them counts beside."""
        self.missed = 0
        """Messages that did not come to who records, as he counts."""
        self.error = ""
        self._fd = _create(path)
        self._turn = threading.Lock()
        self._synced_ns = 0
        self._schemas: dict[str, int] = {}
        self._writer = Writer()
        self._writer.begin(profile="ros2", library=f"crazychoir {about['version']}")
        self._writer.metadata(ABOUT, readable_texts(about))
        self._writer.attachment(SWARM_FILE, "application/json", swarm.encode())
        if mission:
            self._writer.attachment(MISSION_FILE, "text/x-python", mission.encode())
        if not self._put(sync=durable):
            self.close()
            raise ConfigError(
                "--record", str(path), "a disk with room", problem=self.error
            )

    def write(self, entries: Sequence[Entry]) -> None:
        """Add these as chunks of their own; where that fails, and once it has failed, they are lost."""
        with self._turn:
            before = self.written
            count = len(entries)
            if count and self._fd >= 0 and not self.error:
                try:
                    self._add(entries)
                except Exception as error:  # noqa: BLE001 - whatever it is, it is said, and the flight goes on
                    self.error = error_text(error)
            if count and self.written == before:
                self.lost += count

    def close(self, outcome: Mapping[str, str] | None = None) -> None:
        """End the file with what came of it, and with its index; one without a message goes.

        outcome: texts, of which `ended` is why; how many messages were lost and missed is always said beside them.
        """
        with self._turn:
            if self._fd < 0:
                return
            if self.written and not self.error:
                said = {
                    "lost": str(self.lost),
                    "missed": str(self.missed),
                    "ended": UNKNOWN,
                    **(outcome or {}),
                }
                self._writer.metadata(OUTCOME, readable_texts(said))
                self._writer.finish()
                self._put(sync=self.durable)
            os.close(self._fd)
            self._fd = -1
            if not self.written:
                self.path.unlink(missing_ok=True)

    def _add(self, entries: Sequence[Entry]) -> None:
        messages: list[Timed] = []
        size = 0
        for entry in entries:
            series = entry.series
            series.id = series.id or self._channel(series)
            messages.append((series.id, entry.came_ns, entry.born_ns, entry.data))
            size += len(entry.data)
            if size > LARGEST:
                self._writer.chunk(messages)
                messages = []
                size = 0
        if messages:
            self._writer.chunk(messages)
        now_ns = entries[-1].came_ns
        due = self.durable and now_ns - self._synced_ns >= SECOND
        if self._put(sync=due):
            self.written += len(entries)
            self._synced_ns = now_ns if due else self._synced_ns

    def _channel(self, series: Series) -> int:
        kind = series.message.type
        if kind not in self._schemas:
            self._schemas[kind] = self._writer.schema(
                kind, SchemaEncoding.ROS2, series.message.schema
            )
        told = {"drone": str(series.drone), "topic": series.topic}
        return self._writer.channel(
            series.name, MessageEncoding.CDR, self._schemas[kind], told
        )

    def _put(self, sync: bool) -> bool:
        """Hand over what is whole; what fits only in part is cut off again: the file ends with a whole chunk."""
        good = os.lseek(self._fd, 0, os.SEEK_CUR)
        left = memoryview(self._writer.take())
        try:
            while left:
                left = left[os.write(self._fd, left) :]
            if sync:
                os.fdatasync(self._fd)
        except OSError as error:
            self.error = error.strerror or str(error)
            with contextlib.suppress(OSError):
                os.ftruncate(self._fd, good)
        return not self.error


def check_path(path: Path) -> None:
    """Refuse, before anything is done, a name that no reader would take."""
    if path.suffix != SUFFIX:
        raise ConfigError(
            "--record",
            str(path),
            f"a new file whose name ends in {SUFFIX}, for example flight{SUFFIX}",
        )


def _create(path: Path) -> int:
    check_path(path)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        return os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o666)
    except FileExistsError as error:
        if not path.exists():
            raise ConfigError(
                "--record",
                str(path),
                "a file in a folder",
                problem="its folder is a file",
            ) from error
        do = "A recording is never written over: name another, or remove that one."
        raise ConfigError(
            "--record", str(path), "a new file", do, problem="there is one already"
        ) from error
    except OSError as error:
        do = "Name a file in a folder of yours."
        raise ConfigError(
            "--record", str(path), "a file that can be made", do, str(error.strerror)
        ) from error
