"""The messages of a recording in the order in which they came, each by what the file itself says of it."""

from collections.abc import Collection, Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from mcap.opcode import Opcode
from mcap.records import Channel, Schema

from crazychoir.errors import ConfigError
from crazychoir.recording.mcap.cdr import Leaf, definitions_of, leaves, unpacked
from crazychoir.recording.mcap.records import (
    DO,
    MESSAGE,
    Records,
    opened,
    records_of,
    stream,
)


@dataclass(frozen=True)
class Source:
    """A channel of a file: whose messages, of which topic, and what they are made of.

    topic: as in the table of topics, or `command/vel`;  type: as ROS 2 names it;  schema: its definition.
    """

    drone: int
    topic: str
    type: str
    schema: str

    @property
    def name(self) -> str:
        """As tools show it."""
        return f"/drone{self.drone}/{self.topic}"

    @cached_property
    def fields(self) -> list[Leaf]:
        """Of a message, in order."""
        name = self.type.replace("/msg/", "/")
        return list(leaves(name, definitions_of(name, self.schema)))


@dataclass(frozen=True, slots=True)
class Told:
    """A message: when it came and when it was born, ns by the clock of the recording, and its bytes."""

    source: Source
    came_ns: int
    born_ns: int
    data: bytes

    def values(self) -> dict[str, Any]:
        """By the path of each field."""
        return unpacked(self.source.fields, self.data)


class Messages:
    """The messages of all whole chunks, or those of some topics; raises ConfigError for a file that is no recording.

    fault: when all were told, where the file is cut off or spoilt; empty if it was ended in order.
    """

    def __init__(self, path: Path, topics: Collection[str] | None = None) -> None:
        self.path = path
        self.topics = topics
        self.fault = "not read"

    def __iter__(self) -> Iterator[Told]:
        with opened(self.path) as content:
            whole = Records(content)
            sources = dict[int, Source]()
            schemas = dict[int, Schema]()
            for opcode, body in whole:
                if opcode == Opcode.CHUNK:
                    yield from self._of_chunk(body, sources, schemas)
            self.fault = whole.fault

    def _of_chunk(
        self, chunk: bytes, sources: dict[int, Source], schemas: dict[int, Schema]
    ) -> Iterator[Told]:
        """What it tells, after those sources and schemas, to which it adds its own."""
        for opcode, record in records_of(chunk):
            match opcode:
                case Opcode.MESSAGE:
                    channel, _, came_ns, born_ns = MESSAGE.unpack_from(record)
                    if channel not in sources:
                        raise ConfigError(
                            str(self.path),
                            f"a message of channel {channel}, which is not there",
                            "messages of channels that the file names before",
                            DO,
                        )
                    source = sources[channel]
                    if self.topics is None or source.topic in self.topics:
                        yield Told(source, came_ns, born_ns, record[MESSAGE.size :])
                case Opcode.SCHEMA:
                    schema = Schema.read(stream(record))
                    schemas[schema.id] = schema
                case Opcode.CHANNEL:
                    opened_now = Channel.read(stream(record))
                    sources[opened_now.id] = _source(self.path, opened_now, schemas)


def told(path: Path, topics: Collection[str] | None = None) -> Messages:
    """The messages of a recording, or those of some topics."""
    return Messages(path, topics)


def _source(path: Path, channel: Channel, schemas: dict[int, Schema]) -> Source:
    try:
        schema = schemas[channel.schema_id]
        drone = int(channel.metadata["drone"])
        topic = channel.metadata["topic"]
    except (KeyError, ValueError):
        raise ConfigError(
            str(path), f"channel {channel.topic} of another program", "a recording", DO
        ) from None
    return Source(drone, topic, schema.name, schema.data.decode())
