"""A message on its way from one port to others."""

from typing import Any, Final

import msgspec
import numpy as np

from crazychoir.bus.codec import decode
from crazychoir.bus.topics import Topic
from crazychoir.errors import CodecError
from crazychoir.types import Wire

NOT_OPENED: Final = object()
"""Stands for the value of a message that no reader has opened."""
_FROZEN_TYPES: Final = (
    np.ndarray,
    Wire,
    type(None),
    bool,
    int,
    float,
    str,
    bytes,
)
"""Types of decoded values that cannot be changed."""


class Message(msgspec.Struct, gc=False):
    """One message. All readers in a process get the same object, so only `open` changes it."""

    topic: Topic
    """Row of the table of topics."""
    source: int
    """Address of the sender, a drone or an observer."""
    payload: bytes
    """Payload of the codec."""
    number: int = 0
    """Sequence number or round."""
    channel: str = ""
    """Channel of a round algorithm, or the sender's label."""
    flags: int = 0
    """Flags; the topic defines their meaning."""
    value: Any = NOT_OPENED
    """The decoded value, if it cannot be changed and a reader has opened it."""

    def open(self) -> Any:
        """Return the value of the payload.

        A value that cannot be changed is decoded once, and all readers share it. Each reader gets
        a list or a dict of its own.
        Raises CodecError for invalid bytes, and for a value that the topic does not carry.
        """
        value = self.value
        if value is not NOT_OPENED:
            return value
        value = decode(self.payload)
        topic = self.topic
        if topic.type is not None and not isinstance(value, topic.type):
            raise CodecError(
                f"{topic.name}: found a {type(value).__name__}; allowed: {topic.allowed}."
            )
        if isinstance(value, _FROZEN_TYPES):
            self.value = value
        return value
