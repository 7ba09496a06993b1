"""Read a recording; of a truncated file every whole chunk is read."""

import mmap
from array import array
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Metadata, Schema

from crazychoir.bus.topics import TOPIC_BY_NAME
from crazychoir.errors import ConfigError
from crazychoir.recording.mcap.cdr import Layout
from crazychoir.recording.mcap.file import RECORDING_FORMAT
from crazychoir.recording.mcap.messages import FORM_BY_VALUE_TYPE, usual_type
from crazychoir.recording.mcap.records import (
    MESSAGE_HEADER,
    RECORDING_HINT,
    Records,
    body_stream,
    foreign_file_error,
    open_recording,
    records_of,
)
from crazychoir.runtime.clock import NS_PER_SECOND
from crazychoir.types import Mat

STAMP_NUMBERS = 2
"""Count of numbers in a header's stamp."""
EXPECTED_RECORDING = "a recording of a flight"


@dataclass
class RecordedValues:
    """The recorded values of one topic of one drone, the oldest first."""

    came: Mat
    """(n,) s: when each message came, by the recording's clock."""
    born: Mat
    """(n,) s: when each value was born, by the recording's clock."""
    numbers: Mat
    """(n, m): the values of a message after its stamp, in the order of its fields.

    Fields from the first field of variable length on are left out.
    """

    def __len__(self) -> int:
        return len(self.came)


@dataclass
class Recording:
    """A file of a flight."""

    path: Path
    """The file."""
    about: dict[str, str] = field(default_factory=dict)
    """Description of the flight, as texts."""
    swarm: str = ""
    """The swarm file, as text."""
    mission: str = ""
    """Text of the mission's file."""
    outcome: dict[str, str] = field(default_factory=dict)
    """Outcome of a complete recording.

    `ended` says why it ended; a flight in virtual time has its `digest`.
    """
    lost: int = 0
    """Messages that came but are not in the file."""
    missed: int = 0
    """Messages that the network did not bring to the recorder."""
    chunks: int = 0
    """Count of whole chunks with messages."""
    fault: str = "not read"
    """Place where the file is cut off or damaged; empty if it was ended in order."""
    topics: dict[tuple[int, str], RecordedValues] = field(default_factory=dict)
    """Values by (drone, topic)."""

    @property
    def complete(self) -> bool:
        """True if the file was ended in order and is whole."""
        return not self.fault

    @property
    def lacks(self) -> dict[str, Any]:
        """Its completeness, and its counts of lost and missed messages, for JSON."""
        return {"complete": self.complete, "lost": self.lost, "missed": self.missed}

    @property
    def drones(self) -> list[int]:
        """The drones with at least one message."""
        return sorted({drone for drone, _ in self.topics})

    @property
    def seconds(self) -> tuple[float, float]:
        """Times of arrival of the first and the last message, s."""
        came = [values.came for values in self.topics.values()]
        return min(column[0] for column in came), max(column[-1] for column in came)

    def of(self, drone: int, topic: str) -> RecordedValues:
        """Return the values of a topic; empty if it was not recorded."""
        return self.topics.get(
            (drone, topic), RecordedValues(np.zeros(0), np.zeros(0), np.zeros((0, 0)))
        )


def read(path: Path, topics: tuple[str, ...]) -> Recording:
    """Return the recording of these topics.

    Raises ConfigError if the file is no recording, or has no message of these topics.
    """
    recording = _read_recording(path, topics)
    if not recording.topics:
        raise ConfigError(
            str(path),
            f"no {' and no '.join(topics)} of any drone",
            EXPECTED_RECORDING,
            RECORDING_HINT,
        )
    return recording


def read_header(path: Path) -> Recording:
    """Return a recording without its messages: what was flown, the outcome, and the fault.

    Raises ConfigError if the file is no recording, or has no message.
    """
    recording = _read_recording(path, ())
    if not recording.chunks:
        raise ConfigError(
            str(path),
            f"no message: it was {recording.fault or 'ended in order'}",
            EXPECTED_RECORDING,
            RECORDING_HINT,
        )
    return recording


def _read_recording(path: Path, topics: tuple[str, ...]) -> Recording:
    with open_recording(path) as content:
        recording = _read(path, content, topics)
    if not recording.about:
        raise foreign_file_error(path)
    return recording


def _read(path: Path, content: mmap.mmap, topics: tuple[str, ...]) -> Recording:
    recording = Recording(path)
    found = _Series(path, topics)
    whole = Records(content)
    for opcode, body in whole:
        try:
            _take(recording, found, opcode, body)
        except ConfigError:
            raise
        except Exception:  # noqa: BLE001 - the records before a damaged record count
            whole.spoilt()
            break
    recording.topics = found.values()
    recording.fault = whole.fault
    return recording


def _take(recording: Recording, found: "_Series", opcode: int, body: bytes) -> None:
    match opcode:
        case Opcode.METADATA:
            told = Metadata.read(body_stream(body))
            if told.name == RECORDING_FORMAT.about_record:
                recording.about = told.metadata
            elif told.name == RECORDING_FORMAT.outcome_record:
                recording.outcome = told.metadata
                recording.lost, recording.missed = (
                    int(told.metadata.get(name, 0)) for name in ("lost", "missed")
                )
        case Opcode.ATTACHMENT:
            attached = Attachment.read(body_stream(body))
            if attached.name == RECORDING_FORMAT.swarm_attachment:
                recording.swarm = attached.data.decode()
            elif attached.name == RECORDING_FORMAT.mission_attachment:
                recording.mission = attached.data.decode(errors="replace")
        case Opcode.CHUNK:
            recording.chunks += any(
                kind == Opcode.MESSAGE for kind, _ in records_of(body)
            )
            if found.topics:
                found.add(body)


class _ValueColumns:
    """Values of one topic of one drone while they are read: 8 bytes a number."""

    def __init__(self) -> None:
        self._times, self._numbers = array("d"), array("d")

    def __len__(self) -> int:
        return len(self._times) // 2

    def add(self, came_ns: int, born_ns: int, numbers: Sequence[float]) -> None:
        """Add a message; each must have the same count of numbers."""
        self._times.extend((came_ns / NS_PER_SECOND, born_ns / NS_PER_SECOND))
        self._numbers.extend(numbers)

    def values(self) -> RecordedValues:
        """Return all values; there must be at least one message."""
        times = np.frombuffer(self._times).reshape(-1, 2)
        n = len(self)
        return RecordedValues(
            times[:, 0],
            times[:, 1],
            np.frombuffer(self._numbers).reshape(n, len(self._numbers) // n),
        )


class _Series:
    """Values of some topics, collected from chunks."""

    def __init__(self, path: Path, topics: tuple[str, ...]) -> None:
        self._path = path
        self.topics = topics
        self._schemas: dict[int, Schema] = {}
        self._keys: dict[int, tuple[int, str]] = {}
        self._layouts: dict[int, Layout] = {}
        self._found: dict[int, _ValueColumns] = {}

    def add(self, chunk: bytes) -> None:
        """Add the records of a chunk."""
        for opcode, body in records_of(chunk):
            match opcode:
                case Opcode.MESSAGE:
                    self._hear(body)
                case Opcode.SCHEMA:
                    schema = Schema.read(body_stream(body))
                    self._schemas[schema.id] = schema
                case Opcode.CHANNEL:
                    self._open(Channel.read(body_stream(body)))

    def values(self) -> dict[tuple[int, str], RecordedValues]:
        """Return the values by (drone, topic)."""
        return {
            self._keys[channel]: rows.values()
            for channel, rows in sorted(self._found.items())
            if len(rows)
        }

    def _hear(self, body: bytes) -> None:
        channel, _, came_ns, born_ns = MESSAGE_HEADER.unpack_from(body)
        layout = self._layouts.get(channel)
        if layout is not None:
            self._found[channel].add(
                came_ns,
                born_ns,
                layout.numbers(body[MESSAGE_HEADER.size :])[STAMP_NUMBERS:],
            )

    def _open(self, channel: Channel) -> None:
        topic = channel.metadata.get("topic", "")
        if topic not in self.topics or channel.id in self._layouts:
            return
        message = FORM_BY_VALUE_TYPE[usual_type(TOPIC_BY_NAME[topic])]
        schema = self._schemas[channel.schema_id]
        if (schema.name, schema.data.decode()) != (message.type, message.schema):
            do = "Plot it with the version that recorded it."
            raise ConfigError(
                str(self._path), f"another {schema.name} for {topic}", message.type, do
            )
        drone = int(channel.metadata["drone"])
        self._keys[channel.id], self._found[channel.id] = (
            (drone, topic),
            _ValueColumns(),
        )
        self._layouts[channel.id] = message.layout(drone)
