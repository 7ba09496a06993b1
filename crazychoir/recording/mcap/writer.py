"""MCAP as bytes, for many messages at a time.

A chunk is made in one go, with one index record a channel.

    file = magic, header, (metadata | attachment | chunk, message indexes)*, data end, summary,
           footer, magic
    chunk = schemas and channels that are new, messages;  compressed

Source: the MCAP specification, version 0.
"""

import struct
import zlib
from collections.abc import Mapping, Sequence

import zstandard
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    Attachment,
    AttachmentIndex,
    Channel,
    ChunkIndex,
    DataEnd,
    Footer,
    Header,
    McapRecord,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)
from mcap.records import Chunk as ChunkRecord
from mcap.writer import MCAP0_MAGIC

CHUNK_COMPRESSION = "zstd"
_MESSAGE_RECORD = struct.Struct("<BQHIQQ")
_INDEX_RECORD = struct.Struct("<BQHI")
_FOOTER_RECORD = struct.Struct("<BQQQ")
_MESSAGE_REST = _MESSAGE_RECORD.size - 9
"""Bytes of a message's record between its length and its data."""

Timed = tuple[int, int, int, bytes]
"""A message: channel, when it came (ns), when it was born (ns), and its data."""


class McapWriter:
    """Makes the bytes of a file in the order of the calls.

    `take` returns the bytes made since its last call. The first call is `begin`, the last `finish`.
    """

    def __init__(self) -> None:
        self._parts: list[bytes] = []
        self._end = 0
        self._new = RecordBuilder()  # schemas and channels of the next chunk
        self._schemas: list[Schema] = []
        self._channels: list[Channel] = []
        self._chunks: list[ChunkIndex] = []
        self._attachments: list[AttachmentIndex] = []
        self._metadata: list[MetadataIndex] = []
        self._counts: dict[int, int] = {}

    def take(self) -> bytes:
        """Return the bytes made since the last call."""
        parts = self._parts
        self._parts = []
        return b"".join(parts)

    def begin(self, profile: str, library: str) -> None:
        """Write magic and header."""
        self._add(MCAP0_MAGIC)
        self._record(Header(profile, library))

    def metadata(self, name: str, texts: Mapping[str, str]) -> None:
        """Write named texts."""
        at = self._end
        length = self._record(Metadata(name, dict(texts)))
        self._metadata.append(MetadataIndex(offset=at, length=length, name=name))

    def attachment(self, name: str, media_type: str, data: bytes) -> None:
        """Write a file within the file."""
        at = self._end
        length = self._record(Attachment(0, 0, name, media_type, data))
        self._attachments.append(
            AttachmentIndex(at, length, 0, 0, len(data), name, media_type)
        )

    def schema(self, name: str, encoding: str, text: str) -> int:
        """Write a type of messages; return its number."""
        schema = Schema(len(self._schemas) + 1, text.encode(), encoding, name)
        self._schemas.append(schema)
        schema.write(self._new)
        return schema.id

    def channel(
        self, topic: str, encoding: str, schema: int, told: Mapping[str, str]
    ) -> int:
        """Write a series of messages of a schema; return its number."""
        channel = Channel(len(self._channels) + 1, topic, encoding, dict(told), schema)
        self._channels.append(channel)
        channel.write(self._new)
        return channel.id

    def chunk(self, messages: Sequence[Timed]) -> None:
        """Write a chunk of these messages, at least one."""
        parts = [self._new.end()]
        at = len(parts[0])
        index = dict[int, list[int]]()
        for channel, came_ns, born_ns, data in messages:
            size = len(data)
            parts += (
                _MESSAGE_RECORD.pack(
                    Opcode.MESSAGE, _MESSAGE_REST + size, channel, 0, came_ns, born_ns
                ),
                data,
            )
            places = index.get(channel)
            if places is None:
                places = index[channel] = []
            places += (came_ns, at)
            at += _MESSAGE_RECORD.size + size
        content = b"".join(parts)
        came = [message[1] for message in messages]
        self._chunk(content, min(came), max(came), index)

    def _chunk(
        self,
        content: bytes,
        first_ns: int,
        last_ns: int,
        index: Mapping[int, list[int]],
    ) -> None:
        packed = zstandard.compress(content)
        begin = self._end
        length = self._record(
            ChunkRecord(
                CHUNK_COMPRESSION,
                packed,
                last_ns,
                first_ns,
                zlib.crc32(content),
                len(content),
            )
        )
        indexed = self._end
        offsets = {}
        for channel, places in index.items():
            offsets[channel] = self._end
            self._counts[channel] = self._counts.get(channel, 0) + len(places) // 2
            head = _INDEX_RECORD.pack(
                Opcode.MESSAGE_INDEX, 6 + 8 * len(places), channel, 8 * len(places)
            )
            self._add(head + struct.pack(f"<{len(places)}Q", *places))
        self._chunks.append(
            ChunkIndex(
                length,
                begin,
                CHUNK_COMPRESSION,
                len(packed),
                last_ns,
                self._end - indexed,
                offsets,
                first_ns,
                len(content),
            )
        )

    def finish(self) -> None:
        """Write the end of the data, the summary, footer and magic."""
        self._record(DataEnd(0))
        start = self._end
        summary = RecordBuilder()
        groups: dict[Opcode, Sequence[McapRecord]] = {
            Opcode.SCHEMA: self._schemas,
            Opcode.CHANNEL: self._channels,
            Opcode.STATISTICS: [self._statistics()],
            Opcode.CHUNK_INDEX: self._chunks,
            Opcode.ATTACHMENT_INDEX: self._attachments,
            Opcode.METADATA_INDEX: self._metadata,
        }
        offsets = []
        for opcode, records in groups.items():
            at = summary.count
            for record in records:
                record.write(summary)
            offsets.append(SummaryOffset(opcode, start + at, summary.count - at))
        offsets_start = start + summary.count
        for offset in offsets:
            offset.write(summary)
        data = summary.end()
        crc = zlib.crc32(
            _FOOTER_RECORD.pack(Opcode.FOOTER, 20, start, offsets_start),
            zlib.crc32(data),
        )
        self._add(data)
        self._record(Footer(start, offsets_start, crc))
        self._add(MCAP0_MAGIC)

    def _statistics(self) -> Statistics:
        first = min((chunk.message_start_time for chunk in self._chunks), default=0)
        last = max((chunk.message_end_time for chunk in self._chunks), default=0)
        return Statistics(
            attachment_count=len(self._attachments),
            channel_count=len(self._channels),
            channel_message_counts=self._counts,
            chunk_count=len(self._chunks),
            message_count=sum(self._counts.values()),
            message_end_time=last,
            message_start_time=first,
            metadata_count=len(self._metadata),
            schema_count=len(self._schemas),
        )

    def _record(self, record: McapRecord) -> int:
        """Write a record; return its length in the file."""
        builder = RecordBuilder()
        record.write(builder)
        content = builder.end()
        self._add(content)
        return len(content)

    def _add(self, part: bytes) -> None:
        self._parts.append(part)
        self._end += len(part)
