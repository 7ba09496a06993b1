"""The datagram with the poses of rigid bodies that virtual Crazyflies send as motion capture.

A client that sends `FRAME_PROTOCOL.request` to the port of the poses gets frames for
`FRAME_PROTOCOL.request_lifetime`. Numbers are little-endian and not aligned.
"""

import struct
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Final

import numpy as np

from crazychoir.errors import CodecError
from crazychoir.types import Vec


@dataclass(frozen=True, slots=True)
class FrameProtocol:
    """The numbers and marks that both ends of the datagrams must agree on."""

    request: bytes = b"CHOIR?"
    """Datagram that requests frames."""
    request_lifetime: float = 3.0
    """s: time for which one request counts."""
    frame_mark: bytes = b"CHOIR1"
    """First bytes of a frame."""
    name_size: int = 40
    """Most bytes of a body's name."""
    most_bodies: int = 450
    """Most bodies in one frame: a datagram holds no more."""


FRAME_PROTOCOL = FrameProtocol()


_HEAD_LAYOUT = struct.Struct("<6sIdH")
"""Layout of the start: mark, number, time, count of bodies."""
_BODY_LAYOUT = struct.Struct("<40s7d")
"""Layout of a body: name and pose."""
NO_POSE: Final = np.full(7, np.nan)
"""Pose that is written for a body with a name that is there twice."""


@dataclass(frozen=True)
class PoseFrame:
    """The bodies that were seen at one time."""

    number: int
    """Counts up with each frame."""
    time: float
    """s, on the sender's clock."""
    bodies: dict[str, Vec]
    """{name: (7,) = p m, q [x, y, z, w]}, world; without the bodies that are not seen."""
    doubled: tuple[str, ...] = ()
    """Names that two or more bodies have.

    They are not in `bodies`, because it is unknown which body is meant.
    """

    def packed(self) -> bytes:
        """Return the frame as a datagram.

        A name of `doubled` is written as two bodies without a pose, so that the receiver finds it
        doubled too.

        Raises CodecError for too many bodies or too long a name.
        """
        rows = [*self.bodies.items()]
        for name in self.doubled:
            rows += [(name, NO_POSE), (name, NO_POSE)]
        if len(rows) > FRAME_PROTOCOL.most_bodies or any(
            len(name.encode()) > FRAME_PROTOCOL.name_size for name, _ in rows
        ):
            raise CodecError(
                f"frame of {len(rows)} bodies; allowed: {FRAME_PROTOCOL.most_bodies}, names of "
                f"{FRAME_PROTOCOL.name_size} bytes at most."
            )
        head = _HEAD_LAYOUT.pack(
            FRAME_PROTOCOL.frame_mark, self.number & 0xFFFFFFFF, self.time, len(rows)
        )
        return head + b"".join(
            _BODY_LAYOUT.pack(name.encode(), *flat) for name, flat in rows
        )


def make_frame(number: int, time: float, rows: Iterable[tuple[str, Vec]]) -> PoseFrame:
    """Return the frame of these names and poses; names that occur twice become its `doubled`."""
    bodies: dict[str, Vec] = {}
    doubled: dict[str, None] = {}
    for name, flat in rows:
        if name in bodies or name in doubled:
            bodies.pop(name, None)
            doubled[name] = None
        else:
            bodies[name] = flat
    return PoseFrame(number, time, bodies, tuple(doubled))


def parse_frame(datagram: bytes) -> PoseFrame:
    """Return the frame of a datagram. Raises CodecError for anything else."""
    if len(datagram) < _HEAD_LAYOUT.size or not datagram.startswith(
        FRAME_PROTOCOL.frame_mark
    ):
        raise CodecError(f"{len(datagram)} bytes that are no frame of poses.")
    _, number, time, count = _HEAD_LAYOUT.unpack_from(datagram)
    if len(datagram) != _HEAD_LAYOUT.size + count * _BODY_LAYOUT.size:
        raise CodecError(
            f"frame of poses: {len(datagram)} bytes; allowed for {count} bodies: "
            f"{_HEAD_LAYOUT.size + count * _BODY_LAYOUT.size}."
        )
    rows = []
    for name, *flat in _BODY_LAYOUT.iter_unpack(datagram[_HEAD_LAYOUT.size :]):
        try:
            rows.append((name.rstrip(b"\0").decode(), np.array(flat)))
        except UnicodeDecodeError as error:
            raise CodecError("frame of poses: a name that is not UTF-8.") from error
    return make_frame(number, time, rows)
