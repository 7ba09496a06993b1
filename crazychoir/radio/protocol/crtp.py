"""CRTP packets without I/O, for the server of virtual drones, the senders and the tests.

One datagram is one packet: a byte with port and channel, then at most 30 bytes. Numbers are
little-endian and not aligned.

Sources: Bitcraze's CRTP documentation; protocol version 12 as measured on the firmware of 2026.
"""

import struct
from dataclasses import dataclass
from enum import IntEnum
from functools import cached_property
from typing import Any, Final, NamedTuple

from crazychoir.errors import CodecError


@dataclass(frozen=True, slots=True)
class CrtpFormat:
    """The size and header of a packet."""

    payload_size: int = 30
    """Most bytes after the header that the firmware sends."""
    radio_size: int = 31
    """Most bytes after the header that a radio carries to a drone."""
    safelink_bits: int = 0b1100
    """Header bits that safelink counts with; cflib sets them in each packet."""


CRTP_FORMAT = CrtpFormat()


class CrtpPort(IntEnum):
    """Ports of CRTP."""

    CONSOLE = 0
    """Texts from the drone."""
    PARAMETERS = 2
    """Parameters, and their table of contents."""
    COMMANDER = 3
    """Set-points of roll, pitch, yaw rate and thrust."""
    MEMORY = 4
    """Memories."""
    LOG = 5
    """Log blocks, and the table of log variables."""
    LOCALIZATION = 6
    """Poses from outside, and the emergency stop."""
    SETPOINT = 7
    """Set-points of all other kinds."""
    HIGH_LEVEL = 8
    """Commands for the planner on board."""
    SUPERVISOR = 9
    """Arming, and the state of the supervisor."""
    PLATFORM = 13
    """Versions and the type of the device."""
    LINK = 15
    """Echoes, and packets that only the link handles."""


class Packet(NamedTuple):
    """One CRTP packet."""

    port: int
    """0 to 15."""
    channel: int
    """0 to 3."""
    data: bytes = b""
    """Content: at most `CRTP_FORMAT.radio_size` bytes."""

    def framed(self) -> bytes:
        """Return the packet as a datagram."""
        return (
            bytes([self.port << 4 | CRTP_FORMAT.safelink_bits | self.channel])
            + self.data
        )


def parse_packet(datagram: bytes) -> Packet:
    """Return the packet of a datagram. Raises CodecError if it is empty or too long for a radio."""
    if not 1 <= len(datagram) <= 1 + CRTP_FORMAT.radio_size:
        raise CodecError(
            f"CRTP packet: {len(datagram)} bytes; allowed: 1 to {1 + CRTP_FORMAT.radio_size}."
        )
    return Packet(datagram[0] >> 4, datagram[0] & 0b11, bytes(datagram[1:]))


@dataclass(frozen=True)
class PacketForm:
    """One kind of packet: its port and channel, its first bytes, and its fields."""

    name: str
    """Name of the form."""
    port: int
    """Port of its packets."""
    channel: int
    """Channel of its packets."""
    head: bytes
    """First bytes, which distinguish this form from others."""
    fields: str
    """Name and struct letter of each field, such as "roll:f pitch:f".

    They follow the head without gaps.
    """

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Names of the fields, in order."""
        return tuple(field.split(":")[0] for field in self.fields.split())

    @cached_property
    def layout(self) -> struct.Struct:
        """Binary layout of the fields."""
        return struct.Struct(
            "<" + "".join(field.split(":")[1] for field in self.fields.split())
        )

    def packet(self, *values: Any) -> Packet:
        """Return the packet with these values, in the order of the fields.

        Raises CodecError if a value does not fit.
        """
        try:
            return Packet(
                self.port, self.channel, self.head + self.layout.pack(*values)
            )
        except struct.error as error:
            raise CodecError(
                f"CRTP {self.name}: {error}; its fields: {self.fields}."
            ) from error

    def values(self, packet: Packet) -> tuple[Any, ...]:
        """Return the values of the fields.

        Raises CodecError for a packet of another length.
        """
        body = packet.data[len(self.head) :]
        if len(body) != self.layout.size:
            found = len(packet.data)
            allowed = len(self.head) + self.layout.size
            raise CodecError(
                f"CRTP {self.name}: {found} bytes; allowed: {allowed}, {self.fields}."
            )
        return self.layout.unpack(body)

    def read(self, buffer: bytes) -> tuple[Any, ...]:
        """Return the values at the places of the fields, however long the packet was.

        buffer: the packet and what follows it in the memory of the drone
        """
        return self.layout.unpack_from(buffer, len(self.head))


def _index_forms(*rows: tuple[str, int, int, bytes, str]) -> dict[str, PacketForm]:
    return {row[0]: PacketForm(*row) for row in rows}


PACKET_FORMS: Final = _index_forms(
    # Set-points: deg and deg/s. Pitch is positive nose up; RPYT and the legacy forms reverse the
    # sign of the yaw rate.
    ("rpyt", CrtpPort.COMMANDER, 0, b"", "roll:f pitch:f yaw:f thrust:H"),
    ("stop", CrtpPort.SETPOINT, 0, b"\x00", ""),
    (
        "velocity_world_legacy",
        CrtpPort.SETPOINT,
        0,
        b"\x01",
        "vx:f vy:f vz:f yaw_rate:f",
    ),
    (
        "z_distance_legacy",
        CrtpPort.SETPOINT,
        0,
        b"\x02",
        "roll:f pitch:f yaw_rate:f z:f",
    ),
    ("hover_legacy", CrtpPort.SETPOINT, 0, b"\x05", "vx:f vy:f yaw_rate:f z:f"),
    ("altitude_hold", CrtpPort.SETPOINT, 0, b"\x04", "roll:f pitch:f yaw_rate:f vz:f"),
    (
        "full_state",
        CrtpPort.SETPOINT,
        0,
        b"\x06",
        "x:h y:h z:h vx:h vy:h vz:h ax:h ay:h az:h q:I p:h q_rate:h r:h",
    ),
    ("velocity_world", CrtpPort.SETPOINT, 0, b"\x08", "vx:f vy:f vz:f yaw_rate:f"),
    ("z_distance", CrtpPort.SETPOINT, 0, b"\x09", "roll:f pitch:f yaw_rate:f z:f"),
    ("hover", CrtpPort.SETPOINT, 0, b"\x0a", "vx:f vy:f yaw_rate:f z:f"),
    ("position", CrtpPort.SETPOINT, 0, b"\x07", "x:f y:f z:f yaw:f"),
    (
        "manual",
        CrtpPort.SETPOINT,
        0,
        b"\x0b",
        "roll:f pitch:f yaw_rate:f thrust:H rates:B",
    ),
    ("notify_setpoint_stop", CrtpPort.SETPOINT, 1, b"\x00", "remain_ms:I"),
    # The planner on board: m, rad, s; `group` is a mask, 0 is all.
    ("group_mask", CrtpPort.HIGH_LEVEL, 0, b"\x00", "group:B"),
    ("planner_stop", CrtpPort.HIGH_LEVEL, 0, b"\x03", "group:B"),
    (
        "go_to_legacy",
        CrtpPort.HIGH_LEVEL,
        0,
        b"\x04",
        "group:B relative:B x:f y:f z:f yaw:f duration:f",
    ),
    (
        "start_trajectory_legacy",
        CrtpPort.HIGH_LEVEL,
        0,
        b"\x05",
        "group:B relative:B reversed:B id:B timescale:f",
    ),
    (
        "define_trajectory",
        CrtpPort.HIGH_LEVEL,
        0,
        b"\x06",
        "id:B location:B type:B offset:I pieces:B",
    ),
    (
        "take_off",
        CrtpPort.HIGH_LEVEL,
        0,
        b"\x07",
        "group:B height:f yaw:f keep_yaw:? duration:f",
    ),
    (
        "land",
        CrtpPort.HIGH_LEVEL,
        0,
        b"\x08",
        "group:B height:f yaw:f keep_yaw:? duration:f",
    ),
    (
        "take_off_with_velocity",
        CrtpPort.HIGH_LEVEL,
        0,
        b"\x09",
        "group:B height:f relative:? yaw:f keep_yaw:? speed:f",
    ),
    (
        "land_with_velocity",
        CrtpPort.HIGH_LEVEL,
        0,
        b"\x0a",
        "group:B height:f relative:? yaw:f keep_yaw:? speed:f",
    ),
    (
        "spiral",
        CrtpPort.HIGH_LEVEL,
        0,
        b"\x0b",
        "group:B sideways:B clockwise:B angle:f r0:f r1:f climb:f duration:f",
    ),
    (
        "go_to",
        CrtpPort.HIGH_LEVEL,
        0,
        b"\x0c",
        "group:B relative:B linear:B x:f y:f z:f yaw:f duration:f",
    ),
    (
        "start_trajectory",
        CrtpPort.HIGH_LEVEL,
        0,
        b"\x0d",
        "group:B relative:B relative_yaw:B reversed:B id:B timescale:f",
    ),
    # Measurements from outside: m, quaternions [x, y, z, w].
    ("external_position", CrtpPort.LOCALIZATION, 0, b"", "x:f y:f z:f"),
    ("emergency_stop", CrtpPort.LOCALIZATION, 1, b"\x03", ""),
    ("emergency_stop_watchdog", CrtpPort.LOCALIZATION, 1, b"\x04", ""),
    (
        "lighthouse_persist",
        CrtpPort.LOCALIZATION,
        1,
        b"\x0b",
        "geometries:H calibrations:H",
    ),
    (
        "external_pose",
        CrtpPort.LOCALIZATION,
        1,
        b"\x08",
        "x:f y:f z:f qx:f qy:f qz:f qw:f",
    ),
    # The supervisor.
    ("arm", CrtpPort.SUPERVISOR, 1, b"\x01", "on:?"),
    ("recover", CrtpPort.SUPERVISOR, 1, b"\x02", ""),
    ("supervisor_stop", CrtpPort.SUPERVISOR, 1, b"\x03", ""),
    ("supervisor_watchdog", CrtpPort.SUPERVISOR, 1, b"\x04", ""),
    ("supervisor_info", CrtpPort.SUPERVISOR, 0, b"\x0c", ""),
    ("platform_arm", CrtpPort.PLATFORM, 0, b"\x01", "on:?"),
    ("platform_recover", CrtpPort.PLATFORM, 0, b"\x02", ""),
)
"""All forms, by name.

The packets of logs, parameters and memories contain lists; they are read by the code that serves
them.
"""
FIRST_VERSIONS: Final = {
    "go_to": 8,
    "spiral": 8,
    "velocity_world": 9,
    "z_distance": 9,
    "hover": 9,
    "start_trajectory": 10,
    "arm": 12,
    "recover": 12,
    "supervisor_stop": 12,
    "supervisor_watchdog": 12,
    "supervisor_info": 12,
}
"""First protocol version that knows a form, according to cflib 0.1.34.

The other forms have no such version there.
"""
