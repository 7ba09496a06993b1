"""Frames: each holds many messages from one process to another, with their headers.

    frame = version (1 byte) + msgpack [process, incarnation, kind, [envelope, ...]]

The module has no clock and no session. Every limit is checked before memory is taken.
"""

from dataclasses import dataclass
from typing import Annotated

import msgspec
from msgspec import Meta

from crazychoir.bus.codec import MAX_PAYLOAD
from crazychoir.errors import CodecError, error_text


@dataclass(frozen=True, slots=True)
class FrameFormat:
    """The version of the format of frames, and its limits."""

    version: int = 2
    """Version of the format."""
    max_bytes: int = MAX_PAYLOAD + 50_000
    """Bytes of one frame, unless the caller passes another limit:
    the largest payload with the largest header.
    """
    max_envelopes: int = 4096
    """Most envelopes of a frame."""
    max_destinations: int = 1024
    """Most destinations of an envelope."""
    max_age: float = 1e9
    """Largest age of a message, in seconds."""
    max_name_length: int = 255
    """Most characters in the name of a channel or a process."""


FRAME_FORMAT = FrameFormat()
_Small = Annotated[int, Meta(ge=0, lt=1 << 16)]
_Address = Annotated[int, Meta(ge=0, lt=1 << 32)]
_Count = Annotated[int, Meta(ge=0)]
_Age = Annotated[float, Meta(ge=0.0, le=FRAME_FORMAT.max_age)]
_Name = Annotated[str, Meta(max_length=FRAME_FORMAT.max_name_length)]


class FrameVersionError(CodecError):
    """A frame has another version of the format: its host runs another crazychoir."""

    def __init__(self, found: int) -> None:
        self.found = found
        super().__init__(
            f"frame: version {found}; allowed: {FRAME_FORMAT.version}. Run the same crazychoir on all hosts."
        )


class Envelope(msgspec.Struct, frozen=True, array_like=True, gc=False):
    """One message with its destinations."""

    topic: _Small
    """Number in the table of topics."""
    source: _Address
    """Address of the sender, a drone or an observer."""
    to: Annotated[tuple[_Address, ...], Meta(max_length=FRAME_FORMAT.max_destinations)]
    """Addresses of the receivers; empty for messages between processes."""
    number: _Count
    """Sequence number or round."""
    flags: _Address
    """Flags; the topic defines their meaning."""
    age: _Age
    """Seconds since the content was made, at the time of sending."""
    channel: _Name
    """Channel of a round algorithm, or the sender's label."""
    payload: bytes
    """Payload of the codec."""


class Frame(msgspec.Struct, frozen=True, array_like=True, gc=False):
    """Envelopes of one class from one process."""

    process: _Name
    """Name of the sender."""
    incarnation: _Count
    """64 random bits, drawn when the sender started."""
    kind: Annotated[int, Meta(ge=0, lt=256)]
    """Number of the class."""
    envelopes: Annotated[list[Envelope], Meta(max_length=FRAME_FORMAT.max_envelopes)]
    """The messages."""


def encode_frame(frame: Frame, limit: int = FRAME_FORMAT.max_bytes) -> bytes:
    """Return the bytes of a frame.

    Raises CodecError if they are more than `limit`, or if a field cannot be encoded.
    """
    try:
        data = _FRAME_HEAD + _encode(frame)
    except Exception as error:
        raise CodecError(f"frame: cannot be encoded: {error_text(error)}") from error
    if len(data) > limit:
        raise CodecError(
            f"frame: {len(data)} bytes; allowed: {limit}. Collect with a FrameBuffer, which splits."
        )
    return data


def decode_frame(
    data: bytes | bytearray | memoryview, limit: int = FRAME_FORMAT.max_bytes
) -> Frame:
    """Return the frame of received bytes.

    Raises FrameVersionError for another version, CodecError for anything else.
    """
    if not 0 < len(data) <= limit:
        raise CodecError(f"frame: {len(data)} bytes; allowed: 1 to {limit}.")
    if data[0] != FRAME_FORMAT.version:
        raise FrameVersionError(data[0])
    try:
        return _decode(memoryview(data)[1:])
    except Exception as error:
        raise CodecError(f"frame: cannot be decoded: {error_text(error)}") from error


class FrameBuffer:
    """The envelopes for one peer and one class, collected during one pass of the event loop.

    An envelope is encoded when it is added, so a frame is its head and these bytes.
    conflate: True to keep only the newest of envelopes with equal (topic, source, to, channel), at
        the place of the oldest
    limit: most bytes of a frame
    """

    def __init__(
        self,
        process: str,
        incarnation: int,
        kind: int,
        conflate: bool = False,
        limit: int = FRAME_FORMAT.max_bytes,
    ) -> None:
        self.conflate = conflate
        self.conflated = 0
        empty = encode_frame(Frame(process, incarnation, kind, []))
        self._head = empty[:-1] + _LIST_HEAD
        """Start of each frame, before the number of its envelopes."""
        self._room = limit - len(self._head) - _COUNT_SIZE
        """Most bytes of the envelopes of a frame."""
        self._total = 0
        self._envelopes: list[bytes] = []
        self._places: dict[tuple[int, int, tuple[int, ...], str], int] = {}

    def __len__(self) -> int:
        return len(self._envelopes)

    def add(self, envelope: Envelope) -> None:
        """Add an envelope; raise CodecError if no frame can hold
        it, or if the receiver would refuse it.
        """
        channel = envelope.channel
        to = envelope.to
        try:
            data = _encode(envelope)
        except Exception as error:
            raise CodecError(
                f"{_describe(envelope)}: cannot be encoded: {error_text(error)}"
            ) from error
        if (
            len(data) > self._room
            or len(to) > FRAME_FORMAT.max_destinations
            or len(channel) > FRAME_FORMAT.max_name_length
            or not 0.0 <= envelope.age <= FRAME_FORMAT.max_age
        ):
            raise self._refusal(envelope, len(data))
        self._total += len(data)
        if self.conflate:
            key = (envelope.topic, envelope.source, to, channel)
            place = self._places.setdefault(key, len(self._envelopes))
            if place < len(self._envelopes):
                self._total -= len(self._envelopes[place])
                self._envelopes[place] = data
                self.conflated += 1
                return
        self._envelopes.append(data)

    def take(self) -> list[bytes]:
        """Return frames with all added envelopes in their order, and empty the buffer."""
        envelopes = self._envelopes
        if self._total <= self._room and len(envelopes) <= FRAME_FORMAT.max_envelopes:
            parts = [envelopes] if envelopes else []
        else:
            parts = self._split(envelopes)
        self._envelopes = []
        self._total = 0
        self._places.clear()
        frames = []
        for part in parts:
            count = len(part).to_bytes(_COUNT_SIZE, "big")
            frames.append(b"".join((self._head, count, *part)))
        return frames

    def _refusal(self, envelope: Envelope, size: int) -> CodecError:
        return CodecError(
            f"{_describe(envelope)}: found {size} bytes, age {envelope.age} s, a channel's name "
            f"of {len(envelope.channel)}, {len(envelope.to)} destinations; allowed: {self._room} bytes, 0 to "
            f"{FRAME_FORMAT.max_age:g} s, {FRAME_FORMAT.max_name_length} characters, "
            f"{FRAME_FORMAT.max_destinations} destinations."
        )

    def _split(self, envelopes: list[bytes]) -> list[list[bytes]]:
        """Return the envelopes divided into parts that fit into a frame."""
        parts: list[list[bytes]] = []
        room = -1
        for data in envelopes:
            if len(data) > room or len(parts[-1]) == FRAME_FORMAT.max_envelopes:
                parts.append([])
                room = self._room
            parts[-1].append(data)
            room -= len(data)
        return parts


def _describe(envelope: Envelope) -> str:
    """Return which message an envelope holds."""
    return f"topic {envelope.topic} of {envelope.source}"


_FRAME_HEAD = bytes([FRAME_FORMAT.version])
_LIST_HEAD = b"\xdc"
"""Head of a msgpack list; its length follows in `_COUNT_SIZE` bytes."""
_COUNT_SIZE = 2
"""Bytes of the number of envelopes in a frame."""
_encode = msgspec.msgpack.Encoder().encode
_decode = msgspec.msgpack.Decoder(Frame).decode
