"""What a run in virtual time was, in 32 hex digits."""

import hashlib
import struct

from crazychoir.bus.port import OBSERVER

_HEAD = struct.Struct("<iiiq")


class Trace:
    """Digest of a run in virtual time: every trajectory and every message between drones."""

    def __init__(self) -> None:
        self._hash = hashlib.blake2b(digest_size=16)
        self._parts: list[bytes] = []

    def message(
        self,
        destination: int,
        topic: int,
        source: int,
        number: int,
        payload: bytes,
        *_: object,
    ) -> None:
        """One message as it arrives; observers are no part of the run."""
        if destination < OBSERVER:
            self._parts += (_HEAD.pack(destination, topic, source, number), payload)

    def update(self, part: bytes) -> None:
        """One step of the world; all that was heard since the last one goes into the hash in one call."""
        self._parts.append(part)
        self._take()

    def digest(self) -> str:
        """Hex digits."""
        self._take()
        return self._hash.hexdigest()

    def _take(self) -> None:
        self._hash.update(b"".join(self._parts))
        self._parts.clear()
