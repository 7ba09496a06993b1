"""Where rigid bodies are, in one datagram: how virtual Crazyflies show themselves to motion capture.

Whoever sends ASK to the port of the poses gets frames for PATIENCE s. Numbers are little-endian, not aligned.
"""

import struct
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Final

import numpy as np

from crazychoir.errors import CodecError
from crazychoir.types import Vec

ASK: Final = b"CHOIR?"
PATIENCE: Final = 3.0
"""s for which one ASK counts."""
_HEAD = struct.Struct("<6sIdH")
_BODY = struct.Struct("<40s7d")
_MARK = b"CHOIR1"
NAME: Final = 40
"""Bytes of a body's name at most."""
MOST: Final = 450
"""Bodies in one frame: what a datagram holds."""
NO_POSE: Final = np.full(7, np.nan)
"""What is written for a body whose name is there twice."""


@dataclass(frozen=True)
class Frame:
    """What was seen at one time.

    number: counts up;  time: s, of the clock of who sends;  bodies: {name: (7,) = p m, q [x, y, z, w], world frame}.
    One that is not seen is not in it.
    doubled: names that the frame gives to two bodies or more. None of those is in `bodies`: which of them is meant is
    not known.
    """

    number: int
    time: float
    bodies: dict[str, Vec]
    doubled: tuple[str, ...] = ()

    def packed(self) -> bytes:
        """As it travels; CodecError for too many bodies, or too long a name.

        A doubled name is written twice, without a pose.
        """
        rows = [*self.bodies.items()]
        for name in self.doubled:
            rows += [(name, NO_POSE), (name, NO_POSE)]
        if len(rows) > MOST or any(len(name.encode()) > NAME for name, _ in rows):
            raise CodecError(
                f"frame of {len(rows)} bodies; allowed: {MOST}, names of {NAME} bytes at most."
            )
        head = _HEAD.pack(_MARK, self.number & 0xFFFFFFFF, self.time, len(rows))
        return head + b"".join(_BODY.pack(name.encode(), *flat) for name, flat in rows)


def frame_of(number: int, time: float, rows: Iterable[tuple[str, Vec]]) -> Frame:
    """Return the frame of these names and poses; names that come twice are its `doubled`."""
    bodies: dict[str, Vec] = {}
    doubled: dict[str, None] = {}
    for name, flat in rows:
        if name in bodies or name in doubled:
            bodies.pop(name, None)
            doubled[name] = None
        else:
            bodies[name] = flat
    return Frame(number, time, bodies, tuple(doubled))


def parse(datagram: bytes) -> Frame:
    """The frame of a datagram; CodecError for anything else."""
    if len(datagram) < _HEAD.size or not datagram.startswith(_MARK):
        raise CodecError(f"{len(datagram)} bytes that are no frame of poses.")
    _, number, time, count = _HEAD.unpack_from(datagram)
    if len(datagram) != _HEAD.size + count * _BODY.size:
        raise CodecError(
            f"frame of poses: {len(datagram)} bytes; allowed for {count} bodies: "
            f"{_HEAD.size + count * _BODY.size}."
        )
    rows = []
    for name, *flat in _BODY.iter_unpack(datagram[_HEAD.size :]):
        try:
            rows.append((name.rstrip(b"\0").decode(), np.array(flat)))
        except UnicodeDecodeError as error:
            raise CodecError("frame of poses: a name that is not UTF-8.") from error
    return frame_of(number, time, rows)
