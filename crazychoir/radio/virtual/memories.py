"""Port 4: the memories of a virtual drone, read and written in pieces."""

import struct
from collections.abc import Callable, Container, Iterator
from typing import Protocol

from crazychoir.firmware.memories import MEMORY_KINDS, MEMORY_PACKETS, MEMORY_SIZES
from crazychoir.firmware.results import FIRMWARE_RESULTS
from crazychoir.radio.protocol.crtp import CrtpPort, Packet
from crazychoir.radio.protocol.receive_buffer import FirmwareAssertion, ReceivedPacket
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
    """

    def __init__(self, kind: int, content: bytearray | memoryview) -> None:
        self.kind = kind
        self.content = content
        self.size = len(content)

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
    """The firmware's test of memories: each byte is the lowest byte of its address.

    take_reset: returns whether memTst.resetW is set, and clears it
    """

    kind: int = MEMORY_KINDS.tester
    size: int = MEMORY_SIZES.tester

    def __init__(self, take_reset: Callable[[], bool]) -> None:
        self.errors = 0
        """Packets with wrong bytes that were written since the last reset."""
        self._take_reset = take_reset

    def read(self, address: int, length: int) -> bytes | None:
        """Return bytes by the rule."""
        return bytes((address + k) & 0xFF for k in range(length))

    def write(self, address: int, data: bytes) -> bool:
        """Count a packet that is against the rule."""
        if self._take_reset():
            self.errors = 0
        self.errors += any(byte != (address + k) & 0xFF for k, byte in enumerate(data))
        return True


class DeckMemory:
    """The properties of decks: their version, and no deck with a memory of its own.

    Source: crazyflie-firmware, deck_memory.c.
    """

    kind: int = MEMORY_KINDS.decks
    size: int = MEMORY_SIZES.deck * (MEMORY_SIZES.most_decks + 1)

    def read(self, address: int, length: int) -> bytes | None:
        """Return properties; None in the section of a deck."""
        if address >= MEMORY_SIZES.deck:
            return None
        start = bytes([DECK_MEMORY_VERSION])[address:]
        return start[:length].ljust(length, b"\0")

    def write(self, address: int, data: bytes) -> bool:
        """Return False: properties are not written, and no deck has a memory."""
        return False


def make_eeprom(
    channel: int = 80, speed: int = 2, address: int = 0xE7E7E7E7E7
) -> bytearray:
    """Return the EEPROM of a drone.

    It holds the channel, data rate and address of its radio, no trim, and their checksum.
    """
    image = b"0xBC" + struct.pack(
        "<BBBffBI", 1, channel, speed, 0.0, 0.0, address >> 32, address & 0xFFFFFFFF
    )
    content = image + bytes([sum(image) % 256])
    return bytearray(content.ljust(MEMORY_SIZES.eeprom, b"\0"))


LED_DECK = "bcLedRing"
"""Deck with the memories of LEDs and of their timings."""
LIGHTHOUSE_DECK = "bcLighthouse4"
"""Deck with the memory of geometries and calibrations."""


class MemoryService:
    """All memories of a drone, numbered by position: its own, then those of its decks.

    A restart keeps the EEPROM and the memory of the lighthouse. The sections of decks are last.

    onboard: model of the firmware
    kept: content that survives restarts, by type
    number: last byte of the drone's address
    decks: names of its decks
    take_reset: returns whether the errors of the tester are to be reset, once
    """

    def __init__(
        self,
        onboard: Onboard,
        kept: dict[int, bytearray],
        number: int,
        decks: Container[str],
        take_reset: Callable[[], bool],
    ) -> None:
        eeprom = make_eeprom(address=0xE7E7E7E700 | number)
        self.tester = MemoryTester(take_reset)
        self.all: list[DroneMemory] = [
            StoredMemory(
                MEMORY_KINDS.eeprom, kept.setdefault(MEMORY_KINDS.eeprom, eeprom)
            ),
            StoredMemory(MEMORY_KINDS.trajectory, onboard.trajectories.memory.data),
            self.tester,
        ]
        if LED_DECK in decks:
            for kind, size in (
                (MEMORY_KINDS.leds, MEMORY_SIZES.leds),
                (MEMORY_KINDS.timings, MEMORY_SIZES.timings),
            ):
                self.all.append(StoredMemory(kind, bytearray(size)))
        if LIGHTHOUSE_DECK in decks:
            room = bytearray(MEMORY_SIZES.lighthouse)
            content = kept.setdefault(MEMORY_KINDS.lighthouse, room)
            self.all.append(StoredMemory(MEMORY_KINDS.lighthouse, content))
        self.all.append(DeckMemory())

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
