"""The records of an MCAP file in order; of a truncated file, its whole records."""

import contextlib
import mmap
import struct
from collections.abc import Iterator
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path

from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Chunk
from mcap.stream_reader import get_chunk_data_stream
from mcap.writer import MCAP0_MAGIC

from crazychoir.errors import ConfigError, CrazyChoirError
from crazychoir.files.text_files import describe_unreadable

RECORDING_HINT = "Give it a file of `crazychoir run ... --record FILE`."
MESSAGE_HEADER = struct.Struct("<HIQQ")
"""Numbers before the data of a message: channel, sequence, when it came, when it was born (ns)."""
_RECORD_HEADER = struct.Struct("<BQ")
READABLE_COMPRESSIONS = ("", "zstd", "lz4")
"""Compressions of chunks that can be read; "" is none."""


@dataclass(frozen=True, slots=True)
class BareRecordRules:
    """How bare records, outside of chunks, are collected and handed over."""

    opcodes: tuple[Opcode, ...] = (Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE)
    """Records that stand in a chunk, or directly in a file without chunks."""
    ending_opcodes: tuple[Opcode, ...] = (Opcode.CHUNK, Opcode.DATA_END, Opcode.FOOTER)
    """Records before which the collected bare records are handed over."""
    largest_run: int = 4 << 20
    """Bytes of bare records that are handed over together."""


BARE_RECORDS = BareRecordRules()


@contextlib.contextmanager
def open_recording(path: Path) -> Iterator[mmap.mmap]:
    """Open an MCAP file and yield its bytes; raises ConfigError if it is no MCAP file."""
    try:
        with path.open("rb") as file:
            first = file.read(len(MCAP0_MAGIC))
            if first != MCAP0_MAGIC:
                found = (
                    "an empty file"
                    if not first
                    else f"a file that begins with {first!r}"
                )
                raise ConfigError(str(path), found, "an MCAP file", RECORDING_HINT)
            content = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)
    except OSError as error:
        found = describe_unreadable(error)
        raise ConfigError(str(path), found, "a recording", RECORDING_HINT) from error
    with content:
        yield content


def foreign_file_error(path: Path) -> ConfigError:
    """Return the error for an MCAP file that does not say what was flown."""
    return ConfigError(
        str(path),
        "an MCAP file of another program",
        "one of crazychoir",
        RECORDING_HINT,
    )


def records(
    content: mmap.mmap | bytes, at: int = len(MCAP0_MAGIC)
) -> Iterator[tuple[int, bytes]]:
    """Yield (opcode, body) of every whole record."""
    while at + _RECORD_HEADER.size <= len(content):
        opcode, length = _RECORD_HEADER.unpack_from(content, at)
        at += _RECORD_HEADER.size
        if opcode == 0 or at + length > len(content):
            return
        yield opcode, content[at : at + length]
        at += length


def records_of(chunk: bytes) -> Iterator[tuple[int, bytes]]:
    """Yield (opcode, body) of every whole record in a chunk."""
    return records(chunk, 0)


class UnknownCompression(CrazyChoirError, ValueError):
    """The compression of a chunk is unknown."""


class Records:
    """Iterates over the whole records of a recording as (opcode, body).

    The body of a chunk is uncompressed. Schemas, channels and messages outside of chunks come as
    the body of a chunk, so a file without chunks reads like a file with chunks. Those of the
    summary, which repeat earlier records, are left out.

    at: byte at which the last record begins
    fault: why no more records follow; empty if the recording was closed properly
    """

    def __init__(self, content: mmap.mmap | bytes) -> None:
        self._content = content
        self.at = 0
        self.fault = "not read to its end"

    def __iter__(self) -> Iterator[tuple[int, bytes]]:
        after = len(MCAP0_MAGIC)
        bare = bytearray()
        in_summary = False
        for opcode, body in records(self._content):
            self.at = after
            after += _RECORD_HEADER.size + len(body)
            if opcode in BARE_RECORDS.opcodes:
                if not in_summary:
                    bare += _RECORD_HEADER.pack(opcode, len(body)) + body
                if len(bare) < BARE_RECORDS.largest_run:
                    continue
            if bare and (
                opcode in BARE_RECORDS.opcodes or opcode in BARE_RECORDS.ending_opcodes
            ):
                yield Opcode.CHUNK, bytes(bare)
                bare.clear()
            if opcode in BARE_RECORDS.opcodes:
                continue
            in_summary = in_summary or opcode == Opcode.DATA_END
            try:
                content = _unpack_chunk(body) if opcode == Opcode.CHUNK else body
            except UnknownCompression as error:
                self.fault = f"{error}, at byte {self.at}"
                return
            except Exception:  # noqa: BLE001 - the records before a damaged chunk count
                self.spoilt()
                return
            yield opcode, content
            if opcode == Opcode.FOOTER:
                self.fault = ""
                return
        if bare:
            yield Opcode.CHUNK, bytes(bare)
        self.fault = f"cut off at byte {after}"

    def spoilt(self) -> None:
        """Set the fault: the last record cannot be read."""
        self.fault = f"spoilt at byte {self.at}"


def _unpack_chunk(chunk: bytes) -> bytes:
    """Return the records of a chunk.

    Raises UnknownCompression, or any error if the chunk is damaged.
    """
    packed = Chunk.read(body_stream(chunk))
    if packed.compression not in READABLE_COMPRESSIONS:
        raise UnknownCompression(
            f"compressed by {packed.compression!r}, where zstd, lz4 and nothing are read"
        )
    unpacked, length = get_chunk_data_stream(packed, validate_crc=True)
    return unpacked.read(length)


def body_stream(body: bytes) -> ReadDataStream:
    """Return the body as the stream that the classes of mcap.records read."""
    return ReadDataStream(BytesIO(body))
