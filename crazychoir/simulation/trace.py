"""A fingerprint of a run in virtual time, 32 hexadecimal digits."""

import hashlib
import struct
from typing import Any

import numpy.typing as npt

from crazychoir.bus.message import Message
from crazychoir.bus.port import FIRST_OBSERVER

Table = npt.NDArray[Any]
"""An array of numbers or of records."""
_pack_header = struct.Struct("<iiiq").pack


class Trace:
    """Digest of a run in virtual time: trajectories, messages between drones, and heard states."""

    def __init__(self) -> None:
        self._hash = hashlib.blake2b(digest_size=16)
        self._parts: list[bytes] = []
        self._add = self._parts.append

    def message(self, destination: int, message: Message, age: float) -> None:
        """Add one message when it arrives; messages to observers are not part of the run."""
        if destination < FIRST_OBSERVER:
            header = _pack_header(
                destination, message.topic.number, message.source, message.number
            )
            self._add(header + message.payload)

    def update(self, *tables: Table) -> None:
        """Add tables of one tick, after the messages since the last tick.

        tables: C-contiguous arrays, hashed with all their bytes. The rows must be in the order of
            the drones' ids, so that the digest does not depend on where a drone is computed.
        """
        self._take()
        for part in tables:
            self._hash.update(part.data)

    def digest(self) -> str:
        """Return the digest as hexadecimal digits."""
        self._take()
        return self._hash.hexdigest()

    def _take(self) -> None:
        self._hash.update(b"".join(self._parts))
        self._parts.clear()
