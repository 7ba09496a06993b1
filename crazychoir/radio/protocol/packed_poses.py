"""Packets with the poses of several drones, which are broadcast.

Each entry begins with the last byte of the address of its drone. A drone takes its own pose, and the others
as the positions of its peers. Source: crazyflie-firmware, crtp_localization_service.c.
"""

import struct
from collections.abc import Iterable, Iterator
from dataclasses import dataclass

from crazychoir.errors import CodecError
from crazychoir.radio.protocol.compressed import pack_quaternion
from crazychoir.radio.protocol.crtp import CRTP_FORMAT, CrtpPort, Packet
from crazychoir.types import Pose

BROADCAST_ADDRESS = bytes.fromhex("FFE7E7E7E7")
"""Address at which every Crazyflie listens too, on its channel and at its data rate."""


@dataclass(frozen=True, slots=True)
class PackedForm:
    """One form of packets with several entries."""

    channel: int
    """Channel of the port LOCALIZATION."""
    head: bytes
    """First bytes of the packet."""
    entry: struct.Struct
    """Layout of an entry: number, x, y, z in mm, and in poses the compressed quaternion."""

    @property
    def most(self) -> int:
        """Most entries of a packet."""
        return (CRTP_FORMAT.payload_size - len(self.head)) // self.entry.size


PACKED_POSES = PackedForm(1, b"\x09", struct.Struct("<BhhhI"))
"""Poses: two in a packet."""
PACKED_POSITIONS = PackedForm(2, b"", struct.Struct("<Bhhh"))
"""Positions: four in a packet."""
MILLIMETRES_PER_METRE = 1e3
"""Units of a packed position in a metre."""
FARTHEST_POSITION = 32.767
"""m: largest coordinate of a packed position."""


@dataclass(frozen=True, slots=True)
class NumberedPose:
    """The pose of one of several drones."""

    number: int
    """Last byte of the address of the drone."""
    pose: Pose
    """Pose in the world."""
    has_attitude: bool = True
    """False: the drone is told its position only."""

    def require_fit(self) -> None:
        """Raise CodecError if the position is not finite, or beyond FARTHEST_POSITION."""
        place = self.pose.p.tolist()
        if not all(abs(x) <= FARTHEST_POSITION for x in place):
            raise CodecError(
                f"packed pose at {place} m; allowed: {FARTHEST_POSITION:g} m on each axis."
            )

    def packed(self) -> bytes:
        """Return the entry. Raises CodecError if it does not fit."""
        self.require_fit()
        place = [round(MILLIMETRES_PER_METRE * x) for x in self.pose.p.tolist()]
        if self.has_attitude:
            word = pack_quaternion(self.pose.q)
            return PACKED_POSES.entry.pack(self.number, *place, word)
        return PACKED_POSITIONS.entry.pack(self.number, *place)


def pack_poses(poses: Iterable[NumberedPose]) -> list[Packet]:
    """Return the packets with these poses, as few as possible; the order within a form is kept.

    Raises CodecError if a pose does not fit.
    """
    rows = list(poses)
    packets = []
    for form, has_attitude in ((PACKED_POSES, True), (PACKED_POSITIONS, False)):
        entries = [row.packed() for row in rows if row.has_attitude is has_attitude]
        packets += list(_join_entries(form, entries))
    return packets


def _join_entries(form: PackedForm, entries: list[bytes]) -> Iterator[Packet]:
    for first in range(0, len(entries), form.most):
        data = form.head + b"".join(entries[first : first + form.most])
        yield Packet(CrtpPort.LOCALIZATION, form.channel, data)


def is_packed(packet: Packet) -> bool:
    """Return whether a packet holds the poses or positions of several drones."""
    if packet.port != CrtpPort.LOCALIZATION:
        return False
    return packet.channel == PACKED_POSITIONS.channel or (
        packet.channel == PACKED_POSES.channel and packet.data[:1] == PACKED_POSES.head
    )
