"""Port 4: the memories of a virtual drone, read and written in pieces."""

import struct
from collections.abc import Iterator
from enum import IntEnum
from typing import Protocol

from crazychoir.radio.protocol.crtp import CrtpPort, Packet
from crazychoir.simulation.onboard.onboard import Onboard

MEMORY_INFO_CHANNEL = 0
"""Channel of the commands of `MemoryInfo`."""
MEMORY_READ_CHANNEL = 1
"""Channel that reads memories."""
MEMORY_WRITE_CHANNEL = 2
"""Channel that writes memories."""


class MemoryInfo(IntEnum):
    """Commands of the channel for information."""

    COUNT = 1
    """Asks for the number of memories."""
    DESCRIPTION = 2
    """Asks for the type and size of one memory."""


class MemoryKind(IntEnum):
    """Types of memories. There is no 1-wire memory: clients would read it at each connection."""

    EEPROM = 0x00
    """Configuration of the radio."""
    LEDS = 0x10
    """Colours of the LED ring."""
    TRAJECTORY = 0x12
    """Trajectories."""
    LIGHTHOUSE = 0x14
    """Geometry and calibration of the lighthouses."""
    TESTER = 0x15
    """Test of memories."""
    TIMINGS = 0x17
    """Timings of the LED ring."""
    DECKS = 0x19
    """Properties of decks."""


DECK_MEMORY_VERSION = 3
"""Version of the content of `MemoryKind.DECKS`."""


class MemoryResult(IntEnum):
    """Results of reading and writing, with the numbers of errno."""

    OK = 0
    """The bytes were read or written."""
    EIO = 5
    """There is no such memory, or no such address."""


MEMORY_PACKET_SIZE = 24
"""Most bytes that one packet reads or writes."""
_DESCRIPTION_LAYOUT = struct.Struct("<BBBI8x")
"""Layout of the description of a memory."""
_ADDRESS_LAYOUT = struct.Struct("<BI")
"""Layout of a memory's number and an address."""


class DroneMemory(Protocol):
    """Bytes that a client may read and write."""

    kind: int
    """Type of the memory."""
    size: int
    """Bytes, as the client is told."""

    def read(self, address: int, length: int) -> bytes | None:
        """Return bytes; None if they cannot be read."""
        ...

    def write(self, address: int, data: bytes) -> bool:
        """Write bytes; return whether that was possible."""
        ...


class StoredMemory:
    """A memory that keeps what is written.

    kind: type of the memory
    content: all its bytes, changed in place
    size: bytes, as the client is told; None: the size of `content`
    """

    def __init__(
        self, kind: int, content: bytearray | memoryview, size: int | None = None
    ) -> None:
        self.kind = kind
        self.content = content
        self.size = len(content) if size is None else size

    def read(self, address: int, length: int) -> bytes | None:
        """Return bytes; None beyond the end."""
        return (
            bytes(self.content[address : address + length])
            if address + length <= len(self.content)
            else None
        )

    def write(self, address: int, data: bytes) -> bool:
        """Write bytes; return False beyond the end."""
        if address + len(data) > len(self.content):
            return False
        self.content[address : address + len(data)] = data
        return True


class MemoryTester:
    """The firmware's test of memories: each byte is the lowest byte of its address."""

    kind: int = MemoryKind.TESTER
    size = 0x1000

    def __init__(self) -> None:
        self.errors = 0
        """Wrong bytes that were written."""
        self.resets = False
        """Whether the next write counts from 0; that write clears it."""

    def read(self, address: int, length: int) -> bytes | None:
        """Return bytes by the rule."""
        return bytes((address + k) & 0xFF for k in range(length))

    def write(self, address: int, data: bytes) -> bool:
        """Count the bytes against the rule."""
        if self.resets:
            self.resets = False
            self.errors = 0
        self.errors += sum(byte != (address + k) & 0xFF for k, byte in enumerate(data))
        return True


def make_eeprom(
    channel: int = 80, speed: int = 2, address: int = 0xE7E7E7E7E7
) -> bytearray:
    """Return the EEPROM of a drone.

    It holds the channel, data rate and address of its radio, no trim, and their checksum.
    """
    image = b"0xBC" + struct.pack(
        "<BBBffBI", 1, channel, speed, 0.0, 0.0, address >> 32, address & 0xFFFFFFFF
    )
    return bytearray((image + bytes([sum(image) % 256])).ljust(8192, b"\0"))


class MemoryService:
    """All memories of a drone, numbered by position.

    A restart keeps the EEPROM and the memory of the lighthouse.

    onboard: model of the firmware
    kept: content that survives restarts, by type
    number: last byte of the drone's address
    """

    def __init__(
        self,
        onboard: Onboard,
        kept: dict[int, bytearray] | None = None,
        number: int = 0xE7,
    ) -> None:
        kept = {} if kept is None else kept
        self.tester = MemoryTester()
        trajectories = onboard.trajectories.memory.data
        self.all: tuple[DroneMemory, ...] = (
            StoredMemory(
                MemoryKind.EEPROM,
                kept.setdefault(
                    MemoryKind.EEPROM, make_eeprom(address=0xE7E7E7E700 | number)
                ),
            ),
            StoredMemory(MemoryKind.LEDS, bytearray(24)),
            StoredMemory(MemoryKind.TRAJECTORY, trajectories),
            self.tester,
            StoredMemory(
                MemoryKind.LIGHTHOUSE,
                kept.setdefault(MemoryKind.LIGHTHOUSE, bytearray(0x2000)),
            ),
            StoredMemory(MemoryKind.TIMINGS, bytearray(2000)),
            StoredMemory(
                MemoryKind.DECKS, bytearray([DECK_MEMORY_VERSION]) + bytearray(0x1FFF)
            ),
        )

    def take(self, packet: Packet) -> Iterator[Packet]:
        """Return the answers to a packet."""
        data = packet.data
        if packet.channel == MEMORY_INFO_CHANNEL:
            yield from self._about(data)
        elif (
            packet.channel in (MEMORY_READ_CHANNEL, MEMORY_WRITE_CHANNEL)
            and len(data) > _ADDRESS_LAYOUT.size
        ):
            number, address = _ADDRESS_LAYOUT.unpack_from(data)
            body = data[_ADDRESS_LAYOUT.size :]
            reads = packet.channel == MEMORY_READ_CHANNEL
            found = (
                self._read(number, address, body[0])
                if reads
                else self._write(number, address, body)
            )
            answer = (
                bytes([MemoryResult.EIO])
                if found is None
                else bytes([MemoryResult.OK]) + found
            )
            yield Packet(
                CrtpPort.MEMORY, packet.channel, data[: _ADDRESS_LAYOUT.size] + answer
            )

    def _about(self, data: bytes) -> Iterator[Packet]:
        if data[:1] == bytes([MemoryInfo.COUNT]):
            yield Packet(
                CrtpPort.MEMORY,
                MEMORY_INFO_CHANNEL,
                bytes([MemoryInfo.COUNT, len(self.all)]),
            )
        elif data[:1] == bytes([MemoryInfo.DESCRIPTION]) and len(data) > 1:
            number = data[1]
            memory = self.all[number] if number < len(self.all) else None
            kind, size = (0, 0) if memory is None else (memory.kind, memory.size)
            yield Packet(
                CrtpPort.MEMORY,
                MEMORY_INFO_CHANNEL,
                _DESCRIPTION_LAYOUT.pack(MemoryInfo.DESCRIPTION, number, kind, size),
            )

    def _read(self, number: int, address: int, length: int) -> bytes | None:
        return (
            self.all[number].read(address, length)
            if number < len(self.all) and length <= MEMORY_PACKET_SIZE
            else None
        )

    def _write(self, number: int, address: int, data: bytes) -> bytes | None:
        return (
            b""
            if number < len(self.all) and self.all[number].write(address, data)
            else None
        )
