"""One MCAP file while it grows: it consists of whole chunks, so it is readable after any failure.

    magic, header, metadata, attachments (swarm file, mission),
    chunk, chunk, ..., metadata, index, footer, magic

If the process is killed, all chunks that it has written remain, because the operating system holds
them. If the machine loses power, the chunks on the disk remain: in real time, all but those of the
last second or two.
"""

import contextlib
import os
import threading
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from mcap.well_known import MessageEncoding, SchemaEncoding

from crazychoir.errors import ConfigError, error_text
from crazychoir.files.path_texts import readable_texts
from crazychoir.recording.mcap.messages import RecordedForm
from crazychoir.recording.mcap.writer import McapWriter, Timed
from crazychoir.runtime.clock import NS_PER_SECOND


@dataclass(frozen=True, slots=True)
class RecordingFormat:
    """The parts of a recording in an MCAP file."""

    about_record: str = "crazychoir"
    """Name of the record that says what was flown."""
    outcome_record: str = "crazychoir outcome"
    """Name of the record with the outcome of the flight."""
    unknown_ending: str = "no reason was recorded"
    """Outcome of a recording that was ended without a reason."""
    swarm_attachment: str = "swarm.json"
    """Name of the attachment with the swarm."""
    mission_attachment: str = "mission.py"
    """Name of the attachment with the mission."""
    suffix: str = ".mcap"
    """Suffix of the file's name."""


RECORDING_FORMAT = RecordingFormat()


LARGEST_CHUNK = 4 << 20
"""Bytes of messages in a chunk after which it is closed, before compression."""


VIEW_KEY = "view"
"""Key in the metadata of a channel that only viewers read."""


@dataclass(eq=False)
class Series:
    """The messages of one topic of one drone."""

    drone: int
    """Id of the drone."""
    topic: str
    """Name of the topic."""
    message: RecordedForm
    """Type of the messages."""
    id: int = 0
    """Number of its MCAP channel; 0 before its first message is written."""

    @property
    def name(self) -> str:
        """Its name as tools show it."""
        return f"/drone{self.drone}/{self.topic}"

    @property
    def type(self) -> str:
        """Type of its messages in the notation of ROS 2."""
        return self.message.type

    @property
    def schema(self) -> str:
        """Definition of that type."""
        return self.message.schema

    @property
    def told(self) -> dict[str, str]:
        """What its channel tells readers."""
        return {"drone": str(self.drone), "topic": self.topic}


@dataclass(eq=False)
class ViewSeries:
    """Messages that only viewers read; they are made of recorded messages, and repeat them."""

    name: str
    """Its name as tools show it."""
    type: str
    """Type of its messages in the notation of ROS 2."""
    schema: str
    """Definition of that type."""
    id: int = 0
    """Number of its MCAP channel; 0 before its first message is written."""

    @property
    def told(self) -> dict[str, str]:
        """What its channel tells readers."""
        return {VIEW_KEY: self.name}


@dataclass(slots=True)
class RecordingEntry:
    """One message on its way to the file."""

    series: Series | ViewSeries
    """The series that it belongs to."""
    came_ns: int
    """Time of arrival, ns."""
    born_ns: int
    """Time of birth, ns."""
    data: bytes
    """Its bytes."""


class Views(Protocol):
    """Adds messages for viewers to those of a recording."""

    def extend(self, entries: Sequence[RecordingEntry]) -> list[RecordingEntry]:
        """Return these entries, at least one, and after some of them a message for viewers."""
        ...


class RecordingFile:
    """A new file for a recording.

    Later failures raise nothing: `error` then says what ended the recording, and the file keeps
    what it has. `write` and `close` may be called from any thread.

    path: the file
    about: what was flown, as texts
    swarm: the swarm file
    durable: True to have all on the disk within a second or two; writing then waits for the disk
        and should be done in a thread
    mission: text of the mission's file
    views: adds messages for viewers; None for none
    Raises ConfigError if the file exists already or cannot be made.
    """

    def __init__(
        self,
        path: Path,
        about: Mapping[str, str],
        swarm: str,
        durable: bool,
        mission: str = "",
        views: Views | None = None,
    ) -> None:
        self.path = path
        self.durable = durable
        self.written = 0
        """Messages in the file, without the messages for viewers."""
        self.lost = 0
        """Messages that are not in the file: not written, or counted as lost by the recorder."""
        self.missed = 0
        """Messages that did not come to the recorder, which counts them."""
        self.error = ""
        self._fd = _create(path)
        self._turn = threading.Lock()
        self._synced_ns = 0
        self._outcome: dict[str, str] = {}
        self._schemas: dict[str, int] = {}
        self._views = views
        self._writer = McapWriter()
        self._writer.begin(profile="ros2", library=f"crazychoir {about['version']}")
        self._writer.metadata(RECORDING_FORMAT.about_record, readable_texts(about))
        self._writer.attachment(
            RECORDING_FORMAT.swarm_attachment, "application/json", swarm.encode()
        )
        if mission:
            self._writer.attachment(
                RECORDING_FORMAT.mission_attachment, "text/x-python", mission.encode()
            )
        if not self._put(sync=durable):
            self.close()
            raise ConfigError(
                "--record", str(path), "a disk with room", problem=self.error
            )

    def write(self, entries: Sequence[RecordingEntry]) -> None:
        """Add these messages as chunks of their own; after a failure they are lost."""
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

    def note(self, outcome: Mapping[str, str]) -> None:
        """Keep texts about the outcome for the end of the file; `ended` is the reason of the end."""
        self._outcome |= outcome

    def close(self, outcome: Mapping[str, str] | None = None) -> None:
        """End the file with the outcome and the index; a file without a message is removed.

        outcome: more texts, as for `note`. The counts of lost and missed messages are always added.
        """
        with self._turn:
            if self._fd < 0:
                return
            if self.written and not self.error:
                said = {
                    "lost": str(self.lost),
                    "missed": str(self.missed),
                    "ended": RECORDING_FORMAT.unknown_ending,
                    **self._outcome,
                    **(outcome or {}),
                }
                self._writer.metadata(
                    RECORDING_FORMAT.outcome_record, readable_texts(said)
                )
                self._writer.finish()
                self._put(sync=self.durable)
            os.close(self._fd)
            self._fd = -1
            if not self.written:
                self.path.unlink(missing_ok=True)

    def _add(self, entries: Sequence[RecordingEntry]) -> None:
        messages: list[Timed] = []
        size = 0
        shown = entries if self._views is None else self._views.extend(entries)
        for entry in shown:
            series = entry.series
            series.id = series.id or self._channel(series)
            messages.append((series.id, entry.came_ns, entry.born_ns, entry.data))
            size += len(entry.data)
            if size > LARGEST_CHUNK:
                self._writer.chunk(messages)
                messages = []
                size = 0
        if messages:
            self._writer.chunk(messages)
        now_ns = entries[-1].came_ns
        due = self.durable and now_ns - self._synced_ns >= NS_PER_SECOND
        if self._put(sync=due):
            self.written += len(entries)
            self._synced_ns = now_ns if due else self._synced_ns

    def _channel(self, series: Series | ViewSeries) -> int:
        kind = series.type
        if kind not in self._schemas:
            self._schemas[kind] = self._writer.schema(
                kind, SchemaEncoding.ROS2, series.schema
            )
        return self._writer.channel(
            series.name, MessageEncoding.CDR, self._schemas[kind], series.told
        )

    def _put(self, sync: bool) -> bool:
        """Write the bytes that are ready.

        After a failure the file is truncated to its last whole chunk. Return False if writing has
        failed.
        """
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


def require_new_recording(path: Path) -> None:
    """Raise ConfigError for a name that no reader would accept, or a file that is there already."""
    _require_suffix(path)
    if path.exists():
        raise _describe_existing(path)


def _require_suffix(path: Path) -> None:
    if path.suffix != RECORDING_FORMAT.suffix:
        raise ConfigError(
            "--record",
            str(path),
            f"a new file whose name ends in {RECORDING_FORMAT.suffix}, for example flight{RECORDING_FORMAT.suffix}",
        )


def _describe_existing(path: Path) -> ConfigError:
    do = "A recording is never written over."
    problem = "there is one already"
    return ConfigError("--record", str(path), "name a new file", do, problem)


def _create(path: Path) -> int:
    _require_suffix(path)
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
        raise _describe_existing(path) from error
    except OSError as error:
        do = "Name a file in a folder of yours."
        raise ConfigError(
            "--record", str(path), "a file that can be made", do, str(error.strerror)
        ) from error
