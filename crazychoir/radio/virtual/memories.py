"""Port 4: the memories of a virtual drone, read and written in pieces."""

import struct
from collections.abc import Iterator
from typing import Protocol

from crazychoir.firmware.memories import MEMORY_KINDS, MEMORY_PACKETS
from crazychoir.firmware.results import FIRMWARE_RESULTS
from crazychoir.radio.protocol.crtp import CrtpPort, Packet
from crazychoir.radio.virtual.receiver import FirmwareAssertion, ReceivedPacket
from crazychoir.simulation.onboard.onboard import Onboard

DECK_MEMORY_VERSION = 3
"""Version of the content of `MEMORY_KINDS.decks`."""


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

    kind: int = MEMORY_KINDS.tester
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
                MEMORY_KINDS.eeprom,
                kept.setdefault(
                    MEMORY_KINDS.eeprom, make_eeprom(address=0xE7E7E7E700 | number)
                ),
            ),
            StoredMemory(MEMORY_KINDS.leds, bytearray(24)),
            StoredMemory(MEMORY_KINDS.trajectory, trajectories),
            self.tester,
            StoredMemory(
                MEMORY_KINDS.lighthouse,
                kept.setdefault(MEMORY_KINDS.lighthouse, bytearray(0x2000)),
            ),
            StoredMemory(MEMORY_KINDS.timings, bytearray(2000)),
            StoredMemory(
                MEMORY_KINDS.decks, bytearray([DECK_MEMORY_VERSION]) + bytearray(0x1FFF)
            ),
        )

    def take(self, packet: ReceivedPacket) -> Iterator[Packet]:
        """Return the answers to a packet.

        Raises FirmwareAssertion for a memory that is not there.
        """
        match packet.channel:
            case MEMORY_PACKETS.information:
                yield from self._inform(packet.buffer)
            case MEMORY_PACKETS.read:
                yield self._read(packet.buffer)
            case MEMORY_PACKETS.write:
                yield self._write(packet)

    def _inform(self, request: bytes) -> Iterator[Packet]:
        command, number = request[:2]
        if command == MEMORY_PACKETS.count_command:
            yield Packet(
                CrtpPort.MEMORY,
                MEMORY_PACKETS.information,
                bytes([command, len(self.all)]),
            )
        elif command == MEMORY_PACKETS.description_command:
            memory = self._find(number)
            yield Packet(
                CrtpPort.MEMORY,
                MEMORY_PACKETS.information,
                _DESCRIPTION_LAYOUT.pack(command, number, memory.kind, memory.size),
            )

    def _read(self, request: bytes) -> Packet:
        number, address = _ADDRESS_LAYOUT.unpack_from(request)
        length = request[_ADDRESS_LAYOUT.size]
        found = self._find(number).read(address, length)
        result = (
            bytes([FIRMWARE_RESULTS.input_output_error])
            if found is None
            else bytes([FIRMWARE_RESULTS.done]) + found
        )
        return Packet(
            CrtpPort.MEMORY,
            MEMORY_PACKETS.read,
            request[: _ADDRESS_LAYOUT.size] + result,
        )

    def _write(self, packet: ReceivedPacket) -> Packet:
        number, address = _ADDRESS_LAYOUT.unpack_from(packet.buffer)
        is_written = self._find(number).write(
            address, packet.data[_ADDRESS_LAYOUT.size :]
        )
        result = (
            FIRMWARE_RESULTS.done if is_written else FIRMWARE_RESULTS.input_output_error
        )
        return Packet(
            CrtpPort.MEMORY,
            MEMORY_PACKETS.write,
            packet.buffer[: _ADDRESS_LAYOUT.size] + bytes([result]),
        )

    def _find(self, number: int) -> DroneMemory:
        """Return the memory with this number. Raises FirmwareAssertion if there is none."""
        if number >= len(self.all):
            raise FirmwareAssertion(
                f"memory {number}; there are {len(self.all)}, from 0."
            )
        return self.all[number]
