"""The messages of a recording in the order in which they came.

They are decoded by the definitions in the file itself.
"""

from collections.abc import Collection, Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from mcap.opcode import Opcode
from mcap.records import Channel, Schema

from crazychoir.errors import ConfigError
from crazychoir.recording.mcap.cdr import Leaf, definitions_of, leaves, unpack_values
from crazychoir.recording.mcap.file import VIEW_KEY
from crazychoir.recording.mcap.records import (
    MESSAGE_HEADER,
    RECORDING_HINT,
    Records,
    body_stream,
    open_recording,
    records_of,
)


@dataclass(frozen=True)
class RecordedChannel:
    """A channel of a file."""

    drone: int
    """The drone that published its messages."""
    topic: str
    """The topic as in the table of topics, or with a type of command, such as `command/vel`."""
    type: str
    """Type of the messages in the notation of ROS 2."""
    schema: str
    """Definition of the type."""

    @property
    def name(self) -> str:
        """Its name as tools show it."""
        return f"/drone{self.drone}/{self.topic}"

    @cached_property
    def fields(self) -> list[Leaf]:
        """Fields of a message in order."""
        name = self.type.replace("/msg/", "/")
        return list(leaves(name, definitions_of(name, self.schema)))


@dataclass(frozen=True, slots=True)
class RecordedMessage:
    """A message of a recording; times are by the recording's clock."""

    source: RecordedChannel
    """Its channel."""
    came_ns: int
    """Time of arrival, ns."""
    born_ns: int
    """Time of birth, ns."""
    data: bytes
    """Its bytes."""

    def values(self) -> dict[str, Any]:
        """Return its values by the path of each field."""
        return unpack_values(self.source.fields, self.data)


class RecordedMessages:
    """Iterates over the messages of all whole chunks, without the messages for viewers.

    path: the file
    topics: topics to read, None for all
    fault: after the iteration, where the file is cut off or damaged; empty if it was closed properly
    Raises ConfigError if the file is no recording.
    """

    def __init__(self, path: Path, topics: Collection[str] | None = None) -> None:
        self.path = path
        self.topics = topics
        self.fault = "not read"

    def __iter__(self) -> Iterator[RecordedMessage]:
        with open_recording(self.path) as content:
            whole = Records(content)
            sources = dict[int, RecordedChannel | None]()
            schemas = dict[int, Schema]()
            for opcode, body in whole:
                if opcode == Opcode.CHUNK:
                    yield from self._of_chunk(body, sources, schemas)
            self.fault = whole.fault

    def _of_chunk(
        self,
        chunk: bytes,
        sources: dict[int, RecordedChannel | None],
        schemas: dict[int, Schema],
    ) -> Iterator[RecordedMessage]:
        """Yield the messages of a chunk, and add its sources and schemas to those known before."""
        for opcode, record in records_of(chunk):
            match opcode:
                case Opcode.MESSAGE:
                    channel, _, came_ns, born_ns = MESSAGE_HEADER.unpack_from(record)
                    if channel not in sources:
                        raise ConfigError(
                            str(self.path),
                            f"a message of channel {channel}, which is not there",
                            "messages of channels that the file names before",
                            RECORDING_HINT,
                        )
                    source = sources[channel]
                    if source is not None and (
                        self.topics is None or source.topic in self.topics
                    ):
                        yield RecordedMessage(
                            source, came_ns, born_ns, record[MESSAGE_HEADER.size :]
                        )
                case Opcode.SCHEMA:
                    schema = Schema.read(body_stream(record))
                    schemas[schema.id] = schema
                case Opcode.CHANNEL:
                    opened_now = Channel.read(body_stream(record))
                    sources[opened_now.id] = _source(self.path, opened_now, schemas)


def read_messages(
    path: Path, topics: Collection[str] | None = None
) -> RecordedMessages:
    """Return the messages of a recording, or those of some topics."""
    return RecordedMessages(path, topics)


def _source(
    path: Path, channel: Channel, schemas: dict[int, Schema]
) -> RecordedChannel | None:
    """Return a channel; None for a channel for viewers."""
    if VIEW_KEY in channel.metadata:
        return None
    try:
        schema = schemas[channel.schema_id]
        drone = int(channel.metadata["drone"])
        topic = channel.metadata["topic"]
    except (KeyError, ValueError):
        raise ConfigError(
            str(path),
            f"channel {channel.topic} of another program",
            "a recording",
            RECORDING_HINT,
        ) from None
    return RecordedChannel(drone, topic, schema.name, schema.data.decode())
